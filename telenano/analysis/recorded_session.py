"""The last session in a recording: its series, and the context of its holds."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial, reduce
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from telenano.analysis.conditions import conditions, described, laws_in_turn
from telenano.analysis.felt_stiffness import (
    SCALE_CHANGED,
    Course,
    FeltSession,
    SampleFacts,
    Span,
    changes_scale,
    felt_in,
    scale_of,
)
from telenano.analysis.fig12 import SessionSeries, TipStates
from telenano.analysis.holds import (
    LATE_S,
    NO_CONTEXT,
    SHORTEST_HOLD_S,
    TIP,
    Guard,
    Incident,
    Lack,
    Late,
    Limits,
    SessionContext,
    lacks_of,
)
from telenano.analysis.interruptions import Interruption, ModeReport, interruptions_of
from telenano.analysis.line_states import line_states
from telenano.analysis.measured_noise import Noise
from telenano.analysis.stated_noise import stated_noise
from telenano.analysis.summary import tip_columns
from telenano.extend.advice import ADVICE
from telenano.recording.arrays import in_step
from telenano.recording.messages import LeftOut, readable
from telenano.recording.multi_file import RecordingSource
from telenano.recording.silence import HAND, LONGEST_STEP_S, Break, breaks_of, ends_of, joined, running_of, sent_of
from telenano.recording.site_clock import Timeline
from telenano.sections.afm_parts import SafetyConfig
from telenano.sections.afm_section import RecordedAfmConfig
from telenano.sections.controller_section import KNOWN_LAWS, ControllerConfig
from telenano.sections.hand_section import LimitsConfig, recorded_hand
from telenano.sections.operator_section import ForceProfileConfig, InteractiveConfig
from telenano.settings.config import validate
from telenano.settings.scenario import LoadedScenario, Scenario
from telenano.timing import loop_age
from telenano.wire.errors import ConfigError, RecordingError
from telenano.wire.nodes import HAND as HAND_NODE
from telenano.wire.nodes import LAUNCHER, LINK, RECORDER, START_ORDER, name_of

Series = npt.NDArray[Any]

# difference of two clocks that is too small to matter in a figure: a period of the loop [s]
_LOOP_PERIOD_S = 1e-3
_WITHDRAWN = ("retracting", "retracted", "estop")
# states in which a program of the instrument runs
_RUNS = ("running", "paused")
# time from the first step of a program to its report [s]
_FIRST_STEP_S = 0.01
# least number of samples for the share of a stage
_LEAST_FOLLOWED = 50
_ALARMS = ("warning", "error")
# longest time from the end of a process to the report of a busy launcher [s]
_EXIT_WITHIN_S = 2.0
_NOT_RESTARTED = "its force profile was not started again, which `telenano session start` does"
# words for the source of a topic in a sentence
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

    `missing` has a sentence for each end of the session that the recording lacks; `context` has the facts on its holds
    besides the series; `breaks` are the spans in which a series has no sample; `timeline` converts stamps to the
    master's clock, on which the series are; `otherwise` is the same session with the measured offset of the slave's
    clock subtracted, if the measurement neither shows nor excludes an offset.
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
        """Read the last session in a recording; RecordingError if the operator's force profile never ran.

        The slave's stamps are converted to the master's clock if the clocks are shown to differ
        (`telenano.recording.site_clock`). If they only may differ, by more than a period of the loop, the session has
        both readings.
        """
        timeline = Timeline(recording)
        session = _read_session(recording, timeline)
        clock = timeline.clock
        if clock is None or clock.applied or clock.greatest_s < _LOOP_PERIOD_S:
            return session
        other = _read_session(recording, timeline.with_clock(clock._replace(applied=True)))
        return replace(session, otherwise=other)

    @property
    def origin(self) -> str:
        """The conditions of the session in words, for the metadata of a file."""
        return described(self.scenario, self.conditions)

    def lacks(self, span_s: tuple[float, float]) -> list[Lack]:
        """Return the spans without samples because of which a hold, from a start to an end [s], cannot be judged."""
        series = self.series()
        return lacks_of(series.hand_time_s, series.tip_time_s, span_s, self.context)

    def clock_error_s(self, stage: str) -> float:
        """Return the bound of the clocks' error in a part of `split_age` [s]; 0 for a part within a site."""
        clock = self.timeline.clock
        return 0.0 if clock is None or stage not in loop_age.ACROSS_CLOCKS else clock.uncertainty_s

    def split_age(self, recording: RecordingSource) -> dict[str, Series]:
        """Return the parts of the age of each answered sample of the hand [s], by name; empty with too few samples.

        A sample is followed by its own stamp, which every message that descends from it carries. A sample that is
        conflated before it arrives has no answer, and does not count. Stamps of the slave are converted to the master's
        clock; an error of that makes one direction longer and the other shorter, but does not change the sum.

        Args:
            recording: The master's recording of the session.
        """
        # Follow a topic at its publisher if that is recorded, otherwise behind the link.
        channel_of = {
            each.topic: each for each in sorted(recording.channels, key=lambda each: each.channel_topic, reverse=True)
        }
        topics = [topic for topic in loop_age.STAGES if topic in channel_of]
        if not topics or "link/delay" not in channel_of:
            return {}
        hand = recording.columns("haptic/state", ("t_ns", "answered_t_ns", "answered_at_ns", "sample_age_s"))
        ways = []
        for topic in topics:
            sent = recording.columns(channel_of[topic].channel_topic, ("hand_t_ns", "publish_ns", "log_ns"))
            stamps = sent["publish_ns"].astype(np.int64)
            at_ns = self.timeline.times_ns(channel_of[topic].src, stamps, sent["log_ns"])
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
            # The newest delay that is declared for a sample holds from that sample on.
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

    def loop_ages_ms(self) -> Series:
        """Return the age of the first answer to each sample of the hand, on the hand's clock, in their order [ms]."""
        # Samples are matched by their stamps, because a restarted device uses its numbers again.
        sampled_ns, answered_ns = _first(self.hand["answered_t_ns"], self.hand["answered_at_ns"])
        return np.asarray((answered_ns - sampled_ns)[sampled_ns >= self.start_ns] * 1e-6)

    def felt(self, recording: RecordingSource) -> FeltSession:
        """Return the felt and the true stiffness while the hand's motor was on and the tip followed.

        Args:
            recording: The recording of the session.
        """
        series = self.series()
        document = LoadedScenario.attached(recording.path, recording.attachments).scenario
        origin = f"{recording.path}: scenario.yaml"
        controller = validate(ControllerConfig, document.controller_in_force, origin, "controller")
        turns = [(0.0, law) for law in self.conditions["law"]]
        if len(turns) > 1:
            # The times of changes are read only if there were several laws.
            turns = laws_in_turn(recording, self.start_ns, self.end_ns)
        ends_s = [from_s for from_s, _ in turns[1:]] + [self.duration_s]
        is_changed = changes_scale(self.conditions["changed"])
        spans = [
            Span(from_s, to_s, *((None, SCALE_CHANGED.reason) if is_changed else scale_of(controller, law)))
            for (from_s, law), to_s in zip(turns, ends_s, strict=True)
        ]
        coupled = self.touches() & np.isin(self.tip["mode"], ("follow",))
        if series.hand_time_s.size:
            is_on = np.searchsorted(series.hand_time_s, series.tip_time_s).clip(0, series.hand_time_s.size - 1)
            coupled &= ~np.isin(self.hand["mode"], ("off",))[is_on]
        hand = np.stack([series.hand_time_s, series.hand_position_m, series.hand_force_n])
        tip = np.stack([series.tip_time_s, -self.tip["base_position_m.2"], series.tip_force_n])
        return felt_in(Course(hand, tip, coupled), spans, _sample_facts(document, origin))

    def touches(self) -> npt.NDArray[np.bool_]:
        """Return for each sample of the tip whether it touches; contact before the tip was placed does not count."""
        return np.asarray(self.tip["in_contact"].astype(bool) & _was_placed(self.tip["placed"]), dtype=np.bool_)

    def _time_s(self, series: Mapping[str, Series]) -> npt.NDArray[np.float64]:
        return np.asarray((series["t_ns"] - self.start_ns) * 1e-9, dtype=np.float64)


def _read_session(recording: RecordingSource, timeline: Timeline) -> Session:
    hand = _series(recording, HAND, (*_HAND_FIELDS, *_ANSWER_FIELDS), timeline)
    running = running_of(recording, hand)
    if running.size < 2:
        raise RecordingError(f"{recording.path}: the operator's force profile never ran in it, so there is no session")
    start_ns = int(hand["t_ns"][running[0]] - round(hand["session_s"][running[0]] * 1e9))
    end_ns = int(hand["t_ns"][running[-1]])
    document = LoadedScenario.attached(recording.path, recording.attachments).scenario
    facts = conditions(recording, document, start_ns, end_ns, timeline)
    if lines := _lines_of(recording, timeline, start_ns, end_ns):
        facts["lines"] = lines
    if states := line_states(recording, timeline, start_ns, end_ns):
        facts["line_states"] = states
    ends = ends_of(recording, hand, running)
    seconds = (end_ns - start_ns) * 1e-9
    # A silent hand is due until its force profile or the recording ends.
    due_s = max(seconds, min(document.duration_s, seconds + (ends.silent_s or 0.0)))
    command = _series(recording, _COMMAND, _COMMAND_FIELDS, timeline)
    tip = _series(recording, TIP, tuple(dict.fromkeys((*_TIP_FIELDS, *tip_columns()))), timeline)
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
            # Holds planned after the end of a cut recording were not ended by the operator.
            planned_holds(document, max(seconds, document.duration_s) if ends.is_cut else due_s),
            (hand["t_ns"][new] - start_ns) * 1e-9,
            reported.guards,
            reported.incidents,
            _limits(document, facts["changed"]),
            _programs(recording, timeline, start_ns, end_ns),
            _is_by_hand(document),
            _interruptions(hand, tip, reported, silences, start_ns, end_ns),
            sorted([*_late(hand, start_ns), *_late(tip, start_ns)]),
            _deadline_s(document),
            _transit_s(hand),
            _rest_force(document, facts, f"{recording.path}: scenario.yaml"),
            [(one.topic, one.start_s, one.end_s) for one in silences],
            _let_go(hand, start_ns),
            _stated_noise(document, facts),
        ),
        knows_contact=_knows_contact(document, tip["separation_m"]),
    )


def _late(series: Mapping[str, Series], start_ns: int) -> list[Late]:
    """Return when in the session a process was late with a sample, and by how much [s]; lost ones do not count."""
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
    """Return the transit of a command there and back [s], its 99th percentile; LONGEST_STEP_S without answers."""
    ages_ns = (hand["answered_at_ns"] - hand["answered_t_ns"])[hand["answered_t_ns"] > 0]
    return 1e-9 * float(np.percentile(ages_ns, 99.0)) if ages_ns.size else LONGEST_STEP_S


def _rest_force(document: Scenario, facts: Mapping[str, Any], origin: str) -> Callable[[float], float] | None:
    """Return the rest force of the law as a function of the hand's; None if it states none or was changed."""
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


def _sample_facts(document: Scenario, origin: str) -> SampleFacts:
    """Return the facts on the sample in a scenario, few if its section cannot be read, as without a package."""
    try:
        return SampleFacts.of(validate(RecordedAfmConfig, document.afm_node, origin, "afm_node"))
    except ConfigError:
        feel = document.afm_node.get("feel")
        return SampleFacts(no_force="what is felt is no force on the tip" if feel else "")


def _programs(recording: RecordingSource, timeline: Timeline, start_ns: int, end_ns: int) -> list[tuple[float, float]]:
    """Return start and end of each program of the instrument, in session time [s]."""
    programs, begun_s = [], None
    reports = recording.select(lambda channel: channel.topic == "afm/program" and channel.via == "direct")
    for report, fields in readable(reports, recording.left_out):
        at_ns = timeline.time_ns(report)
        at_s, runs = (at_ns - start_ns) * 1e-9, fields["state"] in _RUNS
        if runs and begun_s is None:
            # A program starts before its first report.
            begun_s = at_s - _FIRST_STEP_S
        elif not runs and begun_s is not None:
            programs.append((begun_s, at_s))
            begun_s = None
    return programs if begun_s is None else [*programs, (begun_s, (end_ns - start_ns) * 1e-9)]


def _limits(document: Scenario, changed: Sequence[str]) -> Limits | None:
    """Return the limits of the instrument's guard; None if they were changed during the session."""
    if any("afm_node.safety." in change for change in changed):
        return None
    # Only this part is validated, because the rest of the section may belong to a package.
    safety = validate(SafetyConfig, document.afm_node.get("safety", {}), "scenario.yaml", "afm_node.safety")
    return Limits(safety.force_limit_n, safety.command_deadline_s + safety.hold_time_s)


def _stated_noise(document: Scenario, facts: Mapping[str, Any]) -> Noise | None:
    """Return the noise that a simulated instrument states [N]; None of a package's own, or if it was changed."""
    if any("afm_node." in change for change in facts["changed"]):
        return None
    try:
        return stated_noise(RecordedAfmConfig.model_validate(document.afm_node), facts["parameters"]["force_scale"])
    except ValueError:
        return None


def planned_holds(scenario: Scenario, end_s: float) -> list[tuple[float, float, float]]:
    """Return start [s], end [s] and force [N] of each stretch of constant force up to an end [s].

    Only a hand with a force profile has planned holds: the force of an arm or a person is known only from the
    recording.

    Raises:
        ConfigError: A key of the scenario cannot be read; the message names it.
    """
    operator, _ = recorded_hand(scenario.haptic_node, "scenario.yaml")
    if not isinstance(operator, ForceProfileConfig):
        return []
    corners = [(point.time_s, point.force_n) for point in operator.points]
    # The force is zero before the first corner, and constant after the last one.
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


def _is_by_hand(scenario: Scenario) -> bool:
    """Return whether a person presses, at a page or a device: such a hand yields to the motion of the loop.

    Raises:
        ConfigError: A key of the scenario cannot be read; the message names it.
    """
    operator, simulated = recorded_hand(scenario.haptic_node, "scenario.yaml")
    return isinstance(operator, InteractiveConfig) or not simulated


class _Reported(NamedTuple):
    """Reports of devices on their modes, and of launchers and link on nodes and sites, in session time [s]."""

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
        at_ns = timeline.time_ns(event)
        at_s = (at_ns - start_ns) * 1e-9
        report = ModeReport(at_s, str(data.get("mode", "")), str(data.get("reason", text)))
        if name == "afm_node" and kind == "mode" and report.mode in _WITHDRAWN:
            reports.guards.append(Guard(at_s, str(data.get("reason", ""))))
        elif kind == "mode" and report.mode in ("hold", "off"):
            (reports.held if name == "afm_node" else reports.let_go).append(report)
        elif "outside" in data or data.get(ADVICE) is True:
            # Advice is no cause of an event at a device.
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
    """Return the breaks of a session's series, in session time [s]; due_s: end of the time in which samples are due."""
    sent, breaks = sent_of(recording), []
    for topic, values in series.items():
        src = next((channel.src for channel in recording.channels if channel.channel_topic == topic), "")
        times_s = (values["t_ns"] - start_ns) * 1e-9
        span_s = (0.0, due_s.get(topic, length_s))
        numbers = values["seq"].astype(np.int64)
        breaks += breaks_of(topic, times_s, numbers, span_s, sent.get((topic, src)), is_closed=recording.closed)
    return breaks


def _let_go(hand: Mapping[str, Series], start_ns: int) -> list[tuple[float, float]]:
    """Return start and end [s] of each span of a session with the motor of the hand off."""
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
    """Return the interruptions of the loop during the session, in session time [s] and in the order of time."""
    hand_s, tip_s = ((series["t_ns"] - start_ns) * 1e-9 for series in (hand, tip))
    length_s = (end_ns - start_ns) * 1e-9
    # If the hand is gone at the end, its process may have ended after its last sample.
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
        # The end of the hand's process is listed above.
        if not (one.topic == HAND and one.anew)
    ]
    interruptions += [
        Interruption("process_ended", incident.time_s, incident.time_s, incident.text)
        for node, incident in exits
        if node in (*START_ORDER, RECORDER)
    ]
    return sorted(interruptions, key=lambda one: one.start_s)


def _was_placed(placed: Series) -> npt.NDArray[np.bool_]:
    """Return for each sample whether the tip had been placed: an earlier contact is not one of the hand.

    Args:
        placed: `placed` of afm/state, shape (n,), NaN if not stated, as in older recordings; all NaN counts as placed.
    """
    is_placed = np.asarray(placed, dtype=np.float64)
    if np.isnan(is_placed).all():
        return np.ones(is_placed.shape, dtype=np.bool_)
    return np.asarray(np.maximum.accumulate(np.nan_to_num(is_placed) > 0.0), dtype=np.bool_)


def _lines_of(recording: RecordingSource, timeline: Timeline, start_ns: int, end_ns: int) -> list[dict[str, Any]]:
    """Return the figures of each direction during the session; none without reports of a queue or of a block."""
    reports: dict[str, dict[tuple[str, int], Mapping[str, Any]]] = {}
    channels = recording.select(lambda channel: channel.topic == "link/network")
    for message, fields in readable(channels, recording.left_out):
        first_ns, last_ns = (timeline.stamp_ns(message.src, end) for end in (start_ns, end_ns))
        # A report of the slave is in the master's recording twice, received directly and through the link.
        is_known = fields.get("queue_s") is not None or fields.get("blocked_since_ns") is not None
        if first_ns <= message.publish_ns <= last_ns and is_known:
            reports.setdefault(fields["direction"], {})[message.src, message.seq] = fields
    reports_of_way = {way: list(channels.values()) for way, channels in reports.items()}
    # The sender of a direction reports that its line is full; it receives the other direction.
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
    """Return start and end [s] of each span in which datagrams of a direction were sent, but none arrived."""
    spans: dict[int, int] = {}
    for report in reports:
        if (since_ns := report.get("blocked_since_ns")) is not None:
            spans[since_ns] = report["t_ns"]
    return [[round((at_ns - begin_ns) * 1e-9, 3) for at_ns in span] for span in spans.items()]


def _line_figures(way: str, reports: list[Mapping[str, Any]], of_sender: list[Mapping[str, Any]]) -> dict[str, Any]:
    first, last = reports[0], reports[-1]
    longest = max(reports, key=lambda report: report.get("queue_s") or 0.0)
    settled, lost = (last.get("settled") or 0) - (first.get("settled") or 0), max(0, last["lost"] - first["lost"])
    return {
        "direction": way,
        "queue_max_ms": round(1e3 * (longest.get("queue_s") or 0.0), 2),
        "queue_max_low_ms": _in_unit(longest.get("queue_low_s"), 1e3, 2),
        "queue_max_high_ms": _in_unit(longest.get("queue_high_s"), 1e3, 2),
        "full_share": round(sum(report.get("line") == "full" for report in of_sender) / max(1, len(of_sender)), 3),
        "capacity_mbit": _in_unit(last.get("capacity_bit_per_s"), 1e-6, 3),
        "capacity_low_mbit": _in_unit(last.get("capacity_low_bit_per_s"), 1e-6, 3),
        "capacity_high_mbit": _in_unit(last.get("capacity_high_bit_per_s"), 1e-6, 3),
        "datagrams_per_s": round((last["sent"] - first["sent"]) / max(1e-9, (last["t_ns"] - first["t_ns"]) * 1e-9), 1),
        "lost_share": round(min(1.0, lost / settled), 4) if settled > 0 else None,
    }


def _in_unit(value: float | None, unit: float, digits: int) -> float | None:
    return None if value is None else round(value * unit, digits)


def _datagrams(recording: RecordingSource, timeline: Timeline) -> dict[str, tuple[Series, Series]]:
    """Return by direction the sending times [ns] of arrived datagrams, rising, and their transit times [ns]."""
    by_name: dict[str, list[Series]] = {}
    for message, _ in readable(recording.messages(("link/network",)), LeftOut()):
        report: Any = message.decode()
        arrived = report.lost_flag.to_numpy() == 0
        if report.clock.valid and arrived.any():
            took_ns, at_ns = (each.to_numpy()[arrived] for each in (report.delay_ns, report.arrived_ns))
            heard_ns = np.full(at_ns.shape, message.log_ns, dtype=np.int64)
            left_ns = timeline.times_ns(message.src, at_ns, heard_ns) - took_ns
            by_name.setdefault(report.direction, []).append(np.column_stack([left_ns, took_ns]))
    rows = {way: np.concatenate(parts) for way, parts in by_name.items()}
    return {way: tuple(each[np.argsort(each[:, 0])].T) for way, each in rows.items()}


def _first(keys: Series, values: Series) -> tuple[Series, Series]:
    """Return the keys once each, sorted, with the first value of each."""
    found, place = np.unique(keys, return_index=True)
    return found, values[place]


def _series(
    recording: RecordingSource, channel_topic: str, fields: Sequence[str], timeline: Timeline
) -> dict[str, Series]:
    """Return fields and `t_ns` on the master's clock; empty arrays if the recording has no tip, or no commands."""
    src = next((channel.src for channel in recording.channels if channel.channel_topic == channel_topic), None)
    if src is None and channel_topic != "haptic/state":
        return {name: np.empty(0, np.int64 if name == "t_ns" else np.float64) for name in ("t_ns", *fields)}
    series = recording.columns(channel_topic, tuple(dict.fromkeys(("t_ns", "log_ns", *fields))))
    series["t_ns"] = timeline.times_ns(src or "", series["t_ns"].astype(np.int64), series["log_ns"])
    kept = in_step(series["t_ns"])
    return series if kept.all() else {name: values[kept] for name, values in series.items()}


def _within(series: dict[str, Series], start_ns: int, end_ns: int) -> dict[str, Series]:
    inside = (series["t_ns"] >= start_ns) & (series["t_ns"] <= end_ns)
    return {name: values[inside] for name, values in series.items()}
