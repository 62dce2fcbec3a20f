"""Sudden changes of chaotic attractors along a parameter."""
