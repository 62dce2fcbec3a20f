"""Sweeps from coarse to fine."""
