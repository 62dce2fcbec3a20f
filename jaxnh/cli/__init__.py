"""The command line: commands, and what they share: exit codes, signals, progress and tables on a terminal."""
