"""Basins of attraction: lanes to their attractors, and what these are."""
