"""Real handles on a serial line, their calibration, and their emulators."""
