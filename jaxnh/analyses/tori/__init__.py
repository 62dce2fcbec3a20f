"""Invariant curves of the return map, that is tori of the flow: rotation number, what is normal to them, smoothness."""
