"""Periodic orbits: Newton, multiple shooting, multipliers."""
