"""Closed loop in lockstep: the same steps as the nodes, compiled, without processes."""
