"""Transport: growth that does not end, and the drift and diffusion of paths."""
