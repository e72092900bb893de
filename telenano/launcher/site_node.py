"""The launcher of the slave's site: it keeps the nodes there running for a session that the master's conducts."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, ClassVar

from telenano.launcher.liveness import LivenessMonitor
from telenano.launcher.readiness import READY_DEADLINE_S, unmet
from telenano.launcher.rig_node import RigNode
from telenano.launcher.supervisor import Supervisor
from telenano.runtime.loop.node import NodeContext
from telenano.runtime.wiring.link_transports import PieceSender
from telenano.settings.known_packages import KNOWN_PACKAGES
from telenano.wire.errors import RefusedError
from telenano.wire.extras import how_to_add_package
from telenano.wire.messages import ClockPing, SessionControl
from telenano.wire.nodes import LINK, TIP
from telenano.wire.received import Received


class SiteNode(RigNode):
    """Keeps the nodes of the slave's site running; the master's launcher conducts the session, arms and starts it.

    On request it sends the recording of its site, in pieces.
    """

    # The link sends clock/ping without its impairments, so it serves as the heartbeat of the master's machine.
    inputs: ClassVar[tuple[str, ...]] = (*RigNode.inputs, "clock/ping", "session/control")
    named_commands: ClassVar[tuple[str, ...]] = ("set",)

    def __init__(
        self,
        context: NodeContext,
        supervisor: Supervisor,
        folder: Path,
        sender: Callable[[Path, Callable[..., Any]], PieceSender] | None = None,
    ) -> None:
        """Prepare the site.

        Args:
            context: The context of the node.
            supervisor: Supervises the nodes of this launcher.
            folder: The folder in which the recorder of this site writes.
            sender: Returns the sender of recordings from a folder and a publish function; None if no package has it.
        """
        liveness = LivenessMonitor(context.clock, (f"{LINK}@slave",), "master")
        super().__init__(context, supervisor, liveness, (), "slave")
        self._pieces = None if sender is None else sender(folder, self.publish)
        self._deadline_ns = context.clock.monotonic_ns() + round(READY_DEADLINE_S * 1e9)

    def waiting(self) -> dict[str, str]:
        """Return the reason for each node that is not ready, except missing inputs, which the other site may send."""
        return unmet(self.nodes, self.health, inputs=False)

    def status_line(self) -> str:
        if self.phase in ("ending", "over"):
            return "stopping" if self.phase == "ending" else "stopped"
        site = self.liveness.site_name
        if not self.liveness.any_alive:
            silent = "is silent" if self.liveness.silent else "has not reported yet"
            return f"{site} {silent}, the nodes here wait for it; Ctrl-C stops them"
        if self.phase == "starting":
            return f"waiting for {len(self.waiting())} of {len(self.nodes)} nodes to be ready, {site} is alive"
        return f"running, {site} is alive and conducts; Ctrl-C stops the nodes here"

    def on_message(self, received: Received) -> None:
        super().on_message(received)
        if isinstance(received.message, ClockPing):
            self.liveness.record(received.message.src)

    def on_deadline(self, now_ns: int) -> None:
        super().on_deadline(now_ns)
        if self._pieces is not None:
            self._pieces.send_due(now_ns)

    def on_control(self, control: SessionControl) -> str:
        """Begin to send a part of the recording of this site; RefusedError states the fault of the command."""
        if control.command != "set":
            return super().on_control(control)
        if not control.parameters:
            raise RefusedError(
                "set needs the part of a recording to send: recording.file, .offset, .bytes and .kbit_per_s"
            )
        if self._pieces is None:
            package = KNOWN_PACKAGES["command bag fetch"]
            raise RefusedError(f"sending a recording is in the package {package}: {how_to_add_package(package)}")
        return self._pieces.request(control.parameters, self.clock.monotonic_ns())

    def make_safe(self) -> None:
        if self._pieces is not None:
            self._pieces.close()
        super().make_safe()

    def _hints(self, *nodes: str) -> str:
        # The tip is at this site, so only its hint is useful here, whichever node was lost.
        return super()._hints(TIP)

    def advance(self) -> None:
        """End if interrupted or if a node cannot be kept running; change to running when all nodes are ready."""
        if self.phase in ("starting", "running") and (self.failure or self.interrupted):
            self.phase = "ending"
            self.event("node", "info", "the site is stopped", answer_to="", interrupted=self.interrupted)
            self.context.request_stop()
        elif self.phase == "starting":
            self._advance_start()

    def _advance_start(self) -> None:
        waiting = self.waiting()
        if not waiting:
            self.phase = self.state = "running"
            return
        if self.clock.monotonic_ns() >= self._deadline_ns:
            reasons = "; ".join(f"{node} {reason}" for node, reason in waiting.items())
            last = [self.supervisor.log_tail_of(node) for node in waiting]
            self._failure = "\n".join([f"the site was not ready within {READY_DEADLINE_S:g} s: {reasons}", *last])
