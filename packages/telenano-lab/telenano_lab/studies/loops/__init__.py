"""Cells of a closed loop in lockstep, what is asked of many of them, and the check that the bus agrees."""
