"""Systems: equations of motion, parameters and sources."""
