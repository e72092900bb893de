"""A handle behind a serial port: its firmware, an emulation of it, and its calibration."""
