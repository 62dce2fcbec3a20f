"""Periodic orbits of lanes."""
