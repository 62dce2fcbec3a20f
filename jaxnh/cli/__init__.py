"""What the commands share: exit codes, signals, progress and tables on a terminal."""
