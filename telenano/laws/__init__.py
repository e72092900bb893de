"""Teleoperation laws as two-ports: their steps, the timing of both halves, force clamp, x and y, and settings."""
