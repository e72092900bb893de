"""The acceptance of a device that takes a force: one motion of a minute, and the checks of its recording."""
