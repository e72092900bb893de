"""Teleoperation laws in addition to those of telenano, one per module."""
