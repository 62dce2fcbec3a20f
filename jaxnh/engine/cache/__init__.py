"""Things kept from run to run: executables, calibrations."""
