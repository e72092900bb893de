"""Teleoperation laws beside those of telenano, one a module."""
