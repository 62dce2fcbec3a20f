"""Cycles and homoclinic orbits as boundary-value problems, by orthogonal collocation."""
