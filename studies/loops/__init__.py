"""Studies of the closed loop in lockstep: stability, transparency, comparison of laws."""
