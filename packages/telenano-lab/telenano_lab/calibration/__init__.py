"""Calibrations of an instrument: sensitivity of the read-out, stiffness by thermal noise, handles and stages."""
