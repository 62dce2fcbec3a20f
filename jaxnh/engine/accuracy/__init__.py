"""Choice of solver and steps that meet an accuracy."""
