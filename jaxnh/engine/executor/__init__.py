"""Functions over lanes, on devices, in tiles."""
