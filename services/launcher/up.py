"""`telenano up`: from a sound plan to a recording, a figure and a summary."""

import contextlib
import logging
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import IO, Any

import zmq

from services.launcher.errors import RigError
from services.launcher.plan import LAUNCHER, STOP_ORDER, Plan
from services.launcher.processes import NodeProcesses, node_command
from services.launcher.session import SessionNode
from services.runtime.bus import Publisher, Subscriber, ZmqBus
from services.runtime.clock import SystemClock
from services.runtime.errors import RecordingError
from services.runtime.log import StructuredLog, configure_logging
from services.runtime.node import NodeContext, NodeLoop, install_stop_signals
from services.runtime.realtime import RealtimeStatus, shallow_idle

Observer = Callable[[SessionNode], None]


@dataclass(frozen=True)
class Outcome:
    """How a session ended."""

    failure: str
    interrupted: bool
    ran: bool


def default_folder(scenario: str, now: datetime) -> Path:
    """Give the folder of a session that none was named for: scenario and local time."""
    return Path("sessions") / f"{Path(scenario).stem}-{now:%Y%m%d-%H%M%S}"


def run_rig(plan: Plan, observe: Observer, say: Callable[[str], None]) -> Outcome:
    """Run the rig from the first process to the last; EndpointError and RigError say why it could not begin."""
    clock = SystemClock()
    with zmq.Context[zmq.Socket[bytes]]() as context, contextlib.ExitStack() as stack:
        # the endpoint first: whoever has it runs a rig already, whose files must not be touched
        publisher = Publisher(context, clock, LAUNCHER, plan.book.endpoint(LAUNCHER))
        stack.callback(publisher.close)
        plan.prepare_folder()
        log_directory = plan.out / "logs"
        commands = {node: node_command(node, plan.site_file, plan.scenario_file) for node in plan.nodes}
        children = NodeProcesses(
            commands, STOP_ORDER, log_directory, clock.epoch_offset_ns, lambda node: say(f"stopping {node}")
        )
        stack.enter_context(own_log(log_directory / f"{LAUNCHER}.log"))
        by_endpoint = {
            plan.book.endpoint(node): topics
            for node, topics in plan.book.sources(LAUNCHER, list(SessionNode.inputs)).items()
        }
        subscriber = Subscriber(context, clock, by_endpoint)
        stack.callback(subscriber.close)
        return _conduct(plan, clock, publisher, subscriber, children, observe)


def _conduct(
    plan: Plan,
    clock: SystemClock,
    publisher: Publisher,
    subscriber: Subscriber,
    children: NodeProcesses,
    observe: Observer,
) -> Outcome:
    stop_asked: list[SessionNode] = []

    def stop() -> None:
        # the descriptor ends every wait until it is read, and this loop goes on waiting after a signal
        with contextlib.suppress(BlockingIOError):
            os.read(wake, 64)
        for asked in stop_asked:
            asked.interrupt()

    wake = install_stop_signals(stop)
    bus = ZmqBus(publisher, [subscriber], clock, wake)
    node_context = NodeContext(LAUNCHER, clock, bus, StructuredLog(LAUNCHER))
    session = SessionNode(node_context, plan.nodes, children, plan.scenario.duration_s, observe=observe)
    stop_asked.append(session)
    loop = NodeLoop(session, bus, RealtimeStatus(fifo=False, memory_locked=False))
    session.finish = loop.stop
    with shallow_idle():
        try:
            session.launch()
            loop.run()
        except OSError as error:
            raise RigError(f"the rig could not be run: {error}") from error
        finally:
            children.stop()
    return Outcome(session.failure, session.interrupted, session.ran)


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
    if not outcome.ran or not plan.recording.exists():
        return None
    say("making figure and summary")
    try:
        return make_report(plan.recording, plan.out)
    except RecordingError:
        # the failure of the rig is the cause, and is what the person is told
        if outcome.failure:
            return None
        raise
    except KeyboardInterrupt as error:
        again = f"telenano report {plan.recording} --out {plan.out}"
        raise RigError(f"interrupted while the report was made, `{again}` makes it") from error


def make_report(recording: Path, out: Path) -> dict[str, Any]:
    """Make figure and summary from a recording; what the recording lacks ends in a TelenanoError."""
    # matplotlib takes a second to import, which a running rig should not pay
    from services.launcher.report import write_report

    return write_report(recording, out)
