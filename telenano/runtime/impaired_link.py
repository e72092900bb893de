"""A node that delays, drops or alters messages between two endpoints, and reports the fate of each.

`services/delay_node` uses it to forward the messages of a rig, and `telenano link udp` the bytes of other programs, so
that displays, settings and recordings of a link work with both.
"""

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import ClassVar, NamedTuple, Protocol

import msgspec

from telenano.link.direction import DirectionEngine
from telenano.link.engine import LinkEngine
from telenano.link.fate import Direction, Fate, Release
from telenano.runtime.loop.deadlines import deadline_after
from telenano.runtime.loop.deferred import Task
from telenano.runtime.loop.node import Node, NodeContext
from telenano.settings.link_files import OWN_TRACES, Traces
from telenano.settings.link_settings import LinkSettings, Setting
from telenano.timing.clock_offset import OffsetFilter
from telenano.wire.errors import ConfigError, RefusedError
from telenano.wire.messages import LinkDirection, LinkFate, Message, Scalar, SessionControl
from telenano.wire.nodes import LINK
from telenano.wire.received import Received

STATUS_PERIOD_NS = 100_000_000
# Number of exchanges of time stamps in the filter of the clock offset, one per report.
_CLOCK_WINDOW = 64
# A report of fates is sent when this number of rows is ready.
FATES_AT_ONCE = 32
# Most rows in a message, with a margin to its limit.
_MOST_FATES = 1000
# Most settings of single topics with which a running link is changed. The change takes 50 us for each, in one turn.
_MOST_OF_TOPICS = 250


class SiteEndpoint(Protocol):
    """The endpoint of the link at a site, which also sends bytes unchanged."""

    def send(self, topic: str, payload: bytes) -> None:
        """Send a message with the header of its original publisher."""

    def publish(self, topic: str, **fields: object) -> Message:
        """Send a message of the link itself."""

    def sequence_numbers(self) -> dict[str, int]:
        """Return the seq of the link's next message on each topic."""


class DirectionPath(NamedTuple):
    """A direction of the link: its engine, and the name and object of the endpoint that it sends to."""

    name: Direction
    engine: DirectionEngine
    endpoint: str
    outlet: SiteEndpoint


class LinkMemory(Protocol):
    """The state that every link keeps for its reports: time of the next one [ns], and number of unreported messages."""

    status_ns: int
    unreported: int


class Reports(msgspec.Struct):
    """The memory of a link that has no other state."""

    status_ns: int
    unreported: int = 0


class ImpairedLink(Node):
    """Holds messages of both directions until the engine releases them; reports on link/status and link/fates."""

    inputs = ("session/control",)
    commands: ClassVar[tuple[str, ...]] = ("set",)
    # After this message the tick is at the master's side.
    idle_after = "teleop/backward"
    acts_on_health = True
    period_s = 0.0

    def __init__(
        self,
        context: NodeContext,
        settings: LinkSettings,
        to_slave: SiteEndpoint,
        to_master: SiteEndpoint,
        folder: Path,
        *,
        traces: Traces = OWN_TRACES,
    ) -> None:
        """Start with the settings.

        Args:
            context: The context of the node.
            settings: The settings of the link.
            to_slave: The endpoint at the slave's site.
            to_master: The endpoint at the master's site.
            folder: The folder of the files that the settings name.
            traces: Reads these files.

        Raises:
            ConfigError: A trace cannot be used; the message names file and line.
        """
        super().__init__(context)
        self._traces = traces
        self.engine = LinkEngine(settings, self.clock.now_ns(), folder=folder, traces=traces)
        # The settings whose network name was determined last, and this name; restoring a link changes its settings.
        self._named = settings, settings.network_name
        self.forward = DirectionPath("forward", self.engine.forward, f"{LINK}@slave", to_slave)
        self.backward = DirectionPath("backward", self.engine.backward, f"{LINK}@master", to_master)
        self.directions = (self.forward, self.backward)
        self.offset = OffsetFilter(_CLOCK_WINDOW)
        self.memory: LinkMemory = Reports(self.clock.monotonic_ns() + STATUS_PERIOD_NS)
        # The tasks that report the fates of the messages, one per direction.
        self.fate_tasks: tuple[Task, ...] = tuple(partial(self.publish_fates, way) for way in self.directions)
        # A full report includes the state of the link.
        self.report_tasks: tuple[Task, ...] = (*self.fate_tasks, self.publish_status)
        self.state = "running"

    @abstractmethod
    def send(self, way: DirectionPath, releases: Sequence[Release]) -> None:
        """Send the messages that the engine has released in a direction."""

    def deadline_ns(self) -> int:
        release_ns = self.engine.next_release_ns()
        due_ns = min(self.memory.status_ns, self.freshness.deadline_ns())
        return due_ns if release_ns is None else min(due_ns, release_ns - self.clock.epoch_offset_ns)

    def on_message(self, received: Received) -> None:
        """Record the start of a session, which is the zero time of the schedules in the settings."""
        self.begin_turn(received.received_ns - self.clock.epoch_offset_ns)
        message = received.message
        if type(message) is SessionControl and message.command == "start":
            self.engine.begin_session(received.received_ns)

    def on_deadline(self, now_ns: int) -> None:
        self.begin_turn(now_ns)
        self.send_due(now_ns)
        self.report_if_due(now_ns)

    def send_due(self, now_ns: int) -> None:
        """Send the messages that are due in both directions."""
        epoch_ns = now_ns + self.clock.epoch_offset_ns
        for way in self.directions:
            self.send(way, way.engine.due(epoch_ns))

    def report_if_due(self, now_ns: int) -> None:
        """Defer the reports to the next idle gap if they are due, ten times a second."""
        if now_ns >= self.memory.status_ns:
            self.memory.status_ns = deadline_after(self.memory.status_ns, now_ns, STATUS_PERIOD_NS)
            for task in self.report_tasks:
                self.defer(task)

    def count_unreported(self, *, may_report: bool = True) -> None:
        """Count a message whose fate has to be reported, and defer a report when FATES_AT_ONCE are ready.

        Reports of this size delay the next message for less time than one report for a tenth of a second would.

        Args:
            may_report: Whether an idle gap of the loop comes next.
        """
        self.steps += 1
        self.memory.unreported += 1
        if self.memory.unreported >= FATES_AT_ONCE and may_report:
            for task in self.fate_tasks:
                self.defer(task)

    def on_control(self, control: SessionControl) -> str:
        """Change the settings for messages that arrive from now on; messages in flight keep their fate.

        Raises:
            LaterError: A file is being read.
            RefusedError: The settings cannot be used.
        """
        if control.command != "set":
            return super().on_control(control)
        if not control.parameters:
            raise RefusedError("set needs link settings, such as forward.delay_s=0.02 or profile=satellite")
        self._check_topics(control.parameters)
        try:
            self.engine.reconfigure(self.engine.settings.changed(control.parameters), self.clock.now_ns())
        except ConfigError as error:
            raise RefusedError(f"the link keeps its settings: {error}") from error
        text = "set " + ", ".join(f"{key} = {value}" for key, value in control.parameters.items())
        self.event("link", "info", f"link settings changed: {text}")
        return text

    def _check_topics(self, parameters: Mapping[str, Scalar]) -> None:
        """Refuse a change with more settings of single topics than one turn may take."""
        settings = self.engine.settings
        kept = 0 if "profile" in parameters else len(settings.forward.topics) + len(settings.backward.topics)
        count = kept + sum(".topics." in key for key in parameters)
        if count > _MOST_OF_TOPICS:
            text = f"topics: with {count} settings of single topics the change would hold up the loop"
            raise RefusedError(f"{text}: a running link takes {_MOST_OF_TOPICS}, and one that starts takes more")

    def make_safe(self) -> None:
        """End the reading of files; the silence of a stopped link makes the devices safe."""
        self._traces.close()

    def publish_fates(self, way: DirectionPath) -> None:
        """Publish the fates of the messages of a direction since the last report."""
        self.memory.unreported = 0
        fates = tuple(_link_fate(fate) for fate in self.take_fates(way))
        for first in range(0, len(fates), _MOST_FATES):
            self.publish("link/fates", direction=way.name, fates=fates[first : first + _MOST_FATES])

    def take_fates(self, way: DirectionPath) -> list[Fate]:
        """Return the unreported fates of a direction, and forget them."""
        return way.engine.take_fates()

    def publish_status(self) -> None:
        """Publish the current settings and the counts of both directions."""
        if self._named[0] is not self.engine.settings:
            self._named = self.engine.settings, self.engine.settings.network_name
        settings, network = self.engine.settings.flattened(only_set=True), self._named[1]
        self.publish(
            "link/status",
            forward=_direction(self.forward, settings, network),
            backward=_direction(self.backward, settings, network),
            **self.clock_status(),
        )

    def clock_status(self) -> dict[str, object]:
        """Return the fields of link/status on the clocks of the sites."""
        return {"clock": self.offset.report(of_line=False)}


def _link_fate(fate: Fate) -> LinkFate:
    """Return a row of link/fates."""
    return LinkFate(
        topic=fate.topic,
        seq=fate.seq,
        is_duplicate=fate.copy > 0,
        arrived_ns=fate.arrived_ns,
        delay_ns=fate.delay_ns,
        queue_ns=fate.queue_ns,
        held_ns=fate.held_ns,
        dropped=fate.dropped,
        duplicated=fate.duplicated,
        reordered=fate.reordered,
        corrupted=fate.corrupted,
    )


def _direction(way: DirectionPath, settings: dict[str, Setting], network: str) -> LinkDirection:
    stats, prefix = way.engine.stats(), way.name + "."
    return LinkDirection(
        profile=network,
        settings={key.removeprefix(prefix): value for key, value in settings.items() if key.startswith(prefix)},
        messages_in=stats.messages_in,
        messages_out=stats.messages_out,
        dropped={cause: count for cause, count in stats.dropped.items() if count},
        duplicated=stats.duplicated,
        reordered=stats.reordered,
        corrupted=stats.corrupted,
        queue_depth=stats.in_flight,
        delay_valid=stats.delay_count > 0,
        delay_mean_s=stats.delay_mean_s or 0.0,
        delay_min_s=stats.delay_min_s or 0.0,
        delay_max_s=stats.delay_max_s or 0.0,
    )
