"""A bridge of your own: what it is given is every message of a running rig, with the times and names of its record."""

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
    """What hands messages on; `sent` counts those that it has."""

    sent: int

    def run(self, messages: Iterator[RecordedMessage]) -> None:
        """Hand on messages until there are no more."""


def live_rig(site_file: Path, topics: Collection[str] | None = None, rate_hz: float = 0.0) -> LiveRecording:
    """Return a context with the messages of the rig of a site file.

    Args:
        site_file: The site file.
        topics: The topics that are listened to; None for all.
        rate_hz: Most messages of each channel a second [Hz]; 0 for all. What is sent on change always comes.

    Raises:
        ConfigError: The site file cannot be used.
    """
    return LiveRecording(AddressBook.load(site_file), topics, rate_hz)


def hand_on(bridge: Bridge, live: LiveRecording, duration_s: float | None) -> None:
    """Run a bridge over the messages of a rig until Ctrl-C or for a time [s]; RigError if there were none."""
    if runs_no_node(live.book):
        # A rig may be started after its bridge.
        typer.echo("telenano: no rig of this site file was found on this machine yet; waiting for one", err=True)
    with contextlib.suppress(KeyboardInterrupt):
        bridge.run(live.messages(duration_s=duration_s))
    if not bridge.sent:
        raise RigError(f"nothing was received: {RIG_HINT}")
