"""The controller node, which runs one half of a teleoperation law."""
