"""What the tests of the core share: the closed loop."""

from closed_loops import loop

__all__ = ["loop"]
