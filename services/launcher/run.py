"""`telenano up`: from a sound plan to a recording, a figure and a summary."""

import contextlib
import logging
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import IO, Any

from proto.errors import RecordingError, RigError
from proto.nodes import LINK, RECORDER, STOP_ORDER
from services.launcher.external_recording import ExternalRecording, readable_here
from services.launcher.plan import Plan
from services.launcher.processes import NodeProcesses, node_command
from services.launcher.session import RigNode, SessionNode, SiteNode
from services.launcher.supervisor import Supervisor
from services.runtime.bus import ZmqBus
from services.runtime.log import configure_logging
from services.runtime.node import NodeContext
from services.runtime.participant import StopSignals, open_participant, run_loop
from services.runtime.realtime import shallow_idle

Observer = Callable[[RigNode], None]


@dataclass(frozen=True)
class Outcome:
    """How a session ended.

    `recording` is the file of the session, None where none can be read from here; `note` is then the reason, and where
    it is. `restarts` counts how often each own node was started again.
    """

    failure: str
    interrupted: bool
    ran: bool
    recording: Path | None
    note: str
    restarts: dict[str, int]


def default_folder(scenario: str, now: datetime) -> Path:
    """Return the folder of a session that none was named for: scenario and local time."""
    return Path("sessions") / f"{Path(scenario).stem}-{now:%Y%m%d-%H%M%S}"


def run_rig(plan: Plan, observe: Observer, show: Callable[[str], None]) -> Outcome:
    """Run a planned rig from the first process to the last; TelenanoError if it could not begin."""
    signals = StopSignals()
    with contextlib.ExitStack() as stack:
        participant = stack.enter_context(open_participant(plan.launcher, plan.book, signals.descriptor))
        # the endpoint first: whoever has it runs a rig already, whose files must not be touched
        bus = participant.bus(SiteNode.inputs if plan.site == "slave" else SessionNode.inputs)
        plan.prepare_folder()
        log_directory = plan.out / "logs"
        commands = {node: node_command(node, plan.site_file, plan.scenario_file) for node in plan.nodes}
        clock = participant.clock
        children = NodeProcesses(
            commands, STOP_ORDER, log_directory, clock.epoch_offset_ns, lambda node: show(f"stopping {node}")
        )
        stack.enter_context(own_log(log_directory / f"{plan.launcher}.log"))
        rig = make_rig(plan, participant.context(bus), Supervisor(clock, plan.nodes, children))
        rig.observe = observe
        _run(rig, bus, signals)
    return outcome_of(rig, plan)


def make_rig(plan: Plan, context: NodeContext, supervisor: Supervisor) -> RigNode:
    """Make the node that supervises the processes of a plan, and conducts the session unless another site does."""
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


def _run(rig: RigNode, bus: ZmqBus, signals: StopSignals) -> None:
    with shallow_idle():
        try:
            rig.launch()
            run_loop(rig, bus, signals, freeze=False)
        except OSError as error:
            raise RigError(f"the rig could not be run: {error}") from error
        finally:
            rig.supervisor.stop()


def outcome_of(rig: RigNode, plan: Plan) -> Outcome:
    """Return how it ended, and where the recording is."""
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
            # what follows, such as the report, has no log: its result is printed
            logging.getLogger().handlers.clear()


def report_of(outcome: Outcome, plan: Plan, show: Callable[[str], None]) -> dict[str, Any] | None:
    """Make figure and summary of a session that ran; None where there is nothing to make them from.

    Raises: RecordingError when a session that did not fail left a recording that cannot be reported.
    """
    recording = outcome.recording
    if not outcome.ran or recording is None:
        return None
    show(f"making figure and summary from {recording}" if plan.attach else "making figure and summary")
    try:
        return make_report(recording, plan.out)
    except RecordingError:
        # the failure of the rig is the cause, and is what is reported
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
