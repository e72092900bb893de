"""Devices for telenano: hands and AFM controllers with drivers, guards, emulations, calibration and acceptance."""
