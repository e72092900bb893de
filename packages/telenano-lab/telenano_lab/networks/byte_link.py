"""The link for the bytes of any program: the node of the link, with a carrier instead of the sites.

It has the name, the reports and the commands of a rig's link, so that every tool that shows, changes or records a link
works with it. The fate of each message is in `link/fates`, with the topic of the carrier.
"""

import contextlib
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Protocol, Self

from telenano.link import Direction, Fate, Release
from telenano.runtime import AddressBook, DirectionPath, ImpairedLink, NodeContext, NodeProcess, Reader, SiteEndpoint
from telenano.settings import LinkSettings
from telenano.timing import NEVER_NS, Clock
from telenano.wire import LINK, EndpointError, Scalar, read_header


class Carrier(Protocol):
    """Sends the bytes that the link has released, and is told of those that it dropped.

    Attributes:
        topic: The topic of the messages of both directions in `link/fates`.
    """

    topic: str

    def send(
        self, direction: Direction, payload: bytes, client: str, *, delay_ns: int, late_ns: int, is_copy: bool
    ) -> None:
        """Send bytes on.

        Args:
            direction: The direction.
            payload: The bytes, of which some bits may be flipped.
            client: The client that sent them, as passed to `arrive`.
            delay_ns: The time for which the link has held them [ns].
            late_ns: The time since they should have been sent [ns].
            is_copy: Whether they are a copy that the link made.
        """

    def dropped(self, direction: Direction, cause: str, size_bytes: int, *, is_copy: bool) -> None:
        """Record that bytes will not be sent, with the impairment that dropped them."""


class ByteLink(ImpairedLink):
    """Forwards the bytes of a carrier when the engine releases them, and reports on link/status.

    It keeps no journal, because running it again would need the bytes, which no recording has.
    """

    def __init__(
        self,
        context: NodeContext,
        settings: LinkSettings,
        outlets: tuple[SiteEndpoint, SiteEndpoint],
        carrier: Carrier,
        folder: Path = Path(),
        duration_s: float | None = None,
    ) -> None:
        """Start with the settings.

        Args:
            context: The context of the node.
            settings: The settings of the link.
            outlets: The publishers at the slave and at the master.
            carrier: Sends the released bytes.
            folder: The folder of the files that the settings name.
            duration_s: The time after which the link ends [s]; None: it ends at a signal.

        Raises:
            ConfigError: A file of the settings cannot be used.
        """
        super().__init__(context, settings, *outlets, folder)
        self._carrier = carrier
        self._numbers = {way.name: 0 for way in self.directions}
        now_ns = self.clock.monotonic_ns()
        self._end_ns = NEVER_NS if duration_s is None else now_ns + round(duration_s * 1e9)

    def arrive(self, direction: Direction, payload: bytes, client: str) -> None:
        """Accept bytes that have arrived from a client, and send the bytes that are due."""
        way = self.forward if direction == "forward" else self.backward
        number = self._numbers[direction]
        self._numbers[direction] += 1
        self.send(way, way.engine.submit(self.clock.now_ns(), self._carrier.topic, payload, number, client))
        self.count_unreported()

    def deadline_ns(self) -> int:
        return min(super().deadline_ns(), self._end_ns)

    def on_deadline(self, now_ns: int) -> None:
        super().on_deadline(now_ns)
        if now_ns >= self._end_ns:
            self.context.request_stop()

    def make_safe(self) -> None:
        """Publish the fates that are not reported yet; bytes in transit stay unsent."""
        self.publish_status()
        for way in self.directions:
            self.publish_fates(way)

    def send(self, way: DirectionPath, releases: Sequence[Release]) -> None:
        for release in releases:
            fate = release.fate
            late_ns = self.clock.now_ns() - (fate.release_ns or 0)
            self._carrier.send(
                way.name, release.payload, fate.src, delay_ns=fate.delay_ns, late_ns=late_ns, is_copy=fate.copy > 0
            )

    def take_fates(self, way: DirectionPath) -> list[Fate]:
        fates = super().take_fates(way)
        for fate in fates:
            if fate.dropped:
                self._carrier.dropped(way.name, fate.dropped, fate.size_bytes, is_copy=fate.copy > 0)
        return fates


class ByteLinkProcess:
    """A link in this process for the bytes of other programs.

    The reader calls `link.arrive` with bytes that it receives, and the link calls `carrier.send` with bytes that it
    releases.
    """

    def __init__(self, process: NodeProcess) -> None:
        self.clock: Clock = process.participant.clock
        self._process = process
        self._to_slave, self._to_master = (process.participant.bind(f"{LINK}@{site}") for site in ("slave", "master"))
        self._link: ByteLink
        self._run: Callable[[], None]

    @classmethod
    @contextlib.contextmanager
    def open(cls, book: AddressBook) -> Iterator[Self]:
        """Bind the endpoints of a rig's link during a block.

        Raises:
            EndpointError: A link runs already.
        """
        with NodeProcess.open(f"{LINK}@master", book) as process:
            try:
                link = cls(process)
            except EndpointError as error:
                raise EndpointError(f"{error}; another link runs beside it with --rig NAME") from error
            yield link

    def begin(
        self,
        settings: LinkSettings,
        carrier: Carrier,
        reader: Reader,
        *,
        duration_s: float | None = None,
        keep: Callable[[str, int, int, str, bytes], None] | None = None,
    ) -> None:
        """Begin with the settings.

        Args:
            settings: The settings of the link.
            carrier: Sends the released bytes.
            reader: The reader in the loop of the link.
            duration_s: The time after which the link ends [s]; None: it ends at a signal.
            keep: Called with topic, number, time [ns], source and bytes of each message that the link publishes at the
                master; None for no call.

        Raises:
            ConfigError: A file of the settings cannot be used.
        """
        participant, to_master = self._process.participant, self._to_master
        if keep is not None:
            to_master.carry = lambda topic, payload: keep(topic, *read_header(topic, payload), payload)
        readers = participant.subscribers(participant.book.sources(participant.key, ByteLink.inputs))
        bus = participant.bus_of(to_master, [*readers, reader])
        outlets = self._to_slave, to_master
        self._link = ByteLink(participant.context(bus), settings, outlets, carrier, duration_s=duration_s)
        self._run = partial(self._process.run, self._link, bus)

    def arrive(self, direction: Direction, payload: bytes, client: str) -> None:
        """Accept bytes that have arrived from a client, and send the bytes that are due."""
        self._link.arrive(direction, payload, client)

    def event(self, kind: str, level: str, text: str, **data: Scalar) -> None:
        """Publish a session/event and write it to the log."""
        self._link.context.publish_event(kind, level, text, data)

    def run(self) -> None:
        """Run until the duration is over or a signal comes."""
        self._run()
