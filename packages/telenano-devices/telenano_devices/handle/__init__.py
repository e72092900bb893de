"""The handle on a serial port: its firmware, an emulator, and its calibration."""
