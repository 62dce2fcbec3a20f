"""Bifurcations of orbits: their location, normal forms and points of codimension two."""
