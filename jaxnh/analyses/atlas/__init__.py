"""An atlas of a plane of two parameters."""
