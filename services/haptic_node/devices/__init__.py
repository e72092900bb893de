"""Real handles on a serial line, and their calibration."""
