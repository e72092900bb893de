"""A node that holds messages between two places as the link between the sites does, and reports what it did to each.

`services/delay_node` forwards the messages of a rig with it, and `telenano link udp` the bytes of other programs: what
shows, changes or records a link does so with either.
"""

from abc import abstractmethod
from collections.abc import Sequence
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
from telenano.settings.link_settings import LinkSettings, Setting
from telenano.timing.clock_offset import OffsetFilter
from telenano.wire.errors import ConfigError, RefusedError
from telenano.wire.messages import LinkDirection, LinkFate, Message, SessionControl
from telenano.wire.nodes import LINK
from telenano.wire.received import Received

STATUS_PERIOD_NS = 100_000_000
# seconds of exchanges of time stamps in view, one a report
_CLOCK_WINDOW = 64
# This number of rows of ground truth make a message worth sending.
FATES_AT_ONCE = 32
# This number of rows fit into a message, with a margin.
_MOST_FATES = 1000


class SiteEndpoint(Protocol):
    """The endpoint at a site: sends bytes as they are."""

    def send(self, topic: str, payload: bytes) -> None:
        """Send a message with the header of its first publisher."""

    def publish(self, topic: str, **fields: object) -> Message:
        """Send a message of the link's own."""

    def sequence_numbers(self) -> dict[str, int]:
        """Return the seq of the link's next message on each topic."""


class DirectionPath(NamedTuple):
    """A direction of the link."""

    name: Direction
    engine: DirectionEngine
    endpoint: str
    outlet: SiteEndpoint


class LinkMemory(Protocol):
    """What every link keeps for its reports: when the next is due [ns], and how many messages it has to tell of."""

    status_ns: int
    unreported: int


class Reports(msgspec.Struct):
    """The memory of a link that keeps nothing else."""

    status_ns: int
    unreported: int = 0


class ImpairedLink(Node):
    """Holds messages of both directions until the engine releases them, and reports on link/status and link/fates."""

    inputs = ("session/control",)
    commands: ClassVar[tuple[str, ...]] = ("set",)
    # After this the tick is at the master's side.
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
    ) -> None:
        """Start with the settings; the files that they name are sought in `folder`.

        Args:
            context: The context of the node.
            settings: The settings of the link.
            to_slave: The end at the slave's site.
            to_master: The end at the master's site.
            folder: The folder in which the files of the settings are sought.

        Raises:
            ConfigError: A trace cannot be used; the message names file and line.
        """
        super().__init__(context)
        self.engine = LinkEngine(settings, self.clock.now_ns(), folder=folder)
        # The settings that were named last, and what they were named; a restored link has others than it began with.
        self._named = settings, settings.network_name
        self.forward = DirectionPath("forward", self.engine.forward, f"{LINK}@slave", to_slave)
        self.backward = DirectionPath("backward", self.engine.backward, f"{LINK}@master", to_master)
        self.directions = (self.forward, self.backward)
        self.offset = OffsetFilter(_CLOCK_WINDOW)
        self.memory: LinkMemory = Reports(self.clock.monotonic_ns() + STATUS_PERIOD_NS)
        # These tasks report what happened to the messages of each direction.
        self.fate_tasks: tuple[Task, ...] = tuple(partial(self.publish_fates, way) for way in self.directions)
        # The report has the state of the link as well.
        self.report_tasks: tuple[Task, ...] = (*self.fate_tasks, self.publish_status)
        self.state = "running"

    @abstractmethod
    def send(self, way: DirectionPath, releases: Sequence[Release]) -> None:
        """Send on in a direction what the engine has released."""

    def deadline_ns(self) -> int:
        release_ns = self.engine.next_release_ns()
        due_ns = min(self.memory.status_ns, self.freshness.deadline_ns())
        return due_ns if release_ns is None else min(due_ns, release_ns - self.clock.epoch_offset_ns)

    def on_message(self, received: Received) -> None:
        """Note the start of a session, which the schedules of the settings are counted from."""
        self.begin_turn(received.received_ns - self.clock.epoch_offset_ns)
        message = received.message
        if type(message) is SessionControl and message.command == "start":
            self.engine.begin_session(received.received_ns)

    def on_deadline(self, now_ns: int) -> None:
        self.begin_turn(now_ns)
        self.send_due(now_ns)
        self.report_if_due(now_ns)

    def send_due(self, now_ns: int) -> None:
        """Send on what is due in both directions."""
        epoch_ns = now_ns + self.clock.epoch_offset_ns
        for way in self.directions:
            self.send(way, way.engine.due(epoch_ns))

    def report_if_due(self, now_ns: int) -> None:
        """Have the next idle gap publish the reports, ten times a second."""
        if now_ns >= self.memory.status_ns:
            self.memory.status_ns = deadline_after(self.memory.status_ns, now_ns, STATUS_PERIOD_NS)
            for task in self.report_tasks:
                self.defer(task)

    def count_unreported(self, *, may_report: bool = True) -> None:
        """Count a message whose fate is to be reported.

        Many of them are reported at once, because small reports hold up the next message for less than one of a tenth
        of a second would.

        Args:
            may_report: Whether an idle gap of the loop comes next.
        """
        self.steps += 1
        self.memory.unreported += 1
        if self.memory.unreported >= FATES_AT_ONCE and may_report:
            for task in self.fate_tasks:
                self.defer(task)

    def on_control(self, control: SessionControl) -> str:
        """Change the settings for the messages that arrive from now on; those in flight keep their fate."""
        if control.command != "set":
            return super().on_control(control)
        if not control.parameters:
            raise RefusedError("set needs link settings, such as forward.delay_s=0.02 or profile=satellite")
        try:
            self.engine.reconfigure(self.engine.settings.changed(control.parameters), self.clock.now_ns())
        except ConfigError as error:
            raise RefusedError(f"the link keeps its settings: {error}") from error
        text = "set " + ", ".join(f"{key} = {value}" for key, value in control.parameters.items())
        self.event("link", "info", f"link settings changed: {text}")
        return text

    def make_safe(self) -> None:
        """Do nothing: a link that stands still makes the devices safe by its silence."""

    def publish_fates(self, way: DirectionPath) -> None:
        """Publish what became of the messages of a direction since the last report."""
        self.memory.unreported = 0
        fates = tuple(_link_fate(fate) for fate in self.take_fates(way))
        for first in range(0, len(fates), _MOST_FATES):
            self.publish("link/fates", direction=way.name, fates=fates[first : first + _MOST_FATES])

    def take_fates(self, way: DirectionPath) -> list[Fate]:
        """Return the fates of a direction that are not reported yet."""
        return way.engine.take_fates()

    def publish_status(self) -> None:
        """Publish the settings in force and the counts of both directions."""
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
        """Return the keys of link/status that tell of the clocks of the sites."""
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
