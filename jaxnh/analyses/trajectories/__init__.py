"""States along trajectories."""
