"""What moves: equations, parameters and sources."""
