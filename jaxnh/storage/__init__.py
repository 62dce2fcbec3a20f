"""Result files and tiles on disk. No JAX; of the package only its jobs and exceptions are imported."""
