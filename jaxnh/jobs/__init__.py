"""Jobs: what is decided for a sweep, its cutting into pieces, and these put together again. No files, no JAX."""
