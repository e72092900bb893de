"""Particles that are found in images and pushed into patterns, in simulated time or by the instrument of a rig."""
