"""Cells of a closed loop in lockstep, the studies made of many cells, and the check against runs on the bus."""
