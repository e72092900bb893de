"""Drivers of real devices and what they share: lines, processes of their own, calibrations, capabilities."""
