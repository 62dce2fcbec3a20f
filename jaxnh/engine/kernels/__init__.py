"""A kernel of one thread a lane, from the traced function of a lane, for CUDA."""
