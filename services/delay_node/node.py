"""The link process: the only path between the sites, with the impairments in force on each direction."""

from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar, Protocol

from proto import TOPICS
from proto.messages import LinkDirection, SessionControl
from services.delay_node.config import LinkSettings, SettingsError, changed, flattened
from services.delay_node.engine import DirectionEngine, LinkEngine
from services.delay_node.fate import DirectionStats, Release
from services.runtime.bus import Received
from services.runtime.errors import RefusedError
from services.runtime.node import Node, NodeContext
from services.runtime.schedule import Grid

STATUS_PERIOD_NS = 100_000_000


class Outlet(Protocol):
    """A socket that sends bytes as they are."""

    def send(self, topic: str, payload: bytes) -> None:
        """Send a message with the header of its first publisher."""


class DelayNode(Node):
    """Forwards messages between the sites when the engine says so, and reports on link/status."""

    inputs = ("session/control",)
    commands: ClassVar[tuple[str, ...]] = ("set",)
    period_s = 0.0

    def __init__(
        self, context: NodeContext, settings: LinkSettings, to_slave: Outlet, to_master: Outlet, folder: Path
    ) -> None:
        """Start with the settings; the files that they name are sought in `folder`.

        Raises SettingsError naming file and line, for a trace that cannot be used.
        """
        super().__init__(context)
        self._outlets = {"forward": to_slave, "backward": to_master}
        self.engine = LinkEngine(settings, self.clock.now_ns(), folder=folder, keep_fates=False)
        self._sides: dict[str, DirectionEngine] = {"forward": self.engine.forward, "backward": self.engine.backward}
        self._status = Grid(self.clock.monotonic_ns(), STATUS_PERIOD_NS)
        self.state = "running"

    def deadline_ns(self) -> int:
        """Give the next release or report, whichever comes first."""
        release_ns = self.engine.next_release_ns()
        if release_ns is None:
            return self._status.deadline_ns
        return min(self._status.deadline_ns, release_ns - self.clock.epoch_offset_ns)

    def on_message(self, received: Received) -> None:
        """Hand a message to the engine and send on what is due."""
        direction = TOPICS[received.topic].bridged
        if direction is None:
            return
        for way in ("forward", "backward") if direction == "both" else (direction,):
            due = self._sides[way].submit(received.received_ns, received.topic, received.payload, received.message.seq)
            self._send(way, due)
        self.steps += 1

    def on_deadline(self, now_ns: int) -> None:
        """Release what is due; report when it is time."""
        epoch_ns = now_ns + self.clock.epoch_offset_ns
        for way, side in self._sides.items():
            self._send(way, side.due(epoch_ns))
        if now_ns >= self._status.deadline_ns:
            self._status.advance(now_ns)
            self._report()

    def on_control(self, control: SessionControl) -> str:
        """Change the settings for the messages that arrive from now on; those in flight keep their fate."""
        if control.command != "set":
            return super().on_control(control)
        if not control.parameters:
            raise RefusedError("set needs link settings, such as forward.delay_s=0.02 or profile=satellite")
        try:
            self.engine.reconfigure(changed(self.engine.settings, control.parameters), self.clock.now_ns())
        except SettingsError as error:
            raise RefusedError(f"the link keeps its settings: {error}") from error
        text = "set " + ", ".join(f"{key} = {value}" for key, value in control.parameters.items())
        self.event("link", "info", f"link settings changed: {text}")
        return text

    def make_safe(self) -> None:
        """Do nothing: a link that stands still makes the devices safe by its silence."""

    def _send(self, way: str, releases: Sequence[Release]) -> None:
        outlet = self._outlets[way]
        for release in releases:
            outlet.send(release.topic, release.payload)

    def _report(self) -> None:
        settings = flattened(self.engine.settings, only_set=True)
        self.publish(
            "link/status",
            forward=_direction(self._sides["forward"].stats(), settings, "forward", self.engine.settings.profile),
            backward=_direction(self._sides["backward"].stats(), settings, "backward", self.engine.settings.profile),
        )


def _direction(
    stats: DirectionStats, settings: dict[str, float | int | str | bool], way: str, profile: str
) -> LinkDirection:
    prefix = way + "."
    return LinkDirection(
        profile=profile,
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
