"""Attractors, their images under the reversal of a flow, and whether they are apart, the same, or meet."""
