"""Figure and summary of a session, from its recording alone."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from analysis.conditions import conditions, described, title
from analysis.holds import Instrument, judge_holds, verdict_of
from analysis.missing import Spans, account, cut_off, gaps
from proto import TOPICS
from proto.errors import RecordingError, ReportError
from proto.nodes import name_of
from recording.arrays import columns, last_session, replay_shifts
from recording.info import RecordingInfo
from recording.multi_file import RecordingSource, open_recordings
from recording.whole_files import whole_results
from services.runtime.config import parse_yaml, validate
from services.runtime.scenario import Scenario
from services.viz_node.fig12 import SessionSeries, fig12_files
from services.viz_node.figure_style import ON_SCREEN, FigureOptions

Series = npt.NDArray[Any]

HOLD_WINDOW_S = (2.2, 2.5)
RELEASE_WINDOW_S = 1.0
_TIP_FIELDS = ("tip_force_n.2", "separation_m", "in_contact", "mode")


@dataclass(frozen=True)
class Session:
    """The part of a recording in which the operator's programme ran, and the series that the report needs.

    `missing` has a sentence for each end of it that the recording lacks.
    """

    start_ns: int
    end_ns: int
    hand: dict[str, Series]
    command: dict[str, Series]
    tip: dict[str, Series]
    force_scale: float
    scenario: str
    conditions: dict[str, Any]
    missing: tuple[str, ...] = ()

    @property
    def duration_s(self) -> float:
        return (self.end_ns - self.start_ns) * 1e-9

    def gaps_s(self) -> Spans:
        """Return the spans of the session [s] in which a series has no sample."""
        return gaps([self._time_s(series) for series in (self.hand, self.command, self.tip)], self.duration_s)

    def series(self, gaps_s: Spans = ()) -> SessionSeries:
        return SessionSeries(
            gaps_s=gaps_s,
            hand_time_s=self._time_s(self.hand),
            hand_force_n=-self.hand["operator_force_n.2"],
            hand_position_m=-self.hand["position_m.2"],
            reference_time_s=self._time_s(self.command),
            reference_m=-self.command["position_m.2"],
            tip_time_s=self._time_s(self.tip),
            tip_force_n=self.tip["tip_force_n.2"],
            separation_m=self.tip["separation_m"],
            force_scale=self.force_scale,
        )

    def _time_s(self, series: Mapping[str, Series]) -> npt.NDArray[np.float64]:
        return np.asarray((series["t_ns"] - self.start_ns) * 1e-9, dtype=np.float64)


@dataclass(frozen=True)
class Traffic:
    """Traffic on the bus while the session ran: messages by channel, and deadlines missed."""

    messages: dict[str, int]
    overruns: int

    def rates_hz(self, duration_s: float) -> dict[str, float]:
        return {name: round(count / duration_s, 3) for name, count in sorted(self.messages.items())}

    def completeness(self, duration_s: float) -> dict[str, float]:
        """Return the recorded share of the declared number of messages, for channels of one source and a rate."""
        shares = {}
        for name, count in sorted(self.messages.items()):
            topic = TOPICS.get(name.partition("@")[0])
            if topic is not None and topic.rate_hz is not None and "*" not in topic.publishers:
                # both ends of the session may fall between two messages
                shares[name] = min(1.0, round(count / (topic.rate_hz * duration_s), 5))
        return shares


def write_report(
    path: Path | Sequence[Path], out: Path, missing: Sequence[str] = (), options: FigureOptions = ON_SCREEN
) -> dict[str, Any]:
    """Write `fig12.png` and `summary.json` of a recording, or of the parts of one, to a folder.

    Parameters: missing, sentences on what is known to be missing besides what the recording itself shows; options,
    formats and style of the figure.
    Returns: the summary. Raises RecordingError naming the file and what it lacks, ReportError with the
    summary when a file cannot be written; none is left half written.
    """
    recording = open_recordings([path] if isinstance(path, Path) else path)
    session = read_session(recording)
    summary = summarise(session, recording.info(), read_traffic(recording, session), missing)
    # a node that stood still leaves a gap as well, which is no fault of the recording
    gaps_s = () if summary["recording"]["complete"] else session.gaps_s()
    origin = described(session.scenario, session.conditions)
    figures = fig12_files(session.series(gaps_s), _title(session, summary), options, origin)
    text = json.dumps(summary, indent=2) + "\n"
    try:
        write_files(out, {**figures, "summary.json": text.encode()})
    except OSError as error:
        raise ReportError(f"{error.filename}: cannot be written: {error.strerror}", summary) from error
    return summary


def write_files(folder: Path, files: Mapping[str, bytes]) -> None:
    """Write all files of a folder or none of them; OSError names the first that cannot be written."""
    with whole_results(folder) as part:
        for name, data in files.items():
            # what runs out of room does not say where
            try:
                (part / name).write_bytes(data)
            except OSError as error:
                raise OSError(error.errno, error.strerror, str(folder / name)) from error


def read_session(recording: RecordingSource) -> Session:
    """Read the last session that a recording holds; RecordingError when the operator's programme never ran."""
    shifts = replay_shifts(recording)
    hand = _series(
        recording,
        "haptic/state",
        ("seq", "session_s", "operator_force_n.2", "position_m.2", "answered_seq", "answered_t_ns", "answered_at_ns"),
        shifts,
    )
    running = last_session(hand["session_s"], hand["seq"], hand["t_ns"], _session_starts_ns(recording))
    if running.size < 2:
        raise RecordingError(f"{recording.path}: the operator's programme never ran in it, so there is no session")
    start_ns = int(hand["t_ns"][running[0]] - round(hand["session_s"][running[0]] * 1e9))
    end_ns = int(hand["t_ns"][running[-1]])
    document = _scenario(recording)
    found = conditions(recording, document, start_ns, end_ns)
    return Session(
        start_ns=start_ns,
        end_ns=end_ns,
        hand={name: values[running] for name, values in hand.items()},
        command=_within(_series(recording, "haptic/command", ("position_m.2", "force_n.2"), shifts), start_ns, end_ns),
        tip=_within(_series(recording, "afm/state", _TIP_FIELDS, shifts), start_ns, end_ns),
        force_scale=found["parameters"]["force_scale"],
        scenario=document.name,
        conditions=found,
        missing=tuple(cut_off(recording, hand["session_s"], running)),
    )


def summarise(session: Session, info: RecordingInfo, traffic: Traffic, missing: Sequence[str] = ()) -> dict[str, Any]:
    """Return the summary of a session; what the session does not show is null."""
    series = session.series()
    scaled = session.force_scale * series.tip_force_n
    tip = Instrument(np.isin(session.tip["mode"], ("follow", "hold")), session.tip["in_contact"].astype(bool))
    holds = judge_holds(series.hand_time_s, series.hand_force_n, series.tip_time_s, scaled, tip)
    verdict, reason = verdict_of(holds)
    last_s = session.duration_s - RELEASE_WINDOW_S
    return {
        "scenario": session.scenario,
        **session.conditions,
        "duration_s": round(session.duration_s, 3),
        "stable": verdict == "stable",
        "verdict": verdict,
        "reason": reason,
        "hold_ratio": _hold_ratio(series),
        "contact_x_cm": _mean(100.0 * series.reference_m[series.reference_time_s >= last_s]),
        "release_force_nn": _rounded(_mean(1e9 * series.tip_force_n[series.tip_time_s >= last_s])),
        "greatest_pull_nn": float(1e9 * series.tip_force_n.min(initial=0.0)),
        "loop_age_ms": _loop_age_ms(session),
        "overruns": traffic.overruns,
        "rate_hz": traffic.rates_hz(session.duration_s),
        "completeness": traffic.completeness(session.duration_s),
        "seq_gaps": _gaps(info),
        "holds": [hold._asdict() for hold in holds],
        "recording": account(info, session.start_ns, (*session.missing, *missing)),
    }


def read_traffic(recording: RecordingSource, session: Session) -> Traffic:
    """Count the messages sent while the session ran, by the time of sending."""
    messages: dict[str, int] = {}
    overruns: dict[str, tuple[int, int]] = {}
    shifts = replay_shifts(recording)
    for message in recording.messages():
        if not session.start_ns <= message.publish_ns + shifts.get(message.src, 0) < session.end_ns:
            continue
        name = message.channel_topic
        messages[name] = messages.get(name, 0) + 1
        if name == "node/health":
            count = int(message.fields()["overruns"])
            first, _ = overruns.get(message.src, (count, count))
            overruns[message.src] = (first, count)
    return Traffic(messages, sum(max(0, last - first) for first, last in overruns.values()))


def _hold_ratio(series: SessionSeries) -> float | None:
    """Average F_m/(alpha_f F_s) over the window, sample by sample; null when the tip is not pressed throughout."""
    first_s, last_s = HOLD_WINDOW_S
    window = (series.hand_time_s >= first_s) & (series.hand_time_s <= last_s)
    if not window.any() or series.hand_time_s[-1] < last_s:
        return None
    force = series.force_scale * np.interp(series.hand_time_s[window], series.tip_time_s, series.tip_force_n)
    if not (force > 0.0).all():
        return None
    return float(np.mean(series.hand_force_n[window] / force))


def _loop_age_ms(session: Session) -> dict[str, float] | None:
    """Return the age of the first answer to each sample of the hand, on the hand's own clock."""
    hand = session.hand
    # not by number, which a device that was started again uses anew
    stamps, first = np.unique(hand["answered_t_ns"], return_index=True)
    ages = (hand["answered_at_ns"] - hand["answered_t_ns"])[first] * 1e-6
    ages = ages[hand["answered_t_ns"][first] >= session.start_ns]
    if stamps.size == 0 or ages.size == 0:
        return None
    p50, p99 = np.percentile(ages, [50.0, 99.0])
    return {"p50": round(float(p50), 4), "p99": round(float(p99), 4), "max": round(float(ages.max()), 4)}


def _gaps(info: RecordingInfo) -> dict[str, int]:
    gaps: dict[str, int] = {}
    for channel in info.channels:
        gaps[channel.channel_topic] = gaps.get(channel.channel_topic, 0) + channel.gaps
    return dict(sorted(gaps.items()))


def _mean(values: Series) -> float | None:
    return float(values.mean()) if values.size else None


def _rounded(force_nn: float | None) -> float | None:
    """Return a force to a millionth of a nN: what is less is what the equilibrium of the cantilever is found to."""
    # the sum makes a -0.0 plain
    return None if force_nn is None else round(force_nn, 6) + 0.0


def _series(
    recording: RecordingSource, channel_topic: str, fields: Sequence[str], shifts: Mapping[str, int]
) -> dict[str, Series]:
    """Return fields and `t_ns`, which for a replayed source is shifted to the time of its replay."""
    series = columns(recording, channel_topic, ("t_ns", *fields))
    src = next(channel.src for channel in recording.channels if channel.channel_topic == channel_topic)
    series["t_ns"] = series["t_ns"] + shifts.get(src, 0)
    return series


def _session_starts_ns(recording: RecordingSource) -> list[int]:
    """Return when launchers reported that a session runs [ns]."""
    events = recording.select(
        lambda channel: (
            channel.topic == "session/event" and channel.via == "direct" and name_of(channel.src) == "launcher"
        )
    )
    return [event.publish_ns for event in events if "duration_s" in event.fields().get("data", {})]


def _within(series: dict[str, Series], start_ns: int, end_ns: int) -> dict[str, Series]:
    inside = (series["t_ns"] >= start_ns) & (series["t_ns"] <= end_ns)
    return {name: values[inside] for name, values in series.items()}


def _scenario(recording: RecordingSource) -> Scenario:
    try:
        content = recording.attachments["scenario.yaml"]
    except KeyError as error:
        raise RecordingError(f"{recording.path}: has no scenario attached, so its scales are unknown") from error
    origin = f"{recording.path}: scenario.yaml"
    return validate(Scenario, parse_yaml(content, origin), origin)


def _title(session: Session, summary: Mapping[str, Any]) -> str:
    # what drifts or presses with another force is not stable either, and does not oscillate
    verdict = summary["verdict"].replace("_", " ")
    ratio = summary["hold_ratio"]
    hold = f", hold ratio {ratio:.3f}" if ratio is not None else ""
    # a figure goes further than the summary: what it does not show has to stand in it
    whole = "" if summary["recording"]["complete"] else "\nthe recording is not whole: what is missing is grey"
    return f"{session.scenario}, {title(session.conditions)}: {verdict}{hold}{whole}"
