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


class Rate:
    """Chooses the messages of each channel and source that are due by a rate; what is sent on change always is.

    rate = Rate(Rate.DEFAULT_HZ)
    due = [message for message in live.messages() if rate.is_due(message)]
    """

    # 8000 messages a second of a rig would be more than a viewer draws.
    DEFAULT_HZ = 100.0

    def __init__(self, rate_hz: float) -> None:
        """Choose up to `rate_hz` messages a second of each [Hz]; 0 for all of them."""
        self._period_ns = round(1e9 / rate_hz) if rate_hz > 0.0 else 0
        self._due_ns: dict[tuple[str, str], int] = {}

    def is_due(self, message: RecordedMessage) -> bool:
        """Return whether a message is to be handed on."""
        if not self._period_ns or message.channel.rate_hz is None:
            return True
        key = message.channel_topic, message.src
        due_ns = self._due_ns.get(key, 0)
        if message.log_ns < due_ns:
            return False
        # The next one is due on the grid of the rate, unless the channel was silent.
        kept = message.log_ns - due_ns < self._period_ns
        self._due_ns[key] = (due_ns if kept else message.log_ns) + self._period_ns
        return True


def live_rig(site_file: Path, topics: Collection[str] | None = None) -> LiveRecording:
    """Return a context with the messages of the rig of a site file; ConfigError where that cannot be used."""
    return LiveRecording(AddressBook.load(site_file), topics)


def hand_on(bridge: Bridge, live: LiveRecording, duration_s: float | None) -> None:
    """Run a bridge over the messages of a rig until Ctrl-C or for a time [s]; RigError if there were none."""
    if runs_no_node(live.book):
        # A rig may be started after its bridge.
        typer.echo("telenano: no rig of this site file runs on this machine yet; waiting for one", err=True)
    with contextlib.suppress(KeyboardInterrupt):
        bridge.run(live.messages(duration_s=duration_s))
    if not bridge.sent:
        raise RigError(f"nothing was received: {RIG_HINT}")
