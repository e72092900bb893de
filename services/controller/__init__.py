"""The process that runs one half of a teleoperation law."""
