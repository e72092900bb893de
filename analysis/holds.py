"""The holds of a recorded session: where the hand's force stands still, and what the tip's force does meanwhile.

Where a person is the hand, its force swings with the loop, and an oscillation leaves no hold. There a swing of the
tip's force (`analysis.swings`) is judged in the place of one.
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from analysis.interruptions import DEADLINE, REPORTED_WITHIN_S, Interruption, in_words
from analysis.swings import Swing, swings_of
from analysis.verdict import GUARD_ACTED, SMALL_SHARE, Circumstances, Kind, Verdict, judge, struck

Series = npt.NDArray[np.float64]

# shorter holds end before a slow oscillation of the loop (about 5 Hz) has shown what becomes of it
SHORTEST_HOLD_S = 0.5
# the first part of a hold shows the answer to the step before it
SETTLING_SHARE = 0.2
_HAND_STEADY_SHARE = 0.01
# The hand has let go below this share of the greatest force.
_PRESSING_SHARE = 0.05
HAND, TIP, ANSWERS = "haptic/state", "afm/state", "haptic/command"
# samples come every millisecond; at this distance [s] the deadline of the loop has passed
LONGEST_STEP_S = 0.05
# A hold of which a greater share is missing between its samples cannot be judged.
_MISSING_SHARE = 0.1
# A swing of which less than this share is left in its last turn dies out.
_LEFT_SHARE = 0.5
# The instrument gives these reasons where it withdraws for want of commands, and these where its guard acts at all.
_STARVED = (DEADLINE, "hold_expired")
# A hold with one of these verdicts blames the law for nothing.
_NO_BLAME = ("stable", "settling", "released", "guarded", "no_data")
_GUARDING = (*_STARVED, "force_limit", "lateral_limit", "force_invalid", "device_lost")
# It gives these where somebody wanted the tip away: a program, an operator, the end of the session.
_ASKED = ("retract_requested", "estop")
# an incident is the cause of what ends so long after it [s], or is reported so long after what it caused
_CAUSED_WITHIN_S, _NOTICED_WITHIN_S = 3.0, 2.0
# a session that swings and drifts swings: what a person meets first, and what does not end by itself
_WORST_FIRST: tuple[Kind, ...] = (
    *("diverged", "guarded", "limit_cycle", "contact_lost", "wrong_force", "no_data", "drifting", "cannot_say"),
    *("struck", "settling", "released", "stable"),
)


class Hold(NamedTuple):
    """A stretch of constant hand force, and what became of alpha_f F_s in it: see `analysis.verdict.Verdict`.

    frequency_hz: None, or that of the swing that is judged in the place of a hold; hand_force_n is then the mean.
    """

    start_s: float
    end_s: float
    hand_force_n: float
    verdict: Kind
    growth_per_s: float | None
    peak_to_peak_n: float
    noise_n: float
    reason: str
    frequency_hz: float | None = None


class Instrument(NamedTuple):
    """What the instrument says at the tip's times: whether it follows commands, and whether the tip touches.

    held: whether the base stands because commands are missing or ask for it, which it also counts as following.
    """

    following: npt.NDArray[np.bool_]
    in_contact: npt.NDArray[np.bool_]
    held: npt.NDArray[np.bool_] | None = None


class Guard(NamedTuple):
    """A report of the instrument that it withdraws: when [s], and why, as `services.afm_node.safety` names it."""

    time_s: float
    reason: str


class Limits(NamedTuple):
    """What the instrument's guard allows: force on the tip [N], time without a command until it withdraws [s]."""

    force_n: float
    silence_s: float

    def words(self, reason: str) -> str:
        """Return the limit that a reason of the guard is about, in words; empty where it has none."""
        if reason == "force_limit":
            return f"more than {1e9 * self.force_n:.4g} nN on the tip"
        return f"none for {1e3 * self.silence_s:.4g} ms" if reason in _STARVED else ""


class Incident(NamedTuple):
    """What a launcher or the link reported that may be the cause of a hold's end: when [s], and the sentence."""

    time_s: float
    text: str


class Lack(NamedTuple):
    """What a session lacks: a topic, and from when to when [s]."""

    topic: str
    start_s: float
    end_s: float

    def __str__(self) -> str:
        what = "no answer reached the hand" if self.topic == ANSWERS else "nothing"
        return f"{self.topic}: {what} from {self.start_s:.3f} s to {self.end_s:.3f} s of the session"


class Programme(NamedTuple):
    """What else is known of a session.

    planned: holds of the operator's programme, start [s], end [s], force [N]; answered_s: when the hand took up answers
    [s], None if that is not known; guards: what the instrument said of its guard; incidents: nodes that ended and
    sites that fell silent; limits, those of the instrument's guard, if they are known; programs: from when to when [s]
    the instrument ran one of its own; by_hand: whether a person is the hand, whose force swings with the loop;
    interruptions: when the loop was open.
    """

    planned: Sequence[tuple[float, float, float]] = ()
    answered_s: Series | None = None
    guards: Sequence[Guard] = ()
    incidents: Sequence[Incident] = ()
    limits: Limits | None = None
    programs: Sequence[tuple[float, float]] = ()
    by_hand: bool = False
    interruptions: Sequence[Interruption] = ()


NO_PROGRAMME = Programme()


def constant_stretches(time_s: Series, force_n: Series, tolerance_n: float) -> list[tuple[float, float]]:
    """Return the stretches [s] of at least SHORTEST_HOLD_S over which a force stays within a tolerance of its start."""
    stretches: list[tuple[float, float]] = []
    first = 0
    for index in range(1, len(time_s) + 1):
        if index < len(time_s) and abs(force_n[index] - force_n[first]) <= tolerance_n:
            continue
        if time_s[index - 1] - time_s[first] >= SHORTEST_HOLD_S:
            stretches.append((float(time_s[first]), float(time_s[index - 1])))
        first = index
    return stretches


def gaps_in(times_s: Series, start_s: float, end_s: float) -> list[tuple[float, float]]:
    """Return the spans [s] between a start and an end that are without a sample for longer than LONGEST_STEP_S."""
    inside = times_s[(times_s >= start_s) & (times_s <= end_s)]
    edges = [start_s, *inside.tolist(), end_s]
    return [(first, last) for first, last in pairwise(edges) if last - first > LONGEST_STEP_S]


def lacks_of(
    hand_time_s: Series, tip_time_s: Series, span_s: tuple[float, float], answered_s: Series | None = None
) -> list[Lack]:
    """Return what a hold lacks so much of that there is no telling what became of it; nothing if it has its samples.

    A tenth of hand or tip has to be missing, in pieces of more than LONGEST_STEP_S; of the answers all have to be,
    because delayed and lost answers are a matter of the loop.

    Args:
        hand_time_s: The times of the hand's samples [s].
        tip_time_s: The times of the tip's samples [s].
        span_s: The start and the end of the hold [s].
        answered_s: The times of the answers at the hand [s]; None does not judge them.
    """
    start_s, end_s = span_s
    lacking = []
    for topic, times in ((HAND, hand_time_s), (TIP, tip_time_s)):
        spans = gaps_in(times, start_s, end_s)
        if sum(last - first for first, last in spans) > _MISSING_SHARE * (end_s - start_s):
            lacking += [Lack(topic, first, last) for first, last in spans]
    knows_hand = not any(lack.topic == HAND for lack in lacking)
    if knows_hand and answered_s is not None and not ((answered_s >= start_s) & (answered_s <= end_s)).any():
        lacking.append(Lack(ANSWERS, start_s, end_s))
    return lacking


def judge_holds(
    hand_time_s: Series,
    hand_force_n: Series,
    tip_time_s: Series,
    scaled_force_n: Series,
    tip: Instrument | None = None,
    programme: Programme = NO_PROGRAMME,
) -> list[Hold]:
    """Judge every hold of a session, each without its first fifth, as the studies judge theirs.

    Small is what is small beside the greatest force of the hand in the session, so that the holds share one measure; a
    trend has to be a factor of two to be believed, because messages on a real bus come when they come. Where the hand
    presses, the tip has to press with the same force, and to touch. A hold without samples of hand or tip, or without
    an answer at the hand, is `no_data`, also one of the programme that the recording does not show at all. A hold ends
    where the instrument begins a program of its own or somebody has it withdraw, which is no act of the guard.

    Args:
        hand_time_s: The times of the hand's samples [s], shape (n,).
        hand_force_n: F_m at those times [N], shape (n,).
        tip_time_s: The times of the tip's samples [s], shape (m,).
        scaled_force_n: alpha_f F_s at those times [N], shape (m,).
        tip: What the instrument says at those times; None if that is not known.
        programme: What else is known of the operator's programme.
    """
    forces = [*np.abs(hand_force_n).tolist(), *(abs(force) for _, _, force in programme.planned)]
    greatest = float(max(forces, default=0.0))
    if greatest == 0.0:
        return []
    holds = []
    away = absences(tip_time_s, tip, programme)
    stretches = constant_stretches(hand_time_s, hand_force_n, _HAND_STEADY_SHARE * greatest)
    for start, end in [part for stretch in stretches for part in outside(stretch, away)]:
        force = float(np.interp(0.5 * (start + end), hand_time_s, hand_force_n))
        holds.append((start, end, force))
    # A hold that was planned and that the recording does not show at the hand has no data.
    for start, end, force in programme.planned:
        shown_s = sum(max(0.0, min(end, last) - max(start, first)) for first, last, _ in holds)
        if shown_s < 0.5 * (end - start) and lacks_of(hand_time_s, hand_time_s, (start, end)):
            holds.append((start, end, force))
    times = _Times(hand_time_s, hand_force_n, tip_time_s, scaled_force_n)
    swings = swings_of(tip_time_s, scaled_force_n) if programme.by_hand else []
    swings = [swing for swing in swings if not _covered(swing, [*holds, *away])]
    # between its stops a hand that swings stands still now and then
    holds = [hold for hold in holds if not _covered(hold, swings)]
    judged = [_judge_hold(times, tip, hold, greatest, programme) for hold in holds]
    judged += [_judge_swing(times, tip, swing, greatest, programme) for swing in swings]
    followed = np.ones(len(tip_time_s), dtype=bool) if tip is None else tip.following.copy()
    for from_s, to_s in away:
        followed &= (tip_time_s < from_s) | (tip_time_s > to_s)
    times = times._replace(tip_s=tip_time_s[followed], scaled_force_n=scaled_force_n[followed])
    ends = [hold.end_s for hold in judged]
    judged = [_struck(times, hold, greatest, [end for end in ends if end <= hold.start_s]) for hold in judged]
    return sorted(judged, key=lambda hold: hold.start_s)


class _Times(NamedTuple):
    hand_s: Series
    hand_force_n: Series
    tip_s: Series
    scaled_force_n: Series


def _struck(series: _Times, hold: Hold, greatest_n: float, before_s: Sequence[float]) -> Hold:
    """Say so where the tip came to rest in a hold after a blow in it, or since the last of those that ended before.

    It is compared with the hand's greatest force in that time, or with what is small in the session if that is more.
    """
    start_s = max(before_s, default=-np.inf)
    tip = (series.tip_s >= start_s) & (series.tip_s <= hold.end_s)
    hand = (series.hand_s >= start_s) & (series.hand_s <= hold.end_s)
    pressed_n = float(series.hand_force_n[hand].max(initial=max(hold.hand_force_n, SMALL_SHARE * greatest_n)))
    found = struck(Verdict(*hold[3:8]), float(series.scaled_force_n[tip].max(initial=0.0)), pressed_n)
    return hold._replace(verdict=found.kind, reason=found.reason)


def absences(tip_time_s: Series, tip: Instrument | None, programme: Programme) -> list[tuple[float, float]]:
    """Return from when to when [s] the tip does not follow the hand because somebody wanted that."""
    spans = list(programme.programs)
    if tip is None or not tip_time_s.size:
        return spans
    follows = np.concatenate([np.ones(1, dtype=bool), tip.following, np.ones(1, dtype=bool)])
    for first, after in np.flatnonzero(np.diff(follows)).reshape(-1, 2).tolist():
        from_s = float(tip_time_s[first])
        near = [guard for guard in programme.guards if abs(guard.time_s - from_s) <= REPORTED_WITHIN_S]
        if near and min(near, key=lambda guard: abs(guard.time_s - from_s)).reason in _ASKED:
            spans.append((from_s, float(tip_time_s[min(after, len(tip_time_s) - 1)])))
    return spans


def outside(stretch: tuple[float, float], spans: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    """Return the parts [s] of a stretch that are in none of the spans and last for at least SHORTEST_HOLD_S."""
    parts = [stretch]
    for from_s, to_s in spans:
        cut = [part for start, end in parts for part in ((start, min(end, from_s)), (max(start, to_s), end))]
        parts = [(start, end) for start, end in cut if end - start >= SHORTEST_HOLD_S]
    return parts


def _covered(stretch: tuple[float, ...], spans: Sequence[tuple[float, ...]]) -> bool:
    """Return whether more than half of a stretch is in spans; each begins with its start and its end [s]."""
    start_s, end_s = stretch[:2]
    return sum(max(0.0, min(end_s, span[1]) - max(start_s, span[0])) for span in spans) > 0.5 * (end_s - start_s)


def _judge_hold(
    series: _Times, tip: Instrument | None, hold: tuple[float, float, float], greatest_n: float, programme: Programme
) -> Hold:
    start, end, force = hold
    presses = abs(force) > _PRESSING_SHARE * greatest_n
    known = Circumstances(noisy=True, expected_n=force if presses else None)
    judged = (series.tip_s >= start + SETTLING_SHARE * (end - start)) & (series.tip_s < end)
    if tip is not None:
        lost = judged & ~tip.following
        later = judged & (series.tip_s >= 0.5 * (start + end))
        last = judged & (series.tip_s >= end - 0.25 * (end - start))
        if lost.any():
            first = int(np.argmax(lost))
            judged = judged & (series.tip_s < series.tip_s[first])
            known = _guarded(known, series.tip_s, tip, first, programme)
        touching = float(tip.in_contact[later].mean()) if presses and later.any() else None
        at_end = float(tip.in_contact[last].mean()) if presses and last.any() else None
        known = known._replace(touching=touching, touching_at_end=at_end)
        known = known._replace(landed_s=_landed(series, tip, hold, judged, greatest_n) if presses else None)
    lacking = lacks_of(series.hand_s, series.tip_s, (start, end), programme.answered_s)
    if lacking and not known.guarded:
        causes = _causes(programme, lacking[0].start_s, lacking[-1].end_s)
        return Hold(start, end, force, "no_data", None, 0.0, 0.0, "; ".join([*map(str, lacking), *causes]))
    verdict = judge(series.tip_s[judged], series.scaled_force_n[judged], greatest_n, known)
    without = [one for one in programme.interruptions if one.starved and one.start_s < end and one.end_s > start]
    if without and not known.guarded and verdict.kind not in _NO_BLAME:
        # What an interrupted loop does after it is no motion of the law, which is judged by what it did before.
        judged &= series.tip_s < without[0].start_s
        before = judge(series.tip_s[judged], series.scaled_force_n[judged], greatest_n, known)
        span_s = float(np.ptp(series.tip_s[judged])) if judged.any() else 0.0
        if span_s < SHORTEST_HOLD_S or before.kind not in ("diverged", "limit_cycle"):
            reason = f"{in_words(without)}: the network or a node was away, which says nothing of the law"
            reason = "; ".join([reason, *_causes(programme, without[0].start_s, without[-1].end_s)])
            return Hold(start, end, force, *verdict._replace(kind="guarded", reason=reason))
        verdict = before
    if not presses and verdict.kind == "stable":
        verdict = verdict._replace(
            reason=f"the hand presses with {abs(force):.2g} N, and nothing moves: this is no hold"
        )
    return Hold(start, end, force, *verdict)


def _landed(
    series: _Times,
    tip: Instrument,
    hold: tuple[float, float, float],
    judged: npt.NDArray[np.bool_],
    greatest_n: float,
) -> float | None:
    """Return how long before the end of a hold, as judged, the tip met the surface, if it did so in the hold [s].

    It has to be the first time since the hand began to press, and to stay: a tip that is thrown off lands again.
    """
    if not judged.any():
        return None
    last = int(np.flatnonzero(judged)[-1])
    idle = (series.hand_s < hold[0]) & (np.abs(series.hand_force_n) <= _PRESSING_SHARE * greatest_n)
    first = int(np.searchsorted(series.tip_s, series.hand_s[idle].max(initial=series.hand_s[0])))
    changes = np.flatnonzero(np.diff(tip.in_contact[first : last + 1]))
    if len(changes) != 1 or not tip.in_contact[last]:
        return None
    landed_s = float(series.tip_s[first + changes[0] + 1])
    return float(series.tip_s[last]) - landed_s if landed_s >= hold[0] else None


def _judge_swing(series: _Times, tip: Instrument | None, swing: Swing, greatest_n: float, programme: Programme) -> Hold:
    """Judge a swing as a hold; one that goes on as it is, or of which there is no telling, is a limit cycle."""
    inside = (series.tip_s >= swing.start_s) & (series.tip_s <= swing.end_s)
    known = Circumstances(noisy=True)
    if tip is not None and (lost := inside & ~tip.following).any():
        known = _guarded(known, series.tip_s, tip, int(np.argmax(lost)), programme)
        inside &= series.tip_s < series.tip_s[int(np.argmax(lost))]
    at = slice(*np.searchsorted(series.hand_s, (swing.start_s, swing.end_s)).tolist())
    force = float(series.hand_force_n[at].mean()) if series.hand_force_n[at].size else 0.0
    found = judge(series.tip_s[inside], series.scaled_force_n[inside], greatest_n, known)
    words = f"{swing.peak_to_peak_n:.3g} N from peak to peak at {swing.frequency_hz:.3g} Hz"
    if found.kind not in ("diverged", "guarded"):
        # The last turn says what becomes of a swing of a few turns that the models do not fit.
        left_n = float(np.ptp(series.scaled_force_n[inside & (series.tip_s > swing.end_s - 1.0 / swing.frequency_hz)]))
        dies_out = left_n < _LEFT_SHARE * swing.peak_to_peak_n
        reason = f"a swing of {words} " + (f"dies out: {left_n:.2g} N are left" if dies_out else "goes on")
        kind: Kind = "stable" if dies_out else "limit_cycle"
        found = Verdict(kind, found.growth_per_s, swing.peak_to_peak_n, found.noise_n, reason)
    return Hold(swing.start_s, swing.end_s, force, *found, swing.frequency_hz)


def _guarded(
    known: Circumstances, tip_time_s: Series, tip: Instrument, lost: int, programme: Programme
) -> Circumstances:
    """Add when and why the instrument withdrew, from its first sample in a hold in which it had."""
    while lost > 0 and not tip.following[lost - 1]:
        lost -= 1
    if lost == 0:
        before = [guard for guard in programme.guards if guard.time_s <= float(tip_time_s[0])]
        if not before:
            return known._replace(guarded=True, guard="the instrument followed no command from the beginning on")
        words, starved = _in_words(before[-1].time_s, before[-1].reason, programme)
        return known._replace(guarded=True, guard=words, starved=starved)
    at_s = float(tip_time_s[lost])
    near = [guard for guard in programme.guards if abs(guard.time_s - at_s) <= REPORTED_WITHIN_S]
    reason = min(near, key=lambda guard: abs(guard.time_s - at_s)).reason if near else ""
    if not reason and tip.held is not None and bool(tip.held[lost - 1]):
        reason = "hold_expired"
    words, starved = _in_words(at_s, reason, programme)
    return known._replace(guarded=True, guard=words, starved=starved)


def _in_words(at_s: float, reason: str, programme: Programme) -> tuple[str, bool]:
    """Return when, why and at which limit the guard acted, and whether it did because commands were missing."""
    limit = programme.limits.words(reason) if programme.limits is not None else ""
    why = ": ".join(part for part in (reason, limit) if part)
    if reason in _STARVED:
        words = f"the instrument withdrew at {at_s:.3f} s because no command came ({why}): "
        words += "the network or a node was away, which says nothing of the law"
        return "; ".join([words, *_causes(programme, at_s, at_s)]), True
    when = f"at {at_s:.3f} s" + (", before the hand's programme" if at_s < 0.0 else "")
    return f"{GUARD_ACTED} {when}" + (f" ({why})" if why else ""), False


def guard_of(tip_time_s: Series, tip: Instrument, programme: Programme = NO_PROGRAMME) -> str:
    """Return when, why and at which limit the guard first ended a session, in or between its holds; empty if never.

    A stop that a person asked for is none, nor is one of which no reason is known.
    """
    before = np.concatenate([np.ones(1, dtype=bool), tip.following[:-1]])[: len(tip_time_s)]
    for index in np.flatnonzero(~tip.following & before).tolist():
        at_s = float(tip_time_s[index])
        near = [guard for guard in programme.guards if abs(guard.time_s - at_s) <= REPORTED_WITHIN_S]
        # a session that begins withdrawn was ended by what the guard did last
        near = near or [guard for guard in programme.guards if index == 0 and guard.time_s <= at_s][-1:]
        if near and near[0].reason in _GUARDING:
            return _in_words(near[0].time_s if index == 0 else at_s, near[0].reason, programme)[0]
    return ""


def _causes(programme: Programme, start_s: float, end_s: float) -> list[str]:
    """Return the incidents that a stretch without samples or commands may be due to."""
    return [
        f"at {incident.time_s:.3f} s: {incident.text}"
        for incident in programme.incidents
        if start_s - _CAUSED_WITHIN_S <= incident.time_s <= end_s + _NOTICED_WITHIN_S
    ]


def verdict_of(
    holds: list[Hold], guard: str = "", greatest_n: float | None = None, interrupted: str = ""
) -> tuple[Kind, str]:
    """Return the verdict on a session and the reason: those of its worst hold, or of the last where all are stable.

    Parameters: guard, what `guard_of` says, which comes first in the reason, and makes a session guarded that no hold
    shows to be; greatest_n, the hand's greatest force [N], if it is known; interrupted, what `in_words` says of the
    session's interruptions, with which the reason ends.
    """
    kind, reason = _worst_of(holds, greatest_n)
    if guard:
        kind = kind if kind in ("diverged", "guarded", "no_data") else "guarded"
        reason = reason if reason.startswith(guard) else f"{guard}; {reason}"
    return kind, f"{reason}; in the session {interrupted}" if interrupted else reason


def _worst_of(holds: list[Hold], greatest_n: float | None) -> tuple[Kind, str]:
    if not holds and greatest_n == 0.0:
        return "cannot_say", "the hand pressed with no force, so there is no hold to judge"
    if not holds:
        return "cannot_say", "the hand never stood still for long enough"
    # Among several holds that are equally bad, the first one decides.
    decisive = min(holds, key=lambda hold: _WORST_FIRST.index(hold.verdict))
    if decisive.verdict == "stable":
        decisive = max(reversed(holds), key=lambda hold: abs(hold.hand_force_n) > _PRESSING_SHARE * (greatest_n or 0.0))
    return decisive.verdict, decisive.reason
