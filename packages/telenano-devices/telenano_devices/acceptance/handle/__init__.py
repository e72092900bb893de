"""The acceptance of a handle on a serial port: one motion along its axis, and the checks of its recording."""
