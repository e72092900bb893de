"""Support for bridges to other systems, which receive every message of a running rig in the form of a recording."""

import contextlib
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Protocol

import typer

from telenano.console.live_recording import LiveRecording
from telenano.recording.messages import RecordedMessage
from telenano.runtime.bus.address_book import AddressBook
from telenano.runtime.wiring.observer import RIG_HINT, runs_no_node
from telenano.wire.errors import RigError


class Bridge(Protocol):
    """Interface of a bridge, which forwards messages; `sent` counts the forwarded ones."""

    sent: int

    def run(self, messages: Iterator[RecordedMessage]) -> None:
        """Forward messages until the iterator ends."""


def live_rig(site_file: Path, topics: Collection[str] | None = None, rate_hz: float = 0.0) -> LiveRecording:
    """Return a context manager that reads the messages of the rig of a site file.

    Args:
        site_file: The site file.
        topics: The topics to subscribe to; None for all.
        rate_hz: Highest rate of each channel [Hz]; 0 for all messages. Topics sent on change are never thinned out.

    Raises:
        ConfigError: The site file cannot be used.
    """
    return LiveRecording(AddressBook.load(site_file), topics, rate_hz)


def hand_on(bridge: Bridge, live: LiveRecording, duration_s: float | None) -> None:
    """Run a bridge on the messages of a rig until Ctrl-C or for `duration_s` [s]; raise RigError if none was sent."""
    if runs_no_node(live.book):
        # A rig may be started after its bridge.
        typer.echo("telenano: no rig of this site file was found on this machine yet; waiting for one", err=True)
    with contextlib.suppress(KeyboardInterrupt):
        bridge.run(live.messages(duration_s=duration_s))
    if not bridge.sent:
        raise RigError(f"nothing was received: {RIG_HINT}")
