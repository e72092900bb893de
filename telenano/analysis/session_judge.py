"""Summary of a session: its holds and verdict, missing samples, and figures."""

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from telenano.analysis.felt_stiffness import Felt, FeltSession
from telenano.analysis.fig12 import SessionSeries
from telenano.analysis.findings import Kind
from telenano.analysis.holds import (
    ANSWERS,
    TIP,
    Hold,
    Instrument,
    gaps_in,
    guard_of,
    hold_forces,
    judge_holds,
    lacks_of,
    verdict_of,
)
from telenano.analysis.interruptions import in_words
from telenano.analysis.intervals import half_width
from telenano.analysis.mean_interval import mean_half_width
from telenano.analysis.missing import recording_facts
from telenano.analysis.recorded_session import Session
from telenano.analysis.summary import Summary, tip_figures
from telenano.files.strict_json import finite
from telenano.recording.info import RecordingInfo
from telenano.recording.messages import LeftOut, RecordedMessage, readable
from telenano.recording.multi_file import RecordingSource
from telenano.recording.silence import HAND
from telenano.settings.package_topics import row_of
from telenano.settings.scenario import LoadedScenario
from telenano.timing import loop_age

Series = npt.NDArray[Any]

RELEASE_WINDOW_S = 1.0
_DECLARED_LOOP_HZ = 1000.0
# number of parts of a session from which the interval of a percentile of the loop's age is estimated
_AGE_PARTS = 10
# least number of answers in each part
_LEAST_AGES = 100
# least rise and fall of a press, as a share of the greatest force [1]: less is a tremor or noise
_LEAST_SHARE = 0.1
# least rise and fall of a press [N]
_LEAST_N = 0.1


def summary_of(session: Session, recording: RecordingSource, missing: Sequence[str] = ()) -> dict[str, Any]:
    """Return the summary of a session, with the keys of `Summary`; a figure that the session does not show is null.

    All messages of the recording are read once. `missing` has further sentences on missing data.
    """
    unread = LeftOut()
    info, sent, overruns = _counted(session, recording, unread)
    series, holds, judged = _judged(session)
    interruptions = session.context.interruptions
    age_parts = _loop_age_parts(session.split_age(recording))
    unread.add(recording.left_out)
    missing = [*session.missing, *_lacking(session, series, holds, info), *missing, *unread.sentences()]
    last_s = session.duration_s - RELEASE_WINDOW_S
    samples = {
        "hold_ratio": _hold_ratios(session, holds),
        "contact_x_cm": 100.0 * series.reference_m[series.reference_time_s >= last_s],
        "release_force_nn": 1e9 * series.tip_force_n[series.tip_time_s >= last_s],
    }
    ages_ms = session.loop_ages_ms()
    summary = {
        "scenario": session.scenario,
        **session.conditions,
        "duration_s": round(session.duration_s, 3),
        **judged,
        "felt_stiffness": felt_figures(session.felt(recording)),
        "contact_x_cm": mean_of(samples["contact_x_cm"]),
        "release_force_nn": rounded_nn(mean_of(samples["release_force_nn"])),
        **tip_figures(session.tip),
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
        "rate_hz": {name: round(count / session.duration_s, 3) for name, count in sent.items()},
        "completeness": _completeness(
            sent,
            session.duration_s,
            1.0 / LoadedScenario.attached(recording.path, recording.attachments).scenario.period_s,
        ),
        "seq_gaps": _gaps(info),
        "contact_known": session.knows_contact,
        "holds": hold_figures(holds),
        "clocks": _clocks(session),
        "recording": recording_facts(info, session.start_ns, missing, unread.beyond_range()),
    }
    return Summary.model_validate(finite(summary)).model_dump(exclude_unset=True)


def _judged(session: Session) -> tuple[SessionSeries, list[Hold], dict[str, Any]]:
    """Return the series of a session, its holds, and the figures that depend on the reading of the clocks."""
    series = session.series()
    scaled = session.force_scale * series.tip_force_n
    mode = session.tip["mode"]
    hand_m = np.interp(series.tip_time_s, series.hand_time_s, series.hand_position_m)
    tip = Instrument(
        np.isin(mode, ("follow", "hold")),
        session.touches(),
        np.isin(mode, ("hold",)),
        hand_m + session.tip["base_position_m.2"] / session.conditions["parameters"]["position_scale"],
        session.knows_contact,
    )
    holds = judge_holds(series.hand_time_s, series.hand_force_n, series.tip_time_s, scaled, tip, session.context)
    guard = guard_of(series.tip_time_s, tip, session.context)
    greatest_n = float(np.abs(series.hand_force_n).max(initial=0.0))
    verdict, reason = verdict_of(holds, guard, greatest_n, in_words(session.context.interruptions))
    return series, holds, {**verdict_figures(verdict, reason), "hold_ratio": mean_of(_hold_ratios(session, holds))}


def verdict_figures(verdict: Kind, reason: str) -> dict[str, Any]:
    """Return the keys of a summary with a verdict on a session; an undecided one is not called unstable."""
    stable = None if verdict in ("cannot_say", "no_data") else verdict == "stable"
    return {"stable": stable, "verdict": verdict, "reason": reason}


def hold_figures(holds: Sequence[Hold]) -> list[dict[str, Any]]:
    """Return the key `holds` of a summary."""
    return [{**hold._asdict(), "facts": [fact._asdict() for fact in hold.facts]} for hold in holds]


def _lacking(session: Session, series: SessionSeries, holds: Sequence[Hold], info: RecordingInfo) -> list[str]:
    """Return a sentence for each loss because of which a hold has no data, with its full length in the session.

    Messages that the reader left out are in the recording, so they are not missing.
    """
    context = session.context
    whole_topics = {one.channel_topic for one in info.channels if not one.lost} if info.closed else set()
    times = {HAND: series.hand_time_s, TIP: series.tip_time_s, ANSWERS: context.answered_s}
    # Planned holds after the end of a recording that ends early are missing as well.
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


def felt_figures(found: FeltSession) -> dict[str, Any]:
    """Return the key `felt_stiffness` of a summary: felt and true stiffness, and spans in which they differed much."""
    felt, names = found.felt, ("ratio", "low", "high", "felt_n_per_m", "there_n_per_m")
    outside = [
        {"from_s": round(one.from_s, 1), "to_s": round(one.to_s, 1), **_figures(one.felt, names[:3]), "text": str(one)}
        for one in found.outside
    ]
    figures = dict.fromkeys(names) if felt is None else _figures(felt, names)
    return {**figures, "reason": found.reason, **({"outside": outside} if outside else {})}


def _figures(felt: Felt, names: Sequence[str]) -> dict[str, float]:
    # Further digits depend on the processor.
    return {name: float(f"{getattr(felt, name):.6g}") for name in names}


def _clocks(session: Session) -> dict[str, Any] | None:
    """Return the offset of the slave's clock, and the figures of the other reading if it cannot be excluded."""
    clock = session.timeline.clock
    if clock is None:
        return None
    return {
        "offset_s": None if clock.offset_s is None else round(clock.offset_s, 6),
        "uncertainty_s": round(clock.uncertainty_s, 6),
        "drift_ppm": round(1e6 * clock.drift, 1),
        "applied": clock.applied,
        "reason": clock.reason,
        "otherwise": None if session.otherwise is None else _judged(session.otherwise)[2],
    }


def cycles_of(force_n: npt.NDArray[np.float64]) -> int:
    """Return how often a force [N], of shape (n,), rose and then fell, by a tenth of its greatest and 0.1 N or more."""
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
    """Return the facts on a recording, and for its session the messages by channel and the missed deadlines."""
    # start and end of the session by the clock of each source [ns]
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
    """Return the recorded share of the declared number of messages, for channels with one source and a declared rate.

    The topics of the loop are declared at 1 kHz, but have the rate of the scenario.
    """
    shares = {}
    for name, count in sent.items():
        topic = row_of(name.partition("@")[0])
        if topic is not None and topic.rate_hz is not None and "*" not in topic.publishers:
            # Both ends of the session may fall between two messages.
            rate_hz = loop_rate_hz if topic.rate_hz == _DECLARED_LOOP_HZ else topic.rate_hz
            shares[name] = min(1.0, round(count / (rate_hz * duration_s), 5))
    return shares


def last_with_ratio(holds: Sequence[Hold]) -> Hold | None:
    """Return the last hold that has a ratio of the forces; None without one."""
    return next((hold for hold in reversed(holds) if hold.hold_ratio is not None), None)


def _hold_ratios(session: Session, holds: Sequence[Hold]) -> Series:
    """Return F_m/(alpha_f F_s) of each sample at rest in the last hold with such a ratio; empty without one."""
    own = last_with_ratio(holds)
    if own is None:
        return np.empty(0)
    series = session.series()
    hand_n, tip_n = hold_forces(
        own, series.hand_time_s, series.hand_force_n, series.tip_time_s, session.force_scale * series.tip_force_n
    )
    return hand_n / tip_n


def _loop_age_ms(ages_ms: Series) -> dict[str, float] | None:
    if ages_ms.size == 0:
        return None
    p50, p99 = np.percentile(ages_ms, [50.0, 99.0])
    return {"p50": round(float(p50), 4), "p99": round(float(p99), 4), "max": round(float(ages_ms.max()), 4)}


def _loop_age_parts(split_s: Mapping[str, Series]) -> dict[str, Any]:
    if not split_s:
        return {}
    parts = loop_age.parts_of(split_s)
    # Parts that take no time are left out: a simulated device has no age, and one machine has no line.
    parts_ms = {part.name: [round(1e3 * each, 4) for each in (part.p50_s, part.p99_s)] for part in parts if part.p99_s}
    return {"loop_age_parts_ms": parts_ms, "loop_age_largest": loop_age.in_words(parts)}


def _intervals(samples: Mapping[str, Series], ages_ms: Series) -> dict[str, list[float]]:
    """Return the interval of each mean, and of the percentiles of the loop's age from those of parts of the session.

    A mean without a known error has no interval.
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


def mean_of(values: Series) -> float | None:
    """Return the mean of an array of shape (n,); None without a value."""
    return float(values.mean()) if values.size else None


def rounded_nn(force_nn: float | None) -> float | None:
    """Return a force rounded to 1e-6 nN, the tolerance of the equilibrium of the simulated cantilever."""
    # Adding 0.0 turns -0.0 into 0.0.
    return None if force_nn is None else round(force_nn, 6) + 0.0
