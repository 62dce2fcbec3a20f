"""Limits of return maps that a config names as well. Nothing here imports JAX."""

LONGEST_RETURN = 200.0
"""Time without a crossing after which a lane has failed, in units of the flow's own, where nothing is said."""
