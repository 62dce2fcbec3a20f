"""Equilibria of flows without a clock."""
