"""All periodic orbits of a return map up to a number of returns, stable or not, and how many are missing."""
