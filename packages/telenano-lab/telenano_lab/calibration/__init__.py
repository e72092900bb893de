"""Calibrations of an instrument: read-out sensitivity, cantilever stiffness from thermal noise, handles and stages."""
