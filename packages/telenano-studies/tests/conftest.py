"""How the closed loop runs in these tests, as the tests of the core have it."""

from closed_loops import loop, plain_loop

__all__ = ["loop", "plain_loop"]
