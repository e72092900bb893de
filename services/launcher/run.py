"""`telenano up`: from a sound plan to a recording, a figure and a summary."""

import contextlib
import logging
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import IO, Any

import zmq

from proto.errors import RecordingError, RigError
from proto.nodes import LINK, RECORDER, STOP_ORDER
from services.launcher.external_recording import ExternalRecording, readable_here
from services.launcher.plan import Plan
from services.launcher.processes import NodeProcesses, node_command
from services.launcher.session import RigNode, SessionNode, SiteNode
from services.launcher.supervisor import Supervisor
from services.runtime.bus import ZmqBus
from services.runtime.clock import Clock, SystemClock
from services.runtime.log import StructuredLog, configure_logging
from services.runtime.node import NodeContext, NodeLoop, install_stop_signals
from services.runtime.realtime import RealtimeStatus, shallow_idle
from services.runtime.transport import Transport

Observer = Callable[[RigNode], None]


@dataclass(frozen=True)
class Outcome:
    """How a session ended.

    `recording` is the file of the session, None where none can be read from here; `note` then says why, and where it
    is. `restarts` counts how often each own node was started again.
    """

    failure: str
    interrupted: bool
    ran: bool
    recording: Path | None
    note: str
    restarts: dict[str, int]


def default_folder(scenario: str, now: datetime) -> Path:
    """Give the folder of a session that none was named for: scenario and local time."""
    return Path("sessions") / f"{Path(scenario).stem}-{now:%Y%m%d-%H%M%S}"


def run_rig(plan: Plan, observe: Observer, say: Callable[[str], None]) -> Outcome:
    """Run what a plan says from the first process to the last; TelenanoError says why it could not begin."""
    clock = SystemClock()
    stopper = _Stopper()
    with zmq.Context[zmq.Socket[bytes]]() as context, contextlib.ExitStack() as stack:
        # the endpoint first: whoever has it runs a rig already, whose files must not be touched
        inputs = SiteNode.inputs if plan.site == "slave" else SessionNode.inputs
        bus = open_bus(context, clock, plan, inputs, stopper.wake)
        stack.callback(bus.close)
        plan.prepare_folder()
        log_directory = plan.out / "logs"
        commands = {node: node_command(node, plan.site_file, plan.scenario_file) for node in plan.nodes}
        children = NodeProcesses(
            commands, STOP_ORDER, log_directory, clock.epoch_offset_ns, lambda node: say(f"stopping {node}")
        )
        stack.enter_context(own_log(log_directory / f"{plan.launcher}.log"))
        node_context = NodeContext(plan.launcher, clock, bus, StructuredLog(plan.launcher))
        rig = make_rig(plan, node_context, Supervisor(clock, plan.nodes, children))
        rig.observe = observe
        _run(rig, bus, stopper)
    return outcome_of(rig, plan)


def open_bus(
    context: "zmq.Context[zmq.Socket[bytes]]", clock: Clock, plan: Plan, inputs: Sequence[str], wake: int
) -> ZmqBus:
    """Bind the launcher's endpoint and connect to what it hears; EndpointError names who has the endpoint."""
    book = plan.book
    network = Transport(context, clock, book, book.machine_of(plan.launcher))
    try:
        publisher = network.publisher(plan.launcher)
    except BaseException:
        network.close()
        raise
    subscribers = network.subscribers(book.sources(plan.launcher, list(inputs)))
    return ZmqBus(publisher, subscribers, clock, wake, network)


def make_rig(plan: Plan, context: NodeContext, supervisor: Supervisor) -> RigNode:
    """Make the node that looks after what the plan says, and conducts its session unless another site does."""
    if plan.site == "slave":
        return SiteNode(context, supervisor, link=f"{LINK}@slave", site="slave", other_site="master")
    return SessionNode(
        context,
        supervisor,
        plan.scenario.duration_s,
        others=plan.others,
        site=plan.site or "",
        other_site="slave" if plan.site == "master" and not plan.attach else "",
        wait_s=plan.wait_s,
        recording=ExternalRecording(context.clock, RECORDER) if plan.attach else None,
    )


class _Stopper:
    """Takes the stop signals from the first moment on; the rig hears of them once there is one."""

    def __init__(self) -> None:
        self.rig: RigNode | None = None
        self._asked = False
        self.wake = install_stop_signals(self._stop)

    def attach(self, rig: RigNode) -> None:
        self.rig = rig
        if self._asked:
            rig.interrupt()

    def _stop(self) -> None:
        self._asked = True
        # the descriptor ends every wait until it is read, and this loop goes on waiting after a signal
        with contextlib.suppress(BlockingIOError):
            os.read(self.wake, 64)
        if self.rig is not None:
            self.rig.interrupt()


def _run(rig: RigNode, bus: ZmqBus, stopper: _Stopper) -> None:
    loop = NodeLoop(rig, bus, RealtimeStatus(fifo=False, memory_locked=False))
    rig.finish = loop.stop
    stopper.attach(rig)
    with shallow_idle():
        try:
            rig.launch()
            loop.run()
        except OSError as error:
            raise RigError(f"the rig could not be run: {error}") from error
        finally:
            rig.supervisor.stop()


def outcome_of(rig: RigNode, plan: Plan) -> Outcome:
    """Say how it ended, and where the recording is."""
    ran = isinstance(rig, SessionNode) and rig.ran
    recording: Path | None = plan.recording if plan.recording.exists() else None
    note = ""
    if isinstance(rig, SessionNode) and rig.recording is not None:
        recording, note = _found(rig, rig.recording, plan) if ran else (None, "")
    return Outcome(rig.failure, rig.interrupted, ran, recording, note, rig.supervisor.restarts())


def _found(session: SessionNode, recording: ExternalRecording, plan: Plan) -> tuple[Path | None, str]:
    if not recording.path:
        return None, f"nothing was recorded: {recording.fault}"
    if readable_here(recording.path, session.start_id):
        return Path(recording.path), ""
    again = f"telenano report {recording.path} --out {plan.out}"
    where = f"{recording.recorder} recorded the session to {recording.path}"
    return None, f"{where}, which cannot be read from here: `{again}` there"


@contextlib.contextmanager
def own_log(path: Path) -> Iterator[IO[str]]:
    """Send the launcher's own log to a file while the block runs: the terminal belongs to the view."""
    with path.open("w", encoding="utf-8") as log:
        with contextlib.redirect_stderr(log):
            configure_logging(as_json=True)
        try:
            yield log
        finally:
            # what follows, such as the report, has no log: it speaks to the person through its result
            logging.getLogger().handlers.clear()


def report_of(outcome: Outcome, plan: Plan, say: Callable[[str], None]) -> dict[str, Any] | None:
    """Make figure and summary of a session that ran; None where there is nothing to make them from.

    Raises: RecordingError when a session that did not fail left a recording that cannot be reported.
    """
    recording = outcome.recording
    if not outcome.ran or recording is None:
        return None
    say(f"making figure and summary from {recording}" if plan.attach else "making figure and summary")
    try:
        return make_report(recording, plan.out)
    except RecordingError:
        # the failure of the rig is the cause, and is what the person is told
        if outcome.failure:
            return None
        raise
    except KeyboardInterrupt as error:
        again = f"telenano report {recording} --out {plan.out}"
        raise RigError(f"interrupted while the report was made, `{again}` makes it") from error


def make_report(recording: Path, out: Path) -> dict[str, Any]:
    """Make figure and summary from a recording; what the recording lacks ends in a TelenanoError."""
    # matplotlib takes a second to import, which a running rig should not pay
    from analysis.report import write_report

    return write_report(recording, out)
