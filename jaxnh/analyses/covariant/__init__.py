"""Covariant Lyapunov vectors of return maps, the angles between their subspaces, and hyperbolicity."""
