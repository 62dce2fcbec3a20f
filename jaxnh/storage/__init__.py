"""Result files and tiles on disk. No JAX, and of the package nothing but its exceptions."""
