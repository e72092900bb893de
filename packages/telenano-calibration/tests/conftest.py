"""The recordings that the tests of this package read."""

from recorded_sessions import recording_of

__all__ = ["recording_of"]
