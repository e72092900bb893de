"""Closed loop in lockstep: the same compiled steps as the nodes, without processes."""
