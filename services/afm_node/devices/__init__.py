"""Real instruments over Modbus, and their emulators."""
