"""What accuracy costs on a scene, a file a quantity: the map of one period, a doubling point, an exponent. No files."""
