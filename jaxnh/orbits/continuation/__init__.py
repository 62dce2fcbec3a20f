"""Curves of orbits, and of their bifurcations, by arclength; test functions that are monitored along them."""
