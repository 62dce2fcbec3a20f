"""Result files and datasets onto matplotlib axes. No JAX: imports storage and jobs alone."""
