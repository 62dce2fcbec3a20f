"""Lanes on devices, calibration, plan, runs and sessions."""
