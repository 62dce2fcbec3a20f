"""What is kept from run to run: executables, calibrations."""
