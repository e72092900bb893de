"""The acceptance of a device that takes a force: one motion of a minute, and what it shows."""
