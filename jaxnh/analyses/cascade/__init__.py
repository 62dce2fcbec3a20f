"""Cascades of period doublings."""
