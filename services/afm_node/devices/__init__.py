"""Real instruments over Modbus."""
