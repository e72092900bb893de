"""The impairment engine of the link: both directions under one set of settings.

`services/delay_node/node.py` gives it each message of the loop and asks it for those that are due. `direction.py` has
the stages that a message passes before it goes to `services/controller/slave_half.py`, or back.
"""

from pathlib import Path
from typing import Any, NamedTuple

from telenano.link.direction import DirectionEngine, DirectionState
from telenano.link.fate import Fate
from telenano.settings.link_files import OWN_TRACES, Traces
from telenano.settings.link_settings import LinkSettings
from telenano.wire.node_state import FindInput


class LinkState(NamedTuple):
    """The state of both directions, and the settings in force if they were changed since the start, else None."""

    settings: dict[str, Any] | None
    forward: DirectionState
    backward: DirectionState


class LinkEngine:
    """Both directions of the link under one set of settings."""

    def __init__(
        self, settings: LinkSettings, start_ns: int, *, folder: Path = Path(), traces: Traces = OWN_TRACES
    ) -> None:
        """Start with the settings at `start_ns` [ns], the origin of outage schedules, traces and slots.

        Args:
            settings: The settings.
            start_ns: The origin of their times [ns].
            folder: The folder of the files that they name.
            traces: Reads these files.

        Raises:
            ConfigError: A file cannot be used; the message names file and line.
        """
        self.settings = settings
        # Settings changed since the start, as a dict; cached because dumping the model is slow.
        self._changed_settings: dict[str, Any] | None = None
        self._traces = traces
        self.forward = DirectionEngine("forward", settings, start_ns, folder=folder, traces=traces)
        self.backward = DirectionEngine("backward", settings, start_ns, folder=folder, traces=traces)

    def reconfigure(self, settings: LinkSettings, now_ns: int) -> None:
        """Apply new settings to the messages that arrive from now on; those in flight keep their fate.

        Raises:
            ConfigError: A file cannot be used; the message names file and line, and the old settings stay.
            LaterError: A file is being read; the old settings stay until another call.
        """
        files = [(engine, engine.files_of(settings)) for engine in (self.forward, self.backward)]
        for engine, read in files:
            engine.adopt(settings, read, now_ns)
        self._traces.forget_unused()
        self.settings = settings
        self._changed_settings = settings.model_dump(exclude_unset=True)

    def begin_session(self, now_ns: int) -> None:
        """Begin a session at `now_ns` [ns], the origin of schedules that are given in session time."""
        self.forward.begin_session(now_ns)
        self.backward.begin_session(now_ns)

    def capture(self) -> LinkState:
        """Return the state; raise ValueError as `DirectionEngine.capture`."""
        return LinkState(self._changed_settings, self.forward.capture(), self.backward.capture())

    def restore(self, state: LinkState, find: FindInput) -> None:
        """Continue from a state; `find` returns the payloads of messages in flight.

        Raises:
            ConfigError: A file cannot be used.
            KeyError: The state does not fit this engine; ValueError and TypeError mean the same.
        """
        self._changed_settings = state.settings
        if self._changed_settings is not None:
            self.settings = LinkSettings.of(self._changed_settings, "the settings in the journal")
        self.forward.restore(state.forward, self.settings, find)
        self.backward.restore(state.backward, self.settings, find)

    def next_release_ns(self) -> int | None:
        """Return the next time at which to call `due` of the directions [ns]; None if nothing is in flight."""
        forward_ns, backward_ns = self.forward.next_release_ns(), self.backward.next_release_ns()
        if forward_ns is None or backward_ns is None:
            return backward_ns if forward_ns is None else forward_ns
        return min(forward_ns, backward_ns)

    def take_fates(self) -> list[Fate]:
        """Return and remove the fates decided since the last call, forward first."""
        return self.forward.take_fates() + self.backward.take_fates()
