"""A planned session in virtual time, in which the launcher's real node starts, arms, runs and stops the nodes.

    plan = make_plan(UpRequest(scenario="fig12", out=Path("out")), Path("out"))
    outcome = SimulatedRig(plan, seed=7).run()

The recording is in the folder of the plan.
"""

import json
import traceback
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

from telenano.console.send_commands import asked
from telenano.launcher.plan import Plan
from telenano.launcher.processes import StopObserver
from telenano.launcher.rig_node import RigNode
from telenano.launcher.run import Outcome, outcome_of
from telenano.launcher.session import SessionNode
from telenano.launcher.supervisor import Supervisor
from telenano.recording.disk import OWN_DISK, Disk, FolderDisk
from telenano.recording.recorder_config import RecorderConfig
from telenano.runtime.loop.commands import Command, CommandClient
from telenano.runtime.loop.deadlines import PeriodicDeadline
from telenano.runtime.loop.node import Node, NodeContext
from telenano.runtime.loop.node_loop import STARTING_PERIOD_NS, NodeLoop
from telenano.runtime.wiring.main import EXIT_BAD_START, EXIT_DIED
from telenano.sections.afm_section import AfmConfig
from telenano.sections.hand_section import HapticConfig
from telenano.timing.clock import NEVER_NS
from telenano.virtual.bus import VirtualBus
from telenano.virtual.rig import Engine
from telenano.virtual.timing import RANDOM_TIMING, Timing
from telenano.wire.errors import ConfigError, TelenanoError
from telenano.wire.messages import SessionEvent
from telenano.wire.nodes import FAR_RECORDER, LAUNCHER, RECORDER, STOP_ORDER, name_of
from telenano.wire.received import Received

CONSOLE = "console@master"
# folder of the other site's recorder, within that of the session
FAR_FOLDER = "far"
# time in which the last messages of a node arrive after its end [ns]
_DELIVERY_NS = 5_000_000
# time in which a recorder receives the last messages before it is stopped [ns]
_LAST_MESSAGES_NS = 20_000_000
# period of a console [ns]
_CONSOLE_NS = 20_000_000


class TimedCommand(NamedTuple):
    """A command that a person gives at a console, at a time after the start of the force profile [s]."""

    time_s: float
    command: Command


class ConsoleNode(Node):
    """A console that sends commands at fixed times, as a person would."""

    inputs: ClassVar[tuple[str, ...]] = ("session/event", "node/health")
    period_s = _CONSOLE_NS * 1e-9

    def __init__(
        self, context: NodeContext, commands: Sequence[TimedCommand], elapsed_s: Callable[[], float | None]
    ) -> None:
        """Prepare to send commands; `elapsed_s` returns the time since the force profile started [s], None before."""
        super().__init__(context)
        self._waiting = sorted(commands, key=lambda timed: timed.time_s)
        self._elapsed_s = elapsed_s
        # A command to a pattern waits for further answers while the next commands are sent.
        self._clients: list[CommandClient] = []
        self._ticks = PeriodicDeadline(self.clock.monotonic_ns(), _CONSOLE_NS)
        # A sentence for each command that failed.
        self._failures: list[str] = []

    @property
    def failures(self) -> tuple[str, ...]:
        """A sentence for each command that failed, or whose time did not come."""
        late = (
            f"{command.name} {command.target}: the session ended before {time_s:g} s"
            for time_s, command in self._waiting
        )
        return (*self._failures, *late)

    def deadline_ns(self) -> int:
        return self._ticks.deadline_ns

    def on_message(self, received: Received) -> None:
        if isinstance(received.message, SessionEvent):
            for client in self._clients:
                client.on_event(received.message)

    def on_deadline(self, now_ns: int) -> None:
        self._ticks.advance(now_ns)
        elapsed_s = self._elapsed_s()
        while elapsed_s is not None and self._waiting and elapsed_s >= self._waiting[0].time_s:
            command = self._waiting.pop(0).command
            self._clients.append(CommandClient(self.clock, self.publish, [command], token=self.context.machine.token))
        for client in [client for client in self._clients if client.advance()]:
            self._clients.remove(client)
            self._failures += [client.failure] if client.failure else []

    def make_safe(self) -> None:
        """Do nothing: a console moves no device."""


class VirtualProcesses:
    """The nodes of a rig in virtual time, with the interface through which a supervisor manages processes."""

    def __init__(self, rig: "SimulatedRig", folder: Path) -> None:
        self._rig, self._folder = rig, folder
        self._ended: dict[str, int] = {}
        self._ready_ns = 0

    def start(self, node: str) -> int:
        """Start a node after those that are starting, and return 1; it takes its first turn when it has started."""
        rig = self._rig
        now_ns = rig.clock.monotonic_ns()
        try:
            rig.start(node, starting_period_ns=STARTING_PERIOD_NS)
        except TelenanoError as error:
            rig.log_of(node).error(str(error))
            self._ended[node] = EXIT_BAD_START
            return 1
        self._ready_ns = max(self._ready_ns, now_ns) + rig.draw(rig.timing.start, "start", node)
        rig.stall(node, (self._ready_ns - now_ns) * 1e-9)
        return 1

    def died(self, node: str, exit_code: int = EXIT_DIED) -> None:
        """Record the end of a node by a failed turn, or, with a negative code, by a signal to its process."""
        self._ended[node] = exit_code

    def reap(self) -> dict[str, int]:
        ended, self._ended = self._ended, {}
        return ended

    def kill(self, node: str) -> None:
        """Do nothing: a hanging node would stop the rig itself."""

    def log_tail(self, node: str) -> str:
        return "\n".join(self._rig.log_of(node).lines)

    def log_path(self, node: str) -> Path:
        return self._folder / "logs" / f"{node}.log"

    def stop(self, observer: StopObserver) -> None:
        """Stop the nodes in order, recorders last, each after the last messages of the one before have arrived."""
        rig = self._rig
        running = [node for node in STOP_ORDER if node in rig.loops]
        for node in (node for node in running if name_of(node) != name_of(RECORDER)):
            rig.end(node)
            rig.let_pass(_DELIVERY_NS)
            observer.wait([node], 0.0, 0.0)
        rig.let_pass(_LAST_MESSAGES_NS)
        for node in (node for node in running if name_of(node) == name_of(RECORDER)):
            rig.end(node)
            rig.let_pass(_DELIVERY_NS)


class SimulatedRig(Engine):
    """A session of a plan in virtual time.

    Args:
        plan: The checked rig; every node runs here.
        seed: The seed of all delays on the sites and of the lateness of loops.
        timing: Those delays.
        disk: The disk of the recorders.
        commands: The commands of a person at a console while the session runs.
        far: Whether each site has its own recorder for the messages that it sends.

    Raises:
        ConfigError: The scenario has a real device.
    """

    def __init__(
        self,
        plan: Plan,
        seed: int,
        timing: Timing = RANDOM_TIMING,
        *,
        disk: Disk = OWN_DISK,
        commands: Sequence[TimedCommand] = (),
        far: bool = False,
    ) -> None:
        _require_simulated(plan)
        super().__init__(
            plan.loaded,
            seed,
            timing,
            scenario_file=plan.scenario_file,
            site_file=plan.site_file,
            disk=FolderDisk(plan.out, disk),
            counts_inputs=True,
        )
        # The commands are part of the metadata, because the session depends on them.
        given = [(time_s, one.name, one.target, str(dict(one.parameters))) for time_s, one in commands]
        self.facts["simulation"]["commands"] = json.dumps(sorted(given))
        self.plan = plan
        nodes = (*([FAR_RECORDER] if far else ()), *plan.nodes)
        self._processes = VirtualProcesses(self, plan.out)
        supervisor = Supervisor(self.clock, nodes, self._processes)
        bus = VirtualBus(self, LAUNCHER, SessionNode.inputs)
        self.launcher = SessionNode(self.wiring(LAUNCHER).context(bus), supervisor, plan.scenario.duration_s)
        self.console: ConsoleNode | None = None
        self.run_node(LAUNCHER, self.launcher, bus)
        if commands:
            console = VirtualBus(self, CONSOLE, ConsoleNode.inputs)
            given_to = [TimedCommand(time_s, self._asking(command, nodes)) for time_s, command in commands]
            self.console = ConsoleNode(self.wiring(CONSOLE).context(console), given_to, self._elapsed_s)
            self.run_node(CONSOLE, self.console, console)

    def _asking(self, command: Command, nodes: Sequence[str]) -> Command:
        """Return a command with the nodes of this rig that have to answer it; ConfigError if there are none."""
        expected = tuple(node for node in asked(self.book, command).near if node in nodes)
        if not expected:
            raise ConfigError(f"{command.name}: no node of this rig is meant by {command.target!r}")
        return replace(command, expected=expected)

    def run(self, observe: Callable[[RigNode], None] = lambda node: None) -> Outcome:
        """Run the session and return its outcome; `observe` is called with the launcher at each of its ticks."""
        self.plan.prepare_folder()
        self.launcher.observe = observe
        loop = self.loops[LAUNCHER]
        try:
            self.launcher.launch()
            self.advance(NEVER_NS)
        finally:
            # The launcher takes no more turns, but stops the nodes, which still take theirs.
            self._due_of.pop(LAUNCHER, None)
            self.is_over = False
            loop.end()
            self.close()
        return outcome_of(self.launcher, self.plan)

    @property
    def failed_commands(self) -> tuple[str, ...]:
        """A sentence for each command at the console that failed, with the reason."""
        return () if self.console is None else self.console.failures

    def turn(self, key: str, loop: NodeLoop) -> None:
        """Run one turn of a node; if it fails, the launcher restarts the node, as it does a process."""
        try:
            loop.turn_now()
        except (Exception, SystemExit) as error:
            if key == LAUNCHER:
                raise
            self.log_of(key).error("".join(traceback.format_exception_only(error)).strip())
            loop.report_failure(error)
            self.end(key)
            self._processes.died(key)
        if key == LAUNCHER and loop.node.context.stop_requested:
            self.is_over = True

    def end(self, key: str) -> None:
        """End a node, which makes its device safe, publishes its last message, and takes no more turns."""
        loop = self.loops[key]
        loop.node.context.request_stop()
        try:
            loop.end()
        # The device of a package may fail here, but the other nodes must be stopped.
        except (Exception, SystemExit) as error:  # noqa: BLE001
            self.log_of(key).error("".join(traceback.format_exception_only(error)).strip())
        self.leave(key)

    def let_pass(self, duration_ns: int) -> None:
        """Advance the time [ns] for the nodes that still run."""
        self.advance(self.clock.monotonic_ns() + duration_ns)

    def config_of(self, key: str, config: Any) -> Any:
        """Return the section of a node: a recorder writes to the folder of the session, or to that of its site."""
        if isinstance(config, RecorderConfig):
            return config.model_copy(update={"directory": Path(FAR_FOLDER if key == FAR_RECORDER else "")})
        return config

    def _elapsed_s(self) -> float | None:
        return self.launcher.elapsed_s if self.launcher.ran else None


def _require_simulated(plan: Plan) -> None:
    """Raise ConfigError if the scenario has a real device, which cannot run in virtual time."""
    haptic = plan.loaded.section("haptic_node", HapticConfig)
    afm = plan.loaded.section("afm_node", AfmConfig)
    for section, driver, simulated in (
        ("haptic_node", haptic.driver, haptic.simulated),
        ("afm_node", afm.driver, afm.simulated),
    ):
        if not simulated:
            raise ConfigError(
                f"{plan.loaded.origin}: {section}.driver: {driver} drives a real device or a wire, which has no "
                "virtual time: give a simulated driver, or run the session with `telenano up`"
            )


def absence_of(plan: Plan) -> str:
    """Return a warning if the operator of a plan is a person, who cannot take part in virtual time; else empty."""
    haptic = plan.loaded.section("haptic_node", HapticConfig)
    if haptic.operator.kind != "interactive":
        return ""
    return (
        f"{plan.loaded.origin}: haptic_node.operator.kind: interactive is a person, and none takes part in virtual "
        "time: nothing pushes the hand; give another operator, or run the session with `telenano up`"
    )
