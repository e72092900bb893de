"""Calibrations of an instrument: sensitivity of the read-out, and stiffness by thermal noise."""
