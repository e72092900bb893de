"""Apparatus of the trials: a rig of processes that stays up, or simulated time."""
