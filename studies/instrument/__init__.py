"""Experiments with the instrument alone: images, force curves, calibration."""
