"""Recordings to read, as the tests of the core have them."""

from recorded_sessions import recording_of

__all__ = ["recording_of"]
