"""Figure and summary of a session, from its recording alone."""

import json
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial, reduce
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from telenano.afm.section_config import SafetyConfig
from telenano.analysis.conditions import conditions, described, title
from telenano.analysis.fig12 import SessionSeries, TipStates, fig12_files
from telenano.analysis.figure_style import ON_SCREEN, FigureOptions
from telenano.analysis.holds import (
    ANSWERS,
    LATE_S,
    NO_CONTEXT,
    SHORTEST_HOLD_S,
    TIP,
    Guard,
    Hold,
    Incident,
    Instrument,
    Lack,
    Late,
    Limits,
    SessionContext,
    gaps_in,
    guard_of,
    hold_forces,
    judge_holds,
    lacks_of,
    verdict_of,
)
from telenano.analysis.interruptions import Interruption, ModeReport, in_words, interruptions_of
from telenano.analysis.intervals import half_width, with_error
from telenano.analysis.line_states import line_states
from telenano.analysis.mean_interval import mean_half_width
from telenano.analysis.missing import recording_facts
from telenano.analysis.summary import Summary
from telenano.files.atomic_files import whole_results
from telenano.files.strict_json import finite
from telenano.hand.config import LimitsConfig, recorded_hand
from telenano.hand.operator_config import ForceProfileConfig, InteractiveConfig
from telenano.laws.config import KNOWN_LAWS, ControllerConfig
from telenano.recording.arrays import in_step
from telenano.recording.info import RecordingInfo
from telenano.recording.messages import LeftOut, RecordedMessage, readable
from telenano.recording.multi_file import RecordingSource, open_recordings
from telenano.recording.silence import HAND, LONGEST_STEP_S, Break, breaks_of, ends_of, joined, running_of, sent_of
from telenano.recording.site_clock import Timeline
from telenano.settings.config import validate
from telenano.settings.package_topics import row_of
from telenano.settings.scenario import LoadedScenario, Scenario
from telenano.timing import loop_age
from telenano.wire import extras
from telenano.wire.errors import RecordingError, ReportError
from telenano.wire.nodes import HAND as HAND_NODE
from telenano.wire.nodes import LAUNCHER, LINK, RECORDER, START_ORDER, name_of

Series = npt.NDArray[Any]

RELEASE_WINDOW_S = 1.0
# A difference of two clocks that is below one period of the loop shows in no figure.
_LOOP_PERIOD_S = 1e-3
_DECLARED_LOOP_HZ = 1000.0
_WITHDRAWN = ("retracting", "retracted", "estop")
# A program of the instrument runs in these states.
_RUNS = ("running", "paused")
# The first step of a program is reported this long after it.
_FIRST_STEP_S = 0.01
# The percentiles of the loop's age are taken of this number of parts of a session.
_AGE_PARTS = 10
# A part needs this number of answers.
_LEAST_AGES = 100
# Below this number of samples a share of a stage says nothing.
_LEAST_FOLLOWED = 50
_ALARMS = ("warning", "error")
# A press rises and falls by more than this part of the greatest force: less is a tremor or noise.
_LEAST_SHARE = 0.1
# A press also rises and falls by more than this.
_LEAST_N = 0.1
# A launcher that is busy reports the end of a process this long after it [s].
_EXIT_WITHIN_S = 2.0
_NOT_RESTARTED = "its force profile was not started again, which `telenano session start` does"
# A sentence names the source of a topic by these words.
_SOURCES = {HAND: "the hand", TIP: "the AFM"}
_COMMAND = "haptic/command"
_HAND_FIELDS = ("seq", "log_ns", "session_s", "mode", "operator_force_n.2", "position_m.2")
_ANSWER_FIELDS = ("answered_seq", "answered_t_ns", "answered_at_ns")
_COMMAND_FIELDS = ("seq", "position_m.2", "force_n.2")
_TIP_FIELDS = (
    "seq", "tip_force_n.2", "base_position_m.2", "separation_m", "separation_valid", "in_contact", "meniscus",
    "limited", "mode", "placed",
)  # fmt: skip


@dataclass(frozen=True)
class Session:
    """The part of a recording in which the operator's force profile ran, and the series that the report needs.

    `missing` has a sentence for each end of it that the recording lacks; `context` is what is known of its holds
    besides the series; `breaks` are the times in which a series has no sample; `timeline` puts stamps on the master's
    clock, on which the series are; `otherwise` is the same session with the measured offset of the slave's clock taken
    off, where that is neither shown to be right nor wrong.
    """

    start_ns: int
    end_ns: int
    hand: dict[str, Series]
    command: dict[str, Series]
    tip: dict[str, Series]
    force_scale: float
    scenario: str
    conditions: dict[str, Any]
    timeline: Timeline
    missing: tuple[str, ...] = ()
    context: SessionContext = NO_CONTEXT
    breaks: tuple[Break, ...] = ()
    otherwise: "Session | None" = None
    knows_contact: bool = True

    @property
    def duration_s(self) -> float:
        return (self.end_ns - self.start_ns) * 1e-9

    def gaps_s(self) -> tuple[tuple[float, float], ...]:
        """Return the spans of the session [s] in which samples of a series are missing."""
        return joined(self.breaks, lost=True)

    def series(self, gaps_s: tuple[tuple[float, float], ...] = ()) -> SessionSeries:
        return SessionSeries(
            gaps_s=gaps_s,
            hand_time_s=self._time_s(self.hand),
            hand_force_n=-self.hand["operator_force_n.2"],
            hand_position_m=-self.hand["position_m.2"],
            reference_time_s=self._time_s(self.command),
            reference_m=-self.command["position_m.2"],
            tip_time_s=self._time_s(self.tip),
            tip_force_n=self.tip["tip_force_n.2"],
            separation_m=np.where(self.tip["separation_valid"], self.tip["separation_m"], np.nan),
            force_scale=self.force_scale,
            states=TipStates(
                np.isin(self.tip["mode"], ("follow", "hold")),
                *(self.tip[name].astype(bool) for name in ("limited", "in_contact", "meniscus")),
            ),
        )

    @classmethod
    def of(cls, recording: RecordingSource) -> "Session":
        """Read the last session that a recording holds; RecordingError when the operator's force profile never ran.

        The slave's stamps are put on the master's clock where the clocks are shown to differ
        (`telenano.recording.site_clock`). Where they may, by more than a period of the loop, the session has both
        readings.
        """
        timeline = Timeline(recording)
        session = _read_session(recording, timeline)
        clock = timeline.clock
        if clock is None or clock.applied or abs(clock.offset_s) < _LOOP_PERIOD_S:
            return session
        other = _read_session(recording, timeline.with_clock(clock._replace(applied=True)))
        return replace(session, otherwise=other)

    @property
    def origin(self) -> str:
        """The conditions of the session in words, for the inside of a file."""
        return described(self.scenario, self.conditions)

    def lacks(self, span_s: tuple[float, float]) -> list[Lack]:
        """Return what a hold from a start to an end [s] lacks so much of that there is no telling what became of it."""
        series = self.series()
        return lacks_of(series.hand_time_s, series.tip_time_s, span_s, self.context)

    def summary(
        self, recording: RecordingSource, missing: Sequence[str] = (), left_out: LeftOut | None = None
    ) -> dict[str, Any]:
        """Return the summary of the session, with the keys of `Summary`; what the session does not show is null.

        All messages of its recording are read once. `missing` has sentences on what is known to be missing besides;
        `left_out` has what the reader of the session could not take where that was another one.
        """
        unread = LeftOut()
        info, sent, overruns = _counted(self, recording, unread)
        series, holds, judged = _judged(self)
        interruptions = self.context.interruptions
        age_parts = _loop_age_parts(self.split_age(recording))
        for reader in (recording.left_out, *([] if left_out is None else [left_out])):
            unread.add(reader)
        missing = [*self.missing, *_lacking(self, series, holds, info), *missing, *unread.sentences()]
        last_s = self.duration_s - RELEASE_WINDOW_S
        samples = {
            "hold_ratio": _hold_ratios(self, holds),
            "contact_x_cm": 100.0 * series.reference_m[series.reference_time_s >= last_s],
            "release_force_nn": 1e9 * series.tip_force_n[series.tip_time_s >= last_s],
        }
        ages_ms = _loop_ages_ms(self)
        summary = {
            "scenario": self.scenario,
            **self.conditions,
            "duration_s": round(self.duration_s, 3),
            **judged,
            "contact_x_cm": _mean(samples["contact_x_cm"]),
            "release_force_nn": _rounded(_mean(samples["release_force_nn"])),
            "greatest_pull_nn": float(1e9 * series.tip_force_n.min(initial=0.0)) if series.tip_force_n.size else None,
            "tip_holds": sum(one.kind == "tip_held" for one in interruptions),
            "hand_let_go": sum(one.kind == "hand_let_go" for one in interruptions),
            "processes_ended": sum(one.kind == "process_ended" for one in interruptions),
            "sources_silent": sum(one.kind == "source_silent" for one in interruptions),
            "interruptions": [one._asdict() for one in interruptions],
            "hand_cycles": cycles_of(series.hand_force_n),
            "loop_age_ms": _loop_age_ms(ages_ms),
            **age_parts,
            "intervals": _intervals(samples, ages_ms),
            "overruns": overruns,
            "rate_hz": {name: round(count / self.duration_s, 3) for name, count in sent.items()},
            "completeness": _completeness(
                sent,
                self.duration_s,
                1.0 / LoadedScenario.attached(recording.path, recording.attachments).scenario.period_s,
            ),
            "seq_gaps": _gaps(info),
            "contact_known": self.knows_contact,
            "holds": [{**hold._asdict(), "facts": [fact._asdict() for fact in hold.facts]} for hold in holds],
            "clocks": _clocks(self),
            "recording": recording_facts(info, self.start_ns, missing, unread.beyond_range()),
        }
        return Summary.model_validate(finite(summary)).model_dump(exclude_unset=True)

    def clock_error_s(self, stage: str) -> float:
        """Return the bound of the error of a part of `split_age` by the two clocks [s]; 0 for one within a site."""
        clock = self.timeline.clock
        return 0.0 if clock is None or stage not in loop_age.ACROSS_CLOCKS else clock.uncertainty_s

    def split_age(self, recording: RecordingSource) -> dict[str, Series]:
        """Return the parts of the age of each sample of the hand that an answer came to [s], by name; none of too few.

        A sample is followed by its own stamp, which every message that descends from it carries. What is conflated on
        the way has no answer, and does not count. Stamps of the slave are put on the master's clock; what the clocks
        leave open makes one way longer and the other one shorter, and nothing of the sum.

        Args:
            recording: The master's recording of the session.
        """
        # A topic is followed at its publisher, or else as the link brought it.
        channel_of = {
            each.topic: each for each in sorted(recording.channels, key=lambda each: each.channel_topic, reverse=True)
        }
        topics = [topic for topic in loop_age.STAGES if topic in channel_of]
        if not topics or "link/delay" not in channel_of:
            return {}
        hand = recording.columns("haptic/state", ("t_ns", "answered_t_ns", "answered_at_ns", "sample_age_s"))
        ways = []
        for topic in topics:
            sent = recording.columns(channel_of[topic].channel_topic, ("hand_t_ns", "publish_ns"))
            at_ns = self.timeline.times_ns(channel_of[topic].src, sent["publish_ns"].astype(np.int64))
            ways.append(_first(sent["hand_t_ns"], at_ns))
        ways.append(_first(hand["answered_t_ns"], hand["answered_at_ns"]))
        keys = reduce(np.intersect1d, [own for own, _ in ways])
        keys = keys[(keys >= max(self.start_ns, 1)) & (keys <= self.end_ns)]
        if keys.size < _LEAST_FOLLOWED:
            return {}
        passed_ns = np.column_stack([keys, *(at_ns[np.searchsorted(own, keys)] for own, at_ns in ways)])
        series = recording.columns("link/delay", ("direction", "hand_t_ns", "delay_ns", "transit_ns"))
        delays, datagrams = {}, _datagrams(recording, self.timeline)
        for way in loop_age.WAYS:
            # The newest delay that was said of a sample counts from that sample on.
            of_way = {name: values[series["direction"] == way][::-1] for name, values in series.items()}
            from_ns, place = np.unique(of_way["hand_t_ns"], return_index=True)
            at = np.searchsorted(from_ns, keys, side="right")
            added_ns, line_ns = (np.concatenate(([0], of_way[name][place]))[at] for name in ("delay_ns", "transit_ns"))
            if way in datagrams and (sender := f"teleop/{way}") in topics:
                due_ns = passed_ns[:, topics.index(sender) + 1] + added_ns
                line_ns = np.maximum(line_ns, loop_age.took_from(due_ns, *datagrams[way]))
            delays[way] = loop_age.Delay(added_ns, line_ns)
        device_s = dict(zip(hand["t_ns"].tolist(), np.nan_to_num(hand["sample_age_s"]).tolist(), strict=True))
        return loop_age.split(passed_ns, topics, delays, np.array([device_s.get(key, 0.0) for key in keys.tolist()]))

    def _time_s(self, series: Mapping[str, Series]) -> npt.NDArray[np.float64]:
        return np.asarray((series["t_ns"] - self.start_ns) * 1e-9, dtype=np.float64)


def write_report(
    path: Path | Sequence[Path],
    out: Path,
    missing: Sequence[str] = (),
    options: FigureOptions = ON_SCREEN,
    show: Callable[[str], None] = lambda text: None,
    *,
    same_session: bool = False,
) -> dict[str, Any]:
    """Write `fig12.png` and `summary.json` of a recording, or of the parts of one, to a folder.

    Args:
        path: The recording, or the parts of one.
        out: The folder that the report is written to.
        missing: Sentences on what is known to be missing besides what the recording itself shows.
        options: The formats and the style of the figure.
        show: Called with what is done next, each of which takes seconds for a recording of minutes.
        same_session: Whether files are joined of which it is not recorded that they are of one session.

    Returns:
        The summary.

    Raises:
        RecordingError: A file lacks something, or two are not of one session; the message names them.
        ReportError: A file cannot be written, and none is left half written; or the figure needs a package that is
            not installed, and the summary is written without it. The error has the summary.
    """
    paths = [path] if isinstance(path, Path) else path
    # What is missing is found by reading the whole; the session by the index, which takes half of the time.
    recording = open_recordings(paths, same_session=same_session)
    indexed = open_recordings(paths, by_index=True, same_session=same_session)
    show("1 of 3: reading the session")
    session = Session.of(indexed)
    show(f"2 of 3: reading all messages of its {session.duration_s:.0f} s, and judging")
    summary = session.summary(recording, missing, indexed.left_out)
    show("3 of 3: drawing the figure")
    # a node that stood still leaves a gap as well, which is no fault of the recording
    gaps_s = () if summary["recording"]["complete"] else session.gaps_s()
    text = json.dumps(summary, indent=2, allow_nan=False) + "\n"
    figures: dict[str, bytes] = {}
    undrawn = ""
    try:
        figures = fig12_files(session.series(gaps_s), figure_title(session, summary), options, session.origin)
    except ModuleNotFoundError as error:
        undrawn = f"{out / 'summary.json'} is written, and no figure is drawn: {extras.missing(error.name or '')}"
    write_files(out, {**figures, "summary.json": text.encode()}, summary)
    if undrawn:
        raise ReportError(undrawn, summary)
    return summary


def write_files(folder: Path, files: Mapping[str, bytes], summary: Mapping[str, Any] | None = None) -> None:
    """Write all files of a folder or none of them.

    Raises:
        ReportError: One cannot be written; the message names it, and the error has the summary.
    """
    try:
        with whole_results(folder) as part:
            for name, data in files.items():
                # An error of a full disk does not name its file.
                try:
                    (part / name).write_bytes(data)
                except OSError as error:
                    raise OSError(error.errno, error.strerror, str(folder / name)) from error
    except OSError as error:
        raise ReportError(f"{error.filename}: cannot be written: {error.strerror}", dict(summary or {})) from error


def _read_session(recording: RecordingSource, timeline: Timeline) -> Session:
    hand = _series(recording, HAND, (*_HAND_FIELDS, *_ANSWER_FIELDS), timeline)
    running = running_of(recording, hand)
    if running.size < 2:
        raise RecordingError(f"{recording.path}: the operator's force profile never ran in it, so there is no session")
    start_ns = int(hand["t_ns"][running[0]] - round(hand["session_s"][running[0]] * 1e9))
    end_ns = int(hand["t_ns"][running[-1]])
    document = LoadedScenario.attached(recording.path, recording.attachments).scenario
    facts = conditions(recording, document, start_ns, end_ns, timeline)
    if lines := lines_of(recording, timeline, start_ns, end_ns):
        facts["lines"] = lines
    if states := line_states(recording, timeline, start_ns, end_ns):
        facts["line_states"] = states
    ends = ends_of(recording, hand, running)
    seconds = (end_ns - start_ns) * 1e-9
    # a hand that falls silent is due until its force profile or the recording is over
    due_s = max(seconds, min(document.duration_s, seconds + (ends.silent_s or 0.0)))
    command = _series(recording, _COMMAND, _COMMAND_FIELDS, timeline)
    tip = _series(recording, TIP, _TIP_FIELDS, timeline)
    breaks = _breaks(recording, {HAND: hand, TIP: tip, _COMMAND: command}, start_ns, {HAND: due_s}, seconds)
    hand = {name: values[running] for name, values in hand.items()}
    new = (hand["answered_t_ns"] > 0) & (np.diff(hand["answered_seq"], prepend=-1) != 0)
    tip = _within(tip, start_ns, end_ns)
    silences = [one for one in breaks if not one.lost and one.topic in _SOURCES]
    reported = _reported(recording, timeline, start_ns)
    return Session(
        start_ns=start_ns,
        end_ns=end_ns,
        hand=hand,
        command=_within(command, start_ns, end_ns),
        tip=tip,
        force_scale=facts["parameters"]["force_scale"],
        scenario=document.name,
        conditions=facts,
        timeline=timeline,
        missing=ends.cut,
        breaks=tuple(breaks),
        context=SessionContext(
            # A hold that was planned after the end of a recording that is cut off was not cut short by the operator.
            planned_holds(document, max(seconds, document.duration_s) if ends.is_cut else due_s),
            (hand["t_ns"][new] - start_ns) * 1e-9,
            reported.guards,
            reported.incidents,
            _limits(document, facts["changed"]),
            _programs(recording, timeline, start_ns, end_ns),
            is_by_hand(document),
            _interruptions(hand, tip, reported, silences, start_ns, end_ns),
            sorted([*_late(hand, start_ns), *_late(tip, start_ns)]),
            _deadline_s(document),
            _transit_s(hand),
            _rest_force(document, facts, f"{recording.path}: scenario.yaml"),
            [(one.topic, one.start_s, one.end_s) for one in silences],
            _let_go(hand, start_ns),
        ),
        knows_contact=_knows_contact(document, tip["separation_m"]),
    )


def _late(series: Mapping[str, Series], start_ns: int) -> list[Late]:
    """Return when in the session a process was late with a sample, and by how much; a lost sample is not late."""
    steps_s = 1e-9 * np.diff(series["t_ns"])
    if not steps_s.size:
        return []
    late_s = steps_s - float(np.median(steps_s))
    late_places = 1 + np.flatnonzero((late_s > LATE_S) & (np.diff(series["seq"]) == 1))
    return [Late((int(series["t_ns"][i - 1]) - start_ns) * 1e-9, float(late_s[i - 1])) for i in late_places.tolist()]


def _deadline_s(document: Scenario) -> float:
    """Return the longer of the times without a command after which the devices open the loop [s]."""
    hand = validate(LimitsConfig, document.haptic_node.get("limits", {}), "scenario.yaml", "haptic_node.limits")
    safety = validate(SafetyConfig, document.afm_node.get("safety", {}), "scenario.yaml", "afm_node.safety")
    return max(hand.command_deadline_s, safety.command_deadline_s)


def _transit_s(hand: Mapping[str, Series]) -> float:
    """Return how long a command is in transit at the most, there and back [s]: 99 times in 100."""
    ages_ns = (hand["answered_at_ns"] - hand["answered_t_ns"])[hand["answered_t_ns"] > 0]
    return 1e-9 * float(np.percentile(ages_ns, 99.0)) if ages_ns.size else LONGEST_STEP_S


def _rest_force(document: Scenario, facts: Mapping[str, Any], origin: str) -> Callable[[float], float] | None:
    """Return what the law rests at; None where it does not say, or was changed while the session ran."""
    if len(facts["law"]) != 1 or any("controller" in change for change in facts["changed"]):
        return None
    rest_force = KNOWN_LAWS[facts["law"][0]].rest_force
    section = {**document.controller_in_force, "law": facts["law"][0]}
    params = validate(ControllerConfig, section, origin, "controller").params()
    return None if rest_force is None else partial(rest_force, params)


def _knows_contact(document: Scenario, separation_m: Series) -> bool:
    """Return whether the instrument measures contact: a spring, a recorded map, and a controller without h do not."""
    section = document.afm_node
    of_map = section.get("environment") == "spring" or bool((section.get("sample") or {}).get("map"))
    return not of_map and bool(np.isfinite(separation_m).any())


def _programs(recording: RecordingSource, timeline: Timeline, start_ns: int, end_ns: int) -> list[tuple[float, float]]:
    """Return from when to when the instrument ran programs of its own, in session time [s]."""
    programs, begun_s = [], None
    reports = recording.select(lambda channel: channel.topic == "afm/program" and channel.via == "direct")
    for report, fields in readable(reports, recording.left_out):
        at_ns = int(timeline.times_ns(report.src, np.array([report.publish_ns], dtype=np.int64))[0])
        at_s, runs = (at_ns - start_ns) * 1e-9, fields["state"] in _RUNS
        if runs and begun_s is None:
            # its first step is reported before it
            begun_s = at_s - _FIRST_STEP_S
        elif not runs and begun_s is not None:
            programs.append((begun_s, at_s))
            begun_s = None
    return programs if begun_s is None else [*programs, (begun_s, (end_ns - start_ns) * 1e-9)]


def _limits(document: Scenario, changed: Sequence[str]) -> Limits | None:
    """Return what the guard of the instrument allows, None where that was changed while the session ran."""
    if any("afm_node.safety." in change for change in changed):
        return None
    # the rest of the section may belong to a package
    safety = validate(SafetyConfig, document.afm_node.get("safety", {}), "scenario.yaml", "afm_node.safety")
    return Limits(safety.force_limit_n, safety.command_deadline_s + safety.hold_time_s)


def planned_holds(scenario: Scenario, end_s: float) -> list[tuple[float, float, float]]:
    """Return start [s], end [s] and force [N] of each stretch of constant force up to an end [s].

    Only a hand that is a force has them in its force profile: what an arm or a person presses with is known from what
    was recorded alone.

    Raises:
        ConfigError: A key of the scenario cannot be read; the message names it.
    """
    operator, _ = recorded_hand(scenario.haptic_node, "scenario.yaml")
    if not isinstance(operator, ForceProfileConfig):
        return []
    corners = [(point.time_s, point.force_n) for point in operator.points]
    # The force is zero before the first corner, and stays at the last one.
    corners = [(min(0.0, corners[0][0]), 0.0), (corners[0][0], 0.0), *corners]
    corners.append((max(end_s, corners[-1][0]), corners[-1][1]))
    holds: list[tuple[float, float, float]] = []
    for (first_s, force_n), (last_s, then_n) in pairwise(corners):
        if force_n != then_n:
            continue
        if holds and holds[-1][1] == first_s and holds[-1][2] == force_n:
            first_s = holds.pop()[0]
        holds.append((first_s, last_s, force_n))
    cut = [(max(0.0, first_s), min(last_s, end_s), force_n) for first_s, last_s, force_n in holds]
    return [hold for hold in cut if hold[1] - hold[0] >= SHORTEST_HOLD_S]


def is_by_hand(scenario: Scenario) -> bool:
    """Return whether a person presses, at a page or at a device, whose hand gives way to what the loop does.

    Raises:
        ConfigError: A key of the scenario cannot be read; the message names it.
    """
    operator, simulated = recorded_hand(scenario.haptic_node, "scenario.yaml")
    return isinstance(operator, InteractiveConfig) or not simulated


class _Reported(NamedTuple):
    """What devices reported of their modes, launchers of nodes and sites, and the link, all in session time [s]."""

    guards: list[Guard]
    incidents: list[Incident]
    held: list[ModeReport]
    let_go: list[ModeReport]
    exits: list[tuple[str, Incident]]


def _reported(recording: RecordingSource, timeline: Timeline, start_ns: int) -> _Reported:
    events = recording.select(lambda channel: channel.topic == "session/event" and channel.via == "direct")
    reports = _Reported([], [], [], [], [])
    for event, fields in readable(events, recording.left_out):
        name, data, kind, text = name_of(event.src), fields["data"], fields["kind"], fields["text"]
        at_ns = int(timeline.times_ns(event.src, np.array([event.publish_ns], dtype=np.int64))[0])
        at_s = (at_ns - start_ns) * 1e-9
        report = ModeReport(at_s, str(data.get("mode", "")), str(data.get("reason", text)))
        if name == "afm_node" and kind == "mode" and report.mode in _WITHDRAWN:
            reports.guards.append(Guard(at_s, str(data.get("reason", ""))))
        elif kind == "mode" and report.mode in ("hold", "off"):
            (reports.held if name == "afm_node" else reports.let_go).append(report)
        elif "outside" in data:
            # It is advice, and no cause of what happened to a device.
            continue
        elif name in (name_of(LAUNCHER), LINK) and kind in ("node", "link") and fields["level"] in _ALARMS:
            reports.incidents.append(Incident(at_s, text))
            if "exit_code" in data:
                reports.exits.append((str(data.get("about_node", "")), reports.incidents[-1]))
    return reports


def _breaks(
    recording: RecordingSource,
    series: Mapping[str, Mapping[str, Series]],
    start_ns: int,
    due_s: Mapping[str, float],
    length_s: float,
) -> list[Break]:
    """Return when a session has no samples of its series, in session time [s]; due_s: until when one is due."""
    sent, breaks = sent_of(recording), []
    for topic, values in series.items():
        src = next((channel.src for channel in recording.channels if channel.channel_topic == topic), "")
        times_s = (values["t_ns"] - start_ns) * 1e-9
        span_s = (0.0, due_s.get(topic, length_s))
        numbers = values["seq"].astype(np.int64)
        breaks += breaks_of(topic, times_s, numbers, span_s, sent.get((topic, src)), is_closed=recording.closed)
    return breaks


def _let_go(hand: Mapping[str, Series], start_ns: int) -> list[tuple[float, float]]:
    """Return from when to when [s] the motor of the hand was off in a session."""
    time_s, is_off = (hand["t_ns"] - start_ns) * 1e-9, hand["mode"] == "off"
    edges = np.flatnonzero(np.diff(is_off, prepend=False, append=False)).reshape(-1, 2).tolist()
    return [(float(time_s[first]), float(time_s[min(after, len(time_s) - 1)])) for first, after in edges]


def _interruptions(
    hand: Mapping[str, Series],
    tip: Mapping[str, Series],
    reported: _Reported,
    silences: Sequence[Break],
    start_ns: int,
    end_ns: int,
) -> list[Interruption]:
    """Return what interrupted the loop while the session ran, in session time [s] and in the order of time."""
    hand_s, tip_s = ((series["t_ns"] - start_ns) * 1e-9 for series in (hand, tip))
    length_s = (end_ns - start_ns) * 1e-9
    # a hand that is gone at the end has ended after its last sample
    last_s = max([length_s, *(one.end_s for one in silences)])
    restarts = (1 + np.flatnonzero(np.diff(hand["seq"]) <= 0)).tolist()
    interruptions = interruptions_of("hand_let_go", hand_s, hand["mode"] == "off", reported.let_go, restarts)
    interruptions += interruptions_of("tip_held", tip_s, tip["mode"] == "hold", reported.held)
    exits = [(node, incident) for node, incident in reported.exits if 0.0 <= incident.time_s <= last_s]
    for first in restarts:
        begins_s, runs = float(hand_s[first - 1]), np.flatnonzero(hand["session_s"][first:] >= 0.0)
        own = [exit for exit in exits if exit[0] == HAND_NODE and abs(exit[1].time_s - begins_s) < _EXIT_WITHIN_S]
        text = own[0][1].text if own else f"the process of {HAND_NODE} ended and was started again"
        ends_s = float(hand_s[first + runs[0]]) if runs.size else length_s
        then = f"its force profile began again at {ends_s:.3f} s" if runs.size else _NOT_RESTARTED
        interruptions.append(Interruption("process_ended", begins_s, ends_s, f"{text}; {then}"))
        exits = [exit for exit in exits if exit not in own]
    interruptions += [
        Interruption("source_silent", one.start_s, one.end_s, f"{_SOURCES[one.topic]} sent nothing")
        for one in silences
        # the end of the hand's process is told as such
        if not (one.topic == HAND and one.anew)
    ]
    interruptions += [
        Interruption("process_ended", incident.time_s, incident.time_s, incident.text)
        for node, incident in exits
        if node in (*START_ORDER, RECORDER)
    ]
    return sorted(interruptions, key=lambda one: one.start_s)


def was_placed(placed: Series) -> npt.NDArray[np.bool_]:
    """Return whether the tip had been placed by then: what it meets before it is there is no contact of the hand.

    Args:
        placed: What the instrument says of it, shape (n,), NaN where it does not say it, as in older recordings.
    """
    is_placed = np.asarray(placed, dtype=np.float64)
    if np.isnan(is_placed).all():
        return np.ones(is_placed.shape, dtype=np.bool_)
    return np.asarray(np.maximum.accumulate(np.nan_to_num(is_placed) > 0.0), dtype=np.bool_)


def _judged(session: Session) -> tuple[SessionSeries, list[Hold], dict[str, Any]]:
    """Return the series of a session, its holds, and what depends on how the clocks of two sites are read."""
    series = session.series()
    scaled = session.force_scale * series.tip_force_n
    mode = session.tip["mode"]
    hand_m = np.interp(series.tip_time_s, series.hand_time_s, series.hand_position_m)
    tip = Instrument(
        np.isin(mode, ("follow", "hold")),
        session.tip["in_contact"].astype(bool) & was_placed(session.tip["placed"]),
        np.isin(mode, ("hold",)),
        hand_m + session.tip["base_position_m.2"] / session.conditions["parameters"]["position_scale"],
        session.knows_contact,
    )
    holds = judge_holds(series.hand_time_s, series.hand_force_n, series.tip_time_s, scaled, tip, session.context)
    guard = guard_of(series.tip_time_s, tip, session.context)
    greatest_n = float(np.abs(series.hand_force_n).max(initial=0.0))
    verdict, reason = verdict_of(holds, guard, greatest_n, in_words(session.context.interruptions))
    # a hold whose fate is not known cannot be said to be unstable
    stable = None if verdict in ("cannot_say", "no_data") else verdict == "stable"
    judged = {"stable": stable, "verdict": verdict, "reason": reason, "hold_ratio": _mean(_hold_ratios(session, holds))}
    return series, holds, judged


def _lacking(session: Session, series: SessionSeries, holds: Sequence[Hold], info: RecordingInfo) -> list[str]:
    """Return a sentence for each loss that makes a hold one without data, as long as it is in the session.

    What was left out by a reader is in the recording, and is not lacking.
    """
    context = session.context
    whole_topics = {one.channel_topic for one in info.channels if not one.lost} if info.closed else set()
    times = {HAND: series.hand_time_s, TIP: series.tip_time_s, ANSWERS: context.answered_s}
    # The holds after the end of a recording that ends early are lacking as well.
    end_s = max([session.duration_s, *(hold.end_s for hold in holds)])
    sentences = []
    for hold in holds:
        lacks = lacks_of(series.hand_time_s, series.tip_time_s, (hold.start_s, hold.end_s), context)
        for lack in [one for one in lacks if one.lost and one.topic not in whole_topics]:
            own = times[lack.topic]
            whole = gaps_in(series.hand_time_s if own is None else own, 0.0, end_s)
            sentences += [
                str(lack._replace(start_s=a, end_s=b)) for a, b in whole if a < lack.end_s and b > lack.start_s
            ]
    return list(dict.fromkeys(sentences))


def _clocks(session: Session) -> dict[str, Any] | None:
    """Return what the slave's clock was ahead, and the figures of the other reading where it cannot be excluded."""
    clock = session.timeline.clock
    if clock is None:
        return None
    return {
        "offset_s": round(clock.offset_s, 6),
        "uncertainty_s": round(clock.uncertainty_s, 6),
        "drift_ppm": round(1e6 * clock.drift, 1),
        "applied": clock.applied,
        "reason": clock.reason,
        "otherwise": None if session.otherwise is None else _judged(session.otherwise)[2],
    }


def lines_of(recording: RecordingSource, timeline: Timeline, start_ns: int, end_ns: int) -> list[dict[str, Any]]:
    """Return the figures of each direction while the session ran; none without reports of a queue or of a block."""
    reports: dict[str, dict[tuple[str, int], Mapping[str, Any]]] = {}
    channels = recording.select(lambda channel: channel.topic == "link/network")
    for message, fields in readable(channels, recording.left_out):
        first_ns, last_ns = (timeline.stamp_ns(message.src, end) for end in (start_ns, end_ns))
        # The report of the slave is in the master's recording twice, as it came and through the link.
        is_known = fields.get("queue_s") is not None or fields.get("blocked_since_ns") is not None
        if first_ns <= message.publish_ns <= last_ns and is_known:
            reports.setdefault(fields["direction"], {})[message.src, message.seq] = fields
    reports_of_way = {way: list(channels.values()) for way, channels in reports.items()}
    # Whether a line is full says who sends over it, and that is who receives the other direction.
    others = {"forward": "backward", "backward": "forward"}
    figures = [
        _line_figures(way, own, reports_of_way.get(others[way], []))
        for way, own in sorted(reports_of_way.items(), reverse=True)
    ]
    for way in figures:
        begin_ns = timeline.stamp_ns(reports_of_way[way["direction"]][0]["src"], start_ns)
        way["blocked_s"] = _blocked_s(reports_of_way[way["direction"]], begin_ns)
    return figures


def _blocked_s(reports: list[Mapping[str, Any]], begin_ns: int) -> list[list[float]]:
    """Return when none of the datagrams of a direction arrived though they were sent, from and to [s]."""
    spans: dict[int, int] = {}
    for report in reports:
        if (since_ns := report.get("blocked_since_ns")) is not None:
            spans[since_ns] = report["t_ns"]
    return [[round((at_ns - begin_ns) * 1e-9, 3) for at_ns in span] for span in spans.items()]


def _line_figures(way: str, reports: list[Mapping[str, Any]], of_sender: list[Mapping[str, Any]]) -> dict[str, Any]:
    first, last = reports[0], reports[-1]
    queues_ms = [1e3 * (report.get("queue_s") or 0.0) for report in reports]
    settled, lost = (last.get("settled") or 0) - (first.get("settled") or 0), max(0, last["lost"] - first["lost"])
    capacity = last.get("capacity_bit_per_s")
    return {
        "direction": way,
        "queue_max_ms": round(max(queues_ms), 2),
        "full_share": round(sum(report.get("line") == "full" for report in of_sender) / max(1, len(of_sender)), 3),
        "capacity_mbit": None if capacity is None else round(capacity * 1e-6, 3),
        "datagrams_per_s": round((last["sent"] - first["sent"]) / max(1e-9, (last["t_ns"] - first["t_ns"]) * 1e-9), 1),
        "lost_share": round(min(1.0, lost / settled), 4) if settled > 0 else None,
    }


def cycles_of(force_n: npt.NDArray[np.float64]) -> int:
    """Return how often a force [N], of shape (n,), rose and then fell again, by a tenth of its greatest."""
    least_n = max(_LEAST_N, _LEAST_SHARE * float(np.abs(force_n).max(initial=0.0)))
    cycles, rises, turn_n = 0, False, float(force_n[0]) if force_n.size else 0.0
    for now_n in force_n.tolist():
        turn_n = max(turn_n, now_n) if rises else min(turn_n, now_n)
        if abs(now_n - turn_n) > least_n:
            cycles += rises
            rises, turn_n = not rises, now_n
    return cycles


def _counted(
    session: Session, recording: RecordingSource, left_out: LeftOut
) -> tuple[RecordingInfo, dict[str, int], int]:
    """Return what a recording holds, and of its session the messages sent by channel and the deadlines missed."""
    # the session by the clock of each source
    spans: dict[str, list[int]] = {}
    sent: dict[str, int] = {}
    overruns: dict[str, list[int]] = {}

    def see(message: RecordedMessage) -> None:
        src, name = message.src, message.channel_topic
        if src not in spans:
            spans[src] = [session.timeline.stamp_ns(src, end_ns) for end_ns in (session.start_ns, session.end_ns)]
        if spans[src][0] <= message.publish_ns < spans[src][1]:
            sent[name] = sent.get(name, 0) + 1
            if name == "node/health":
                overruns.setdefault(src, []).extend(each["overruns"] for _, each in readable((message,), left_out))

    info = recording.info(see)
    return (
        info,
        dict(sorted(sent.items())),
        sum(max(0, counts[-1] - counts[0]) for counts in overruns.values() if counts),
    )


def _completeness(sent: Mapping[str, int], duration_s: float, loop_rate_hz: float) -> dict[str, float]:
    """Return the recorded share of the declared number of messages, for channels of one source and a rate.

    The topics of the loop are declared at 1 kHz, and have the rate of the scenario.
    """
    shares = {}
    for name, count in sent.items():
        topic = row_of(name.partition("@")[0])
        if topic is not None and topic.rate_hz is not None and "*" not in topic.publishers:
            # Both ends of the session may fall between two messages.
            rate_hz = loop_rate_hz if topic.rate_hz == _DECLARED_LOOP_HZ else topic.rate_hz
            shares[name] = min(1.0, round(count / (rate_hz * duration_s), 5))
    return shares


def _datagrams(recording: RecordingSource, timeline: Timeline) -> dict[str, tuple[Series, Series]]:
    """Return by direction when each datagram that arrived had left, rising, and how long it took [ns]."""
    by_name: dict[str, list[Series]] = {}
    for message, _ in readable(recording.messages(("link/network",)), LeftOut()):
        report: Any = message.decode()
        arrived = report.lost_flag.to_numpy() == 0
        if report.clock.valid and arrived.any():
            took_ns, at_ns = (each.to_numpy()[arrived] for each in (report.delay_ns, report.arrived_ns))
            left_ns = timeline.times_ns(message.src, at_ns) - took_ns
            by_name.setdefault(report.direction, []).append(np.column_stack([left_ns, took_ns]))
    rows = {way: np.concatenate(parts) for way, parts in by_name.items()}
    return {way: tuple(each[np.argsort(each[:, 0])].T) for way, each in rows.items()}


def _first(keys: Series, values: Series) -> tuple[Series, Series]:
    """Return each key once, in their order, with the first value of it."""
    found, place = np.unique(keys, return_index=True)
    return found, values[place]


def _hold_ratios(session: Session, holds: Sequence[Hold]) -> Series:
    """Return F_m/(alpha_f F_s) of each sample at rest in the last hold that has such a ratio; none where none has."""
    own = next((hold for hold in reversed(holds) if hold.hold_ratio is not None), None)
    if own is None:
        return np.empty(0)
    series = session.series()
    hand_n, tip_n = hold_forces(
        own, series.hand_time_s, series.hand_force_n, series.tip_time_s, session.force_scale * series.tip_force_n
    )
    return hand_n / tip_n


def _loop_ages_ms(session: Session) -> Series:
    """Return the age of the first answer to each sample of the hand, on the hand's own clock, in the order of time."""
    # Samples are matched by their stamps, because a restarted device uses its numbers again.
    sampled_ns, answered_ns = _first(session.hand["answered_t_ns"], session.hand["answered_at_ns"])
    return np.asarray((answered_ns - sampled_ns)[sampled_ns >= session.start_ns] * 1e-6)


def _loop_age_ms(ages_ms: Series) -> dict[str, float] | None:
    if ages_ms.size == 0:
        return None
    p50, p99 = np.percentile(ages_ms, [50.0, 99.0])
    return {"p50": round(float(p50), 4), "p99": round(float(p99), 4), "max": round(float(ages_ms.max()), 4)}


def _loop_age_parts(split_s: Mapping[str, Series]) -> dict[str, Any]:
    if not split_s:
        return {}
    parts = loop_age.parts_of(split_s)
    # a simulated device has no age, and on one machine there is no line
    parts_ms = {part.name: [round(1e3 * each, 4) for each in (part.p50_s, part.p99_s)] for part in parts if part.p99_s}
    return {"loop_age_parts_ms": parts_ms, "loop_age_largest": loop_age.in_words(parts)}


def _intervals(samples: Mapping[str, Series], ages_ms: Series) -> dict[str, list[float]]:
    """Return the interval of each mean, and of the percentiles of the loop's age by those of parts of the session.

    A mean whose record does not say how well it is known has none.
    """
    halves = {name: mean_half_width(values) for name, values in samples.items()}
    means = {name: (float(samples[name].mean()), half) for name, half in halves.items() if half is not None}
    if ages_ms.size >= _AGE_PARTS * _LEAST_AGES:
        parts = np.array([np.percentile(part, [50.0, 99.0]) for part in np.array_split(ages_ms, _AGE_PARTS)])
        for name, of_parts in zip(("p50", "p99"), parts.T, strict=True):
            half = half_width(float(np.std(of_parts, ddof=1)), _AGE_PARTS)
            means[f"loop_age_{name}_ms"] = (float(np.percentile(ages_ms, float(name[1:]))), half)
    return {name: [round(mean - half, 9) + 0.0, round(mean + half, 9) + 0.0] for name, (mean, half) in means.items()}


def _gaps(info: RecordingInfo) -> dict[str, int]:
    gaps = Counter[str]()
    for channel in info.channels:
        gaps[channel.channel_topic] += channel.gaps
    return dict(sorted(gaps.items()))


def _mean(values: Series) -> float | None:
    return float(values.mean()) if values.size else None


def _rounded(force_nn: float | None) -> float | None:
    """Return a force to a millionth of a nN: what is less is what the equilibrium of the cantilever is found to."""
    # the sum makes a -0.0 plain
    return None if force_nn is None else round(force_nn, 6) + 0.0


def _series(
    recording: RecordingSource, channel_topic: str, fields: Sequence[str], timeline: Timeline
) -> dict[str, Series]:
    """Return fields and `t_ns`, on the master's clock; no samples where the recording has none of tip or commands."""
    src = next((channel.src for channel in recording.channels if channel.channel_topic == channel_topic), None)
    if src is None and channel_topic != "haptic/state":
        return {name: np.empty(0, np.int64 if name == "t_ns" else np.float64) for name in ("t_ns", *fields)}
    series = recording.columns(channel_topic, ("t_ns", *fields))
    series["t_ns"] = timeline.times_ns(src or "", series["t_ns"].astype(np.int64))
    kept = in_step(series["t_ns"])
    return series if kept.all() else {name: values[kept] for name, values in series.items()}


def _within(series: dict[str, Series], start_ns: int, end_ns: int) -> dict[str, Series]:
    inside = (series["t_ns"] >= start_ns) & (series["t_ns"] <= end_ns)
    return {name: values[inside] for name, values in series.items()}


def figure_title(session: Session, summary: Mapping[str, Any]) -> str:
    """Return the title of the figure of a session: conditions, verdict, and whether something is missing."""
    # A motion that drifts, or presses with another force, is not stable either, and does not oscillate.
    verdict = summary["verdict"].replace("_", " ")
    ratio = summary["hold_ratio"]
    error = summary.get("intervals", {}).get("hold_ratio")
    # the ratio of one hold is no merit of a session that another one decides
    is_held = ratio is not None and summary["verdict"] == "stable"
    hold = f", hold ratio {with_error(ratio, error)}" if is_held else ""
    # a figure goes further than the summary: what it does not show has to stand in it
    whole = "" if summary["recording"]["complete"] else "\nthe recording is not whole: what is missing is grey"
    return f"{session.scenario}, {title(session.conditions)}: {verdict}{hold}{whole}"
