"""Families of periodic orbits and equilibria along a parameter, and curves of bifurcations over two."""
