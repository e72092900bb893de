"""What the tests of the core share: the closed loop, and the check of the recordings that they make."""

from checked_recordings import pytest_configure, pytest_runtest_teardown, pytest_terminal_summary
from closed_loops import loop

__all__ = ["loop", "pytest_configure", "pytest_runtest_teardown", "pytest_terminal_summary"]
