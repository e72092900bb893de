"""The trial of a handle on a serial port: one motion along its axis, and what it shows."""
