"""Execution of `telenano up`: run a planned rig, and make figure and summary from its recording."""

import contextlib
import io
import logging
import os
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import Any

from telenano.analysis.figure_style import ON_SCREEN, FigureOptions
from telenano.extend.advice import AdvisedSession, Adviser
from telenano.launcher.advisers import Advisers, absent_laws, advisers_for
from telenano.launcher.external_recording import ExternalRecording, readable_here
from telenano.launcher.felt_adviser import FeltAdviser
from telenano.launcher.files_for_nodes import HeldForNodes
from telenano.launcher.plan import Plan
from telenano.launcher.processes import Inheritance, NodeProcesses, joint_command, node_command
from telenano.launcher.rig_node import RigNode
from telenano.launcher.rigs import RigName
from telenano.launcher.session import SessionNode
from telenano.launcher.site_node import SiteNode
from telenano.launcher.supervisor import Supervisor
from telenano.launcher.watchdog import ProcFiles, Watchdog
from telenano.recording.disk_watch import free_bytes
from telenano.recording.recorder_config import RecorderConfig
from telenano.recording.session_folder import SessionFolder
from telenano.recording.session_identity import SESSION_VARIABLE, given_identity
from telenano.runtime.bus.address_book import AddressBook
from telenano.runtime.bus.bus import ZmqBus
from telenano.runtime.bus.local_endpoint import RIG_VARIABLE
from telenano.runtime.bus.places import Places
from telenano.runtime.loop.kept_stop import forget
from telenano.runtime.loop.log import configure_logging
from telenano.runtime.loop.node import NodeContext
from telenano.runtime.loop.realtime import raise_file_limit, shallow_idle
from telenano.runtime.wiring.descriptors import check_rig
from telenano.runtime.wiring.link_transports import LineCheck, fetching_transport, link_transport
from telenano.runtime.wiring.participant import Participant, StopSignals
from telenano.sections.controller_section import ControllerConfig
from telenano.wire.errors import ConfigError, RecordingError, ReportError, RigError, TelenanoError
from telenano.wire.nodes import (
    DEVICES,
    FAR_RECORDER,
    KEEPERS,
    LINK,
    RECORDER,
    RELAY,
    STOP_ORDER,
    TIP,
    name_of,
    site_of,
)
from telenano.wire.printable import quoted

# Descriptors that a node has open at its start: the standard streams, the pair by which a signal wakes it, and the held
# table, site file and scenario.
_OPEN_AT_START = 8
Observer = Callable[[RigNode], None]
# Size of recordings from which the user is told that the report takes some time [bytes]: about a minute of a session.
_LONG_BYTES = 20_000_000
# Data rate of the recording of a whole rig by compression [bytes/s], measured, with a margin of a fifth.
_BYTES_PER_S = {"zstd": 600_000, "lz4": 1_200_000, "none": 3_500_000}


@dataclass(frozen=True)
class Outcome:
    """The end of a session.

    `recordings`: the files of the session in the order of their numbers, empty if none can be read on this machine;
    `note` then has the reason and their place. `restarts`: number of restarts of each own node. `missing`: a sentence
    for each part of the recording that is known to be missing. `bad_start`: the failure is a node that cannot start
    with its configuration.
    """

    failure: str
    interrupted: bool
    ran: bool
    recordings: tuple[Path, ...]
    note: str
    restarts: dict[str, int]
    missing: tuple[str, ...] = ()
    bad_start: bool = False
    # Sentences of recorders on files that were removed while they were written.
    removed: tuple[str, ...] = ()

    @contextlib.contextmanager
    def report_later(self, plan: Plan) -> Iterator[None]:
        """Turn Ctrl-C during the block into a RigError with the command that makes the report later.

        Without a recording of a session the KeyboardInterrupt is raised unchanged.
        """
        try:
            yield
        except KeyboardInterrupt as error:
            if not (self.ran and self.recordings):
                raise
            again = f"telenano report {' '.join(map(quoted, self.recordings))} --out {quoted(plan.out)}"
            raise RigError(f"interrupted while the report was made, `{again}` makes it") from error


def default_folder(scenario: str, now: datetime) -> Path:
    """Return the default folder of a session, named by scenario and local time."""
    return Path("sessions") / f"{Path(scenario).stem}-{now:%Y%m%d-%H%M%S}"


@contextlib.contextmanager
def reserved_folder(scenario: str, now: datetime) -> Iterator[Path]:
    """Create the default folder of a session, yield it, and remove it afterwards if it is empty.

    Rigs that start in the same second get different folders.
    """
    first = default_folder(scenario, now)
    for named in (first, *(first.with_name(f"{first.name}-{number}") for number in range(2, 100))):
        try:
            named.mkdir(parents=True)
        except FileExistsError:
            continue
        except OSError:
            # The first write to the folder will report the reason.
            pass
        break
    try:
        yield named
    finally:
        with contextlib.suppress(OSError):
            named.rmdir()


def run_rig(
    plan: Plan,
    observe: Observer,
    show: Callable[[str], None],
    beside: Mapping[str, Inheritance] | None = None,
    held: Sequence[int] = (),
    name: RigName | None = None,
) -> Outcome:
    """Run a planned rig from the first process to the last; TelenanoError if it could not begin.

    Args:
        plan: The planned rig.
        observe: Called with the node of the launcher at each tick, and while nodes are stopped, to update the view.
        show: Called with each line for the user.
        beside: The inheritance of further processes, by node. They run with the rig, which continues without them.
        held: Descriptors that every process inherits: the name and the processors of the rig (`own_rig`).
        name: The lock of the name, which is restored if it is removed (`own_rig`).
    """
    beside = {**(beside or {}), **_end_of_relay(plan)}
    nodes = (*plan.nodes, *beside)
    raise_file_limit()
    check_rig(plan.book, nodes, _OPEN_AT_START + len(held))
    signals = StopSignals()
    with contextlib.ExitStack() as stack:
        participant = stack.enter_context(Participant.open(plan.launcher, plan.book, signals.descriptor))
        # Bind the endpoint first: if another process has it, a rig runs already, and its files must not be changed.
        bus = participant.bus(SiteNode.inputs if plan.site == "slave" else SessionNode.inputs)
        if name is not None:
            participant.network.places.add(name)
        files_held = HeldForNodes(plan, participant.network.access_control)
        stack.callback(files_held.close)
        plan.prepare_folder()
        if warning := disk_warning(plan):
            show(f"warning: {warning}")
        log_directory = plan.out / "logs"
        files = plan.site_file, plan.scenario_file
        table = files_held.table
        commands = {node: node_command(node, *files, table) for node in nodes}
        joined = plan.joined
        for process, mates in joined.items():
            commands |= dict.fromkeys(mates, joint_command(process, mates, *files, table))
        clock = participant.clock
        epoch_ns = clock.epoch_offset_ns
        session = given_identity(os.environ.get(RIG_VARIABLE, ""), clock.now_ns(), conducts=plan.site != "slave")
        named = Inheritance(environment={SESSION_VARIABLE: session})
        inherited = {**{node: named for node in nodes if name_of(node) == name_of(RECORDER)}, **beside}
        children = NodeProcesses(
            commands,
            STOP_ORDER,
            log_directory,
            epoch_ns,
            lambda node: show(f"stopping {node}"),
            inherited,
            (*held, *files_held.descriptors),
            files_held.refresh,
            {node: process for process, mates in joined.items() for node in mates},
        )
        stack.callback(plan.remake_folder)
        stack.enter_context(own_log(log_directory / f"{plan.launcher}.log"))
        # This launcher hears the nodes of the other site, which run here as well, through the link.
        carriers = {node: f"{LINK}@master" for node in plan.nodes if site_of(node) != site_of(plan.launcher)}
        watchdog = Watchdog(clock, ProcFiles(), carriers)
        supervisor = Supervisor(clock, plan.nodes, children, watchdog, tuple(beside))
        rig = make_rig(plan, participant.context(bus), supervisor)
        rig.observe = observe
        rig.advisers = _advisers(plan, participant, name)
        if plan.site != "slave":
            # Only here is the session surely new: a slave's site may be restarted in the middle of a session.
            forget_stops(plan)
        stack.callback(_forget_own_stops, plan, participant.network.places)
        _run(rig, bus, signals)
    return outcome_of(rig, plan)


def _end_of_relay(plan: Plan) -> dict[str, Inheritance]:
    """Return the process of the relay's end at this site, with its inheritance; empty without a relay."""
    if not (plan.book.relay and plan.nodes and plan.site):
        return {}
    return {f"{RELAY}@{plan.site}": Inheritance()}


def forget_stops(plan: Plan) -> None:
    """Delete the stored emergency stops of the devices of a rig that is started, or has ended, as a whole.

    A stop that the link keeps for an instrument at another site remains, because that may run without having obeyed it.
    """
    nodes = set(plan.nodes) & set(KEEPERS if TIP in plan.nodes else DEVICES)
    for node in nodes:
        if (path := plan.book.kept_stop(node)) is not None:
            forget(path)


def _forget_own_stops(plan: Plan, places: Places) -> None:
    """Delete the stored stops at the end of a rig, unless the folder belongs to another rig by now."""
    if places.are_kept():
        forget_stops(plan)


def make_rig(plan: Plan, context: NodeContext, supervisor: Supervisor) -> RigNode:
    """Return the node of the launcher, which supervises the processes and, except at the slave's site, the session."""
    if plan.site == "slave":
        transport = fetching_transport()
        return SiteNode(context, supervisor, plan.out, None if transport is None else transport.sender)
    return SessionNode(
        context,
        supervisor,
        plan.scenario.duration_s,
        others=plan.others,
        site=plan.site or "",
        other_site="slave" if plan.site == "master" and not plan.attach else "",
        wait_s=plan.wait_s,
        recording=ExternalRecording(context.clock, RECORDER) if plan.attach else None,
        far=ExternalRecording(context.clock, FAR_RECORDER) if plan.fetches else None,
        on_far=SessionFolder(plan.out).note_far,
        line_check=line_check_of(plan),
    )


def line_check_of(plan: Plan) -> Callable[[Callable[[], int]], LineCheck | None]:
    """Return the function that makes the check of the line between two machines, as the link's transport does it.

    It makes None unless this launcher starts the nodes of the master's site, the slave's is on another machine, and the
    transport is installed.
    """
    if plan.site == "master" and not plan.attach and plan.book.spans_machines:
        with contextlib.suppress(ConfigError):
            return link_transport(plan.book.link.transport).line_check
    return lambda monotonic_ns: None


def _advisers(plan: Plan, participant: Participant, name: RigName | None) -> Advisers | None:
    """Return the advisers of a session; None if the launcher does not know its settings."""
    if plan.attach:
        return None
    try:
        controller = plan.loaded.section("controller", ControllerConfig)
    except ConfigError:
        return None
    now_ns = participant.clock.monotonic_ns
    session = AdvisedSession(controller, now_ns, absent_laws())
    tell = None if name is None else name.note
    felt = FeltAdviser(now_ns, controller, plan.sample_facts, tell)
    advisers: dict[str, Adviser] = {"felt stiffness": felt, **advisers_for(session, participant.log)}
    inputs = {topic for adviser in advisers.values() for topic in adviser.inputs}
    readers = participant.subscribers(advised_of(plan.book, plan.launcher, inputs), newest_only=True)
    return Advisers(participant.log, advisers, readers)


def advised_of(book: AddressBook, launcher: str, inputs: Collection[str]) -> dict[str, list[str]]:
    """Return the topics to subscribe to at each node for the advisers, as an observer of all reachable nodes does.

    The launcher's own subscriptions do not suffice: the link does not bring the other site's device samples to it.
    """
    heard = {node: [topic for topic in topics if topic in inputs] for node, topics in book.observed(launcher).items()}
    return {node: topics for node, topics in heard.items() if topics and node != launcher}


def _run(rig: RigNode, bus: ZmqBus, signals: StopSignals) -> None:
    with shallow_idle():
        try:
            rig.launch()
            signals.run(rig, bus, freeze=False)
        except OSError as error:
            raise RigError(f"the rig could not be run: {error}") from error
        finally:
            rig.supervisor.stop()


def outcome_of(rig: RigNode, plan: Plan) -> Outcome:
    """Return the outcome of a rig, with the files of its recording."""
    ran = isinstance(rig, SessionNode) and rig.ran
    note = ""
    missing = [f"{node}: {fault}" for node, fault in rig.recording_faults.items()]
    if isinstance(rig, SessionNode) and rig.recording is not None:
        recordings, note = _found(rig, rig.recording, plan) if ran else ((), "")
    else:
        recordings, unreadable = SessionFolder(plan.out).own()
        missing += unreadable
        missing += rig.not_recorded if isinstance(rig, SessionNode) else ()
    restarts, bad_start = rig.supervisor.restarts(), rig.supervisor.bad_start
    return Outcome(
        rig.failure,
        rig.interrupted,
        ran,
        recordings,
        note,
        restarts,
        tuple(missing),
        bad_start,
        tuple(rig.removed_recordings),
    )


def _found(session: SessionNode, recording: ExternalRecording, plan: Plan) -> tuple[tuple[Path, ...], str]:
    if not recording.path:
        return (), f"nothing was recorded: {recording.fault}"
    files = tuple(map(Path, recording.files))
    if readable_here(recording.path, session.start_id) and all(path.is_file() for path in files):
        return files, ""
    named = " ".join(recording.files)
    again = f"telenano report {' '.join(map(quoted, recording.files))} --out {quoted(plan.out)}"
    where = f"{recording.recorder} recorded the session to {named}"
    return (), f"{where}, which cannot be read from here: `{again}` there"


class _OwnLog(io.TextIOBase):
    """The launcher's own log, which is created again, with its folder, if it is removed."""

    def __init__(self, path: Path) -> None:
        """Begin an empty log; OSError if it cannot be written."""
        self._path = path
        self._file = path.open("w", encoding="utf-8")

    def write(self, text: str) -> int:
        """Append a text; if a removed log cannot be created again, write to the deleted file."""
        with contextlib.suppress(OSError):
            if not self._is_in_place():
                self._path.parent.mkdir(parents=True, exist_ok=True)
                again = self._path.open("a", encoding="utf-8")
                self._file.close()
                self._file = again
        return self._file.write(text)

    def flush(self) -> None:
        """Flush the buffer to the operating system."""
        self._file.flush()

    def fileno(self) -> int:
        """Return the descriptor of the present file."""
        return self._file.fileno()

    def close(self) -> None:
        """Close the file."""
        try:
            super().close()
        finally:
            self._file.close()

    def _is_in_place(self) -> bool:
        try:
            return os.path.samestat(os.fstat(self._file.fileno()), self._path.stat())
        except FileNotFoundError:
            return False


@contextlib.contextmanager
def own_log(path: Path) -> Iterator[None]:
    """Send the launcher's own log to a file while the block runs: the terminal belongs to the view."""
    log = _OwnLog(path)
    try:
        with contextlib.redirect_stderr(log):
            configure_logging(as_json=True)
        try:
            yield
        finally:
            # Later steps, such as the report, have no log: their result is printed.
            logging.getLogger().handlers.clear()
    finally:
        # On a full disk the last lines cannot be written.
        with contextlib.suppress(OSError):
            log.close()


def with_far_recording(outcome: Outcome, plan: Plan, show: Callable[[str], None]) -> Outcome:
    """Fetch the recording of the other site, and return the outcome with the joined recording of both.

    If the fetch fails or is interrupted, the outcome keeps the own recording, and `missing` names the command that
    continues the fetch.
    """
    transport, session = fetching_transport(), SessionFolder(plan.out)
    if transport is None or not (plan.fetches and outcome.ran and outcome.recordings):
        return outcome
    if not session.has_far:
        text = "the slave's site did not record the session: its fast messages are missing"
        return replace(outcome, missing=(*outcome.missing, text))
    command = f"telenano bag fetch {quoted(plan.out)} --site-file {quoted(plan.site_file)}"
    again = f"`{command}` continues"
    try:
        whole = transport.fetch(plan.book, session, plan.fetch_kbit_per_s, show)
    except TelenanoError as error:
        return replace(outcome, missing=(*outcome.missing, f"the slave's recording was not fetched: {error}; {again}"))
    except KeyboardInterrupt:
        return replace(outcome, missing=(*outcome.missing, f"the fetch of the slave's recording was ended; {again}"))
    return replace(outcome, recordings=(whole,))


def report_of(
    outcome: Outcome, plan: Plan, show: Callable[[str], None], options: FigureOptions = ON_SCREEN
) -> dict[str, Any] | None:
    """Make figure and summary of a session, and return the summary; None if it did not run or has no recording.

    Raises:
        RecordingError: A session that did not fail left a recording that cannot be reported.
        ReportError: The report cannot be written; the error has the summary.
    """
    recordings = outcome.recordings
    if not outcome.ran or not recordings:
        return None
    names = " ".join(map(quoted, recordings))
    show(f"making figure and summary from {names}" if plan.attach else "making figure and summary")
    # After Ctrl-C the user waits for the terminal, so even a short report is announced.
    is_long = outcome.interrupted or sum(path.stat().st_size for path in recordings if path.exists()) > _LONG_BYTES
    if is_long:
        again = "another Ctrl-C" if outcome.interrupted else "Ctrl-C"
        show(f"that takes some time; {again} leaves it to `telenano report {names} --out {quoted(plan.out)}`")
    # The import of matplotlib takes a second, so it is done only after the rig has ended.
    from telenano.analysis.report import write_report

    try:
        with outcome.report_later(plan):
            step = show if is_long else lambda step: None
            # All these files belong to the session that this launcher has conducted.
            return write_report(recordings, plan.out, outcome.missing, options, step, same_session=True)
    except RecordingError as error:
        # The failure of the rig is the cause, and is reported elsewhere.
        if outcome.failure:
            return None
        if isinstance(error, ReportError) or not outcome.removed:
            raise
        raise RecordingError("; ".join((str(error), *outcome.removed))) from error


def disk_warning(plan: Plan, free: Callable[[Path], int | None] = free_bytes) -> str:
    """Return a warning if the disk has less room than the recording is expected to need; else an empty string.

    It is empty too if `topics` or `exclude` limit the recording, because its size is then unknown. `free` returns the
    free space of the disk of a folder [bytes], or None.
    """
    recorders = [node for node in plan.nodes if node.startswith("recorder@")]
    config = plan.loaded.section("recorder", RecorderConfig)
    if not recorders or config.topics or config.exclude:
        return ""
    needed = round(_BYTES_PER_S[config.compression] * plan.scenario.duration_s)
    needed = min(needed, config.quota_bytes or needed)
    left = free(plan.out)
    if left is None or left >= needed:
        return ""
    return (
        f"the disk of {plan.out} has {left / 1e6:.1f} MB left, and a session of {plan.scenario.duration_s:g} s takes "
        f"about {needed / 1e6:.1f} MB: the recording may end before the session; give another --out"
    )
