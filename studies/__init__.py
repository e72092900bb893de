"""Closed loop in lockstep: the same steps as the nodes, compiled, without processes."""

from services.runtime.compiled import compile_steps

compile_steps()
