"""Basins of attraction: attractors, and the lanes that lead to each."""
