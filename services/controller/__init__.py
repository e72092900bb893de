"""The teleoperation laws and the process that runs one half of a law."""
