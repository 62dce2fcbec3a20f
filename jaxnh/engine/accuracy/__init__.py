"""Which solver and steps meet an accuracy."""
