"""Result files and tiles on disk. No JAX, and nothing else of the package."""
