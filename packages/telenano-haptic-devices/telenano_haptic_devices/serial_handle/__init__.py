"""The handle on a serial port, in handle protocol 1: its frames, its calibration, its clock and its driver."""
