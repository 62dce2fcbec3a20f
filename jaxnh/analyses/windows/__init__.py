"""Periodic windows."""
