"""Transient chaos: how long motions stay in a region, at what rate they leave it, and the chaotic saddle in it."""
