"""What can go wrong with a rig as a whole."""

from services.runtime.errors import TelenanoError


class RigError(TelenanoError):
    """The rig could not be started, kept running or reached; the text names the node and what it said."""
