"""YAML to a frozen, valid experiment, and the line that says what is wrong."""
