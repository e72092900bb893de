"""The holds of a session, cut into episodes first and judged afterwards.

A hold is a stretch of constant hand force. It is cut into episodes by actions of the hand, the operator, the schedule,
the link, the machine or the guard, and never by the motion of the loop:

- the approach ends when the tip first touches after the hand began to press; if the tip leaves the surface later, that
  is motion of the loop;
- the loop is open from the *cause* of an interruption on: a tip is held, or a hand let go, only one deadline after its
  last command came, and commands stopped up to a transit earlier;
- the tip is away while a program of the instrument, an operator or the guard moves it.

`telenano.analysis.verdict` judges contact with the loop closed; everything else is a fact beside the verdict. If the
instrument does not measure contact, the tip counts as touching where its force is more than small.

If a person is the hand, its force swings with the loop, so that an oscillation leaves no hold. A swing of the tip's
force (`telenano.analysis.swings`) is then judged instead of a hold.
"""

import math
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from telenano.analysis.interruptions import DEADLINE, REPORTED_WITHIN_S, Interruption, in_words
from telenano.analysis.measured_noise import Noise, free_noise
from telenano.analysis.modes import LEAST_SAMPLES, centred, rms
from telenano.analysis.swings import Swing, swings_of
from telenano.analysis.verdict import (
    ERROR_SHARE,
    LEAST_TURNS,
    SMALL_SHARE,
    WAY_TRIPS,
    Cause,
    Kind,
    Verdict,
    judge,
    noise_of,
    reach_of,
    rounding_of,
)
from telenano.recording.silence import HAND, LONGEST_STEP_S

Series = npt.NDArray[np.float64]
Span = tuple[float, float]
FactKind = Literal[
    "arrived_late",
    "struck",
    "off_force",
    "parted",
    "nothing_moved",
    "interrupted",
    "machine_late",
    "link_late",
    "contact_by_force",
    "grows_small",
]

# The thresholds of the episodes and of their facts; docs/verdicts.md has them in one table with those of the verdicts.
# shortest hold [s]: a slow loop swings at some 5 Hz
SHORTEST_HOLD_S = 0.5
# change of the hand's force in a hold, as a share of its greatest [1]: sensors of hands resolve no less
STEADY_SHARE = 0.01
# greatest force or trembling at the tip, as a multiple of the hand's [1]: an undamped spring reaches twice a step
STRUCK_FORCES = 2.0
# greatest distance between hand and tip at rest, at the hand's scale [m]: three times the 0.33 mm by which 1 N moves
# the hand on a sample of 20 N/m, which the default scales render as 3000 N/m
PARTED_M = 1e-3
# least lateness that is attributed to the machine or the link [s]: a fifth of the deadline of both devices
LATE_S = 0.01

# topics whose samples must not be missing
TIP = "afm/state"
ANSWERS = "haptic/command"
# least share of a hold in which hand and tip must be coupled, so that it is judged as one of both [1]
COUPLED_SHARE = 0.5
# reasons that the instrument states if it withdraws for want of commands, and if its guard acts at all
_STARVED = (DEADLINE, "hold_expired")
_GUARDING = (*_STARVED, "force_limit", "lateral_limit", "force_invalid", "device_lost")
# reasons that it states if a program, an operator or the end of the session retracts the tip
_ASKED = ("retract_requested", "estop")
# longest time from an incident to its effect [s]
_CAUSED_WITHIN_S = 3.0
# longest time from an effect to the report of the incident that caused it [s]
_NOTICED_WITHIN_S = 2.0
GUARD_ACTED = "the instrument's guard acted"
# A swing counts more than a lost contact: a person notices it first, and it does not end by itself.
_WORST_FIRST: tuple[Kind, ...] = (
    *("diverged", "guarded", "limit_cycle", "contact_lost", "no_data", "cannot_say", "stable"),
)


class Fact(NamedTuple):
    """A further fact on a hold: its kind, its value in the unit that its text states, and the text."""

    kind: FactKind
    value: float
    text: str


class Hold(NamedTuple):
    """A stretch of constant hand force, and the verdict on alpha_f F_s in it: see `telenano.analysis.verdict.Verdict`.

    judged_from_s, judged_to_s: start and end of the judged episode [s], None without one; rest_from_s: start of the
    rest [s], if any; hold_ratio: mean of F_m/(alpha_f F_s) in the later half of the rest, None if the tip does not come
    to rest or does not press; frequency_hz: None, or the frequency of a swing that is judged instead of a hold [Hz],
    and hand_force_n is then the mean; coupled_share: the share of the hold in which hand and tip were coupled: both
    sent samples, the motor of the hand was on, and the tip followed.
    """

    start_s: float
    end_s: float
    hand_force_n: float
    verdict: Kind
    growth_per_s: float | None
    peak_to_peak_n: float
    noise_n: float
    reason: str
    facts: tuple[Fact, ...] = ()
    judged_from_s: float | None = None
    judged_to_s: float | None = None
    rest_from_s: float | None = None
    hold_ratio: float | None = None
    frequency_hz: float | None = None
    coupled_share: float = 1.0

    def has(self, *kinds: FactKind) -> bool:
        """Return whether the hold has a fact of one of these kinds."""
        return any(fact.kind in kinds for fact in self.facts)


class Instrument(NamedTuple):
    """States of the instrument at the tip's times: whether it follows commands, and whether the tip touches.

    held: whether the base stands still for want of commands or on request, which also counts as following; apart_m: the
    distance of the hand ahead of the tip, x_m - x_s / alpha_p [m]; knows_contact: whether contact is measured.
    """

    following: npt.NDArray[np.bool_]
    in_contact: npt.NDArray[np.bool_]
    held: npt.NDArray[np.bool_] | None = None
    apart_m: Series | None = None
    knows_contact: bool = True


class Guard(NamedTuple):
    """A report of the instrument that it withdraws: time [s], and reason as in `telenano.afm.safety`."""

    time_s: float
    reason: str


class Limits(NamedTuple):
    """Limits of the instrument's guard: force on the tip [N], time without a command until it withdraws [s]."""

    force_n: float
    silence_s: float

    def words(self, reason: str) -> str:
        """Return the limit to which a reason of the guard refers, in words; empty if it refers to none."""
        if reason == "force_limit":
            return f"more than {1e9 * self.force_n:.4g} nN on the tip"
        return f"none for {1e3 * self.silence_s:.4g} ms" if reason in _STARVED else ""


class Incident(NamedTuple):
    """A report of a launcher or the link that may explain the end of a hold: time [s], and sentence."""

    time_s: float
    text: str


class Late(NamedTuple):
    """A delay: when a step of a process or an answer was due [s], by how much it was late [s], and who was late."""

    start_s: float
    by_s: float
    who: Literal["machine", "link"] = "machine"

    def span_s(self, transit_s: float) -> tuple[float, float]:
        """Return start and end [s] of its effect at the tip, longer by transit_s [s] if the link was late."""
        return self.start_s, self.start_s + self.by_s + (transit_s if self.who == "link" else 0.0)


class Lack(NamedTuple):
    """A span without samples of a topic: start and end [s], and whether the samples were sent and are lost."""

    topic: str
    start_s: float
    end_s: float
    lost: bool = True

    def __str__(self) -> str:
        if not self.lost and self.topic != ANSWERS:
            source = "hand" if self.topic == HAND else "AFM"
            return f"the {source} sent nothing from {self.start_s:.3f} s to {self.end_s:.3f} s of the session"
        what = "no answer reached the hand" if self.topic == ANSWERS else "nothing"
        return f"{self.topic}: {what} from {self.start_s:.3f} s to {self.end_s:.3f} s of the session"


class SessionContext(NamedTuple):
    """Facts on a session besides its series.

    planned: holds of the operator's force profile, start [s], end [s], force [N]; answered_s: times at which answers
    reached the hand [s], None if unknown; guards: reports of the instrument's guard; incidents: nodes that ended and
    sites that fell silent; limits: those of the instrument's guard, if known; programs: start and end [s] of each
    program of the instrument; by_hand: whether a person is the hand, whose force swings with the loop; interruptions:
    spans with the loop open; late: delays of processes; deadline_s: time without a command after which a device opens
    the loop [s]; transit_s: longest transit of a command [s]; rest_force: alpha_f F_s [N] at which the law rests, as
    a function of the hand's force [N], None if the law does not state it; silences: topic of hand or tip, with start
    and end [s] of a span in which its source sent nothing, so that nothing is lost; let_go: start and end [s] of each
    span with the motor of the hand off; noise: what the instrument states of the noise of its read-out, for a tip that
    is never free, None if it states nothing.
    """

    planned: Sequence[tuple[float, float, float]] = ()
    answered_s: Series | None = None
    guards: Sequence[Guard] = ()
    incidents: Sequence[Incident] = ()
    limits: Limits | None = None
    programs: Sequence[tuple[float, float]] = ()
    by_hand: bool = False
    interruptions: Sequence[Interruption] = ()
    late: Sequence[Late] = ()
    deadline_s: float = LONGEST_STEP_S
    transit_s: float = 0.0
    rest_force: Callable[[float], float] | None = None
    silences: Sequence[tuple[str, float, float]] = ()
    let_go: Sequence[tuple[float, float]] = ()
    noise: Noise | None = None


NO_CONTEXT = SessionContext()


def constant_stretches(time_s: Series, force_n: Series, tolerance_n: float) -> list[tuple[float, float]]:
    """Return the stretches [s] of at least SHORTEST_HOLD_S over which a force stays within a tolerance of its start."""
    stretches: list[tuple[float, float]] = []
    first = 0
    for index in range(1, len(time_s) + 1):
        if index < len(time_s) and abs(force_n[index] - force_n[first]) <= tolerance_n:
            continue
        if time_s[index - 1] - time_s[first] >= SHORTEST_HOLD_S:
            stretches.append(_stood(time_s[first:index], force_n[first:index]))
        first = index
    return stretches


def _stood(time_s: Series, force_n: Series) -> tuple[float, float]:
    """Return start and end [s] of the constant part of a stretch that the force enters and leaves by small steps."""
    off_n = np.abs(force_n - np.median(force_n))
    still = np.flatnonzero(off_n <= 3.0 * float(np.median(off_n)))
    return float(time_s[still[0]]), float(time_s[still[-1]])


def gaps_in(times_s: Series, start_s: float, end_s: float) -> list[tuple[float, float]]:
    """Return the spans [s] between a start and an end in which no sample came for longer than LONGEST_STEP_S."""
    inside = times_s[(times_s >= start_s) & (times_s <= end_s)]
    edges = [start_s, *inside.tolist(), end_s]
    return [(first, last) for first, last in pairwise(edges) if last - first > LONGEST_STEP_S]


def lacks_of(
    hand_time_s: Series, tip_time_s: Series, span_s: tuple[float, float], context: SessionContext = NO_CONTEXT
) -> list[Lack]:
    """Return the spans without samples because of which a hold cannot be judged; none if it has enough samples.

    More than a tenth of the hand's or the tip's samples must be missing, in spans longer than LONGEST_STEP_S, or all
    answers, because delays and losses of some answers belong to the loop. If more than a tenth is lost, the losses are
    returned, otherwise the silences: samples that a source did not send, and answers that did not reach the hand, do
    not count as lost.

    Args:
        hand_time_s: The times of the hand's samples [s].
        tip_time_s: The times of the tip's samples [s].
        span_s: The start and the end of the hold [s].
        context: The silences of the session, and the times of answers at the hand.
    """
    start_s, end_s = span_s
    lacking = []
    for topic, times in ((HAND, hand_time_s), (TIP, tip_time_s)):
        silent = [(first, last) for one, first, last in context.silences if one == topic]
        spans = [(*span, not _covered(span, silent)) for span in gaps_in(times, start_s, end_s)]
        for lost in (True, False):
            own = [Lack(topic, first, last, lost) for first, last, is_lost in spans if is_lost is lost]
            lacks_s = sum(one.end_s - one.start_s for one in (own if lost else [Lack(topic, *span) for span in spans]))
            if lacks_s > ERROR_SHARE * (end_s - start_s):
                lacking += own
                break
    knows_hand = not any(lack.topic == HAND for lack in lacking)
    answered_s = context.answered_s
    if knows_hand and answered_s is not None and not ((answered_s >= start_s) & (answered_s <= end_s)).any():
        lacking.append(Lack(ANSWERS, start_s, end_s, lost=False))
    return lacking


def coupled_share(context: SessionContext, tip_time_s: Series, tip: Instrument, span_s: Span) -> float:
    """Return the share of a span [s] in which hand and tip were coupled, 0 to 1.

    That is: both sent samples, the motor of the hand was on, and the tip followed. Lost samples count as the last one
    before them.
    """
    start_s, end_s = span_s
    out: list[Span] = [(first, last) for _, first, last in context.silences]
    out += context.let_go
    out += [(one.start_s, one.end_s) for one in context.interruptions]
    away = ~tip.following if tip.held is None else ~tip.following | tip.held
    edges = np.flatnonzero(np.diff(away, prepend=False, append=False)).reshape(-1, 2).tolist()
    out += [(float(tip_time_s[i]), float(tip_time_s[min(j, len(tip_time_s) - 1)])) for i, j in edges]
    if away.size and away[-1]:
        out[-1] = (out[-1][0], max(end_s, out[-1][1]))
    within_s = sum(last - first for first, last in outside(span_s, out, 0.0))
    return within_s / (end_s - start_s) if end_s > start_s else 0.0


def judge_holds(
    hand_time_s: Series,
    hand_force_n: Series,
    tip_time_s: Series,
    scaled_force_n: Series,
    tip: Instrument | None = None,
    context: SessionContext = NO_CONTEXT,
    spans: Sequence[tuple[float, float, float]] | None = None,
) -> list[Hold]:
    """Return the holds of a session, each with its verdict.

    A force is small relative to the greatest force of the hand in the session, so that all holds share one measure. A
    stretch in which the hand does not press and the tip does not touch is no hold. A hold with lost samples of hand or
    tip is `no_data`, and so is a planned one that the recording does not show at all. A hold in which a source sent
    nothing, no answer reached the hand, or hand and tip were coupled for less than half of it is `guarded`, unless its
    motion shows more. A hold ends when the instrument starts a program of its own or is told to withdraw.

    Args:
        hand_time_s: The times of the hand's samples [s], shape (n,).
        hand_force_n: F_m at those times [N], shape (n,).
        tip_time_s: The times of the tip's samples [s], shape (m,).
        scaled_force_n: alpha_f F_s at those times [N], shape (m,).
        tip: The states of the instrument at those times; None if they are not known.
        context: Facts on the session besides its series.
        spans: Start [s], end [s] and force [N] of the holds, if they are known although the force of the hand, an arm,
            is not constant; None finds them.
    """
    forces = [*np.abs(hand_force_n).tolist(), *(abs(force) for _, _, force in context.planned)]
    greatest = float(max(forces, default=0.0))
    if greatest == 0.0:
        return []
    if tip is None:
        always = np.ones(len(tip_time_s), dtype=bool)
        tip = Instrument(always, always, knows_contact=False)
    if not tip.knows_contact:
        tip = tip._replace(in_contact=np.abs(scaled_force_n) > SMALL_SHARE * greatest)
    step_n = rounding_of(scaled_force_n)
    late = _late(context)
    free = free_noise(_free(hand_time_s, hand_force_n, tip_time_s, scaled_force_n, tip, SMALL_SHARE * greatest))
    free = context.noise if free is None else free
    series = (hand_time_s, hand_force_n, tip_time_s, scaled_force_n)
    session = _Session(*series, tip, context, greatest, step_n, late, free)
    if spans is not None:
        return [hold_judged for hold in spans if (hold_judged := _judge_hold(session, hold, spans)) is not None]
    away = absences(tip_time_s, tip, context)
    stretches = constant_stretches(hand_time_s, hand_force_n, STEADY_SHARE * greatest)
    holds = []
    for start, end in [part for stretch in stretches for part in outside(stretch, away)]:
        force = float(np.interp(0.5 * (start + end), hand_time_s, hand_force_n))
        holds.append((start, end, force))
    # A planned hold that the recording does not show at the hand has no data.
    for start, end, force in context.planned:
        shown_s = sum(max(0.0, min(end, last) - max(start, first)) for first, last, _ in holds)
        if shown_s >= 0.5 * (end - start):
            continue
        pressed = hand_force_n[slice(*np.searchsorted(hand_time_s, (start, end)).tolist())]
        is_held = len(pressed) and abs(float(pressed.mean()) - force) < ERROR_SHARE * greatest
        if lacks_of(hand_time_s, hand_time_s, (start, end), context._replace(answered_s=None)):
            holds.append((start, end, force))
        elif is_held and not context.by_hand:
            # The hand trembles about the planned force.
            parts = outside((start, end), away)
            holds = [hold for hold in holds if not _covered(hold, [(start, end)])]
            holds += [(first, last, force) for first, last in parts]
    swings = swings_of(tip_time_s, scaled_force_n) if context.by_hand else []
    swings = [swing for swing in swings if not _covered(swing, [*holds, *away])]
    # A swinging hand stands still now and then, which is no hold.
    holds = sorted(hold for hold in holds if not _covered(hold, swings))
    judged = [hold_judged for hold in holds if (hold_judged := _judge_hold(session, hold, holds)) is not None]
    judged += [_judge_swing(session, swing) for swing in swings]
    return sorted(judged, key=lambda hold: hold.start_s)


def _free(
    hand_s: Series, hand_n: Series, tip_s: Series, tip_n: Series, tip: Instrument, small_n: float
) -> list[Series]:
    """Return the force of the tip [N] in each stretch in which it touches nothing, follows, and no hand presses."""
    idle = np.interp(tip_s, hand_s, np.abs(hand_n)) <= small_n
    free = tip.following & ~tip.in_contact & idle & np.isfinite(tip_n)
    edges = np.flatnonzero(np.diff(free, prepend=False, append=False)).reshape(-1, 2).tolist()
    # Where a stretch begins and ends the tip snaps in, and off.
    return [tip_n[first + (last - first) // 16 : last - (last - first) // 16] for first, last in edges]


def _late(context: SessionContext) -> list[Late]:
    """Return the delays of machine and link in a session, in the order of time."""
    late = list(context.late)
    if context.answered_s is not None and len(context.answered_s) > 1:
        steps_s = np.diff(context.answered_s)
        # On an uneven link, an interval counts as late only beyond the usual ones.
        places = np.flatnonzero(steps_s > float(np.percentile(steps_s, 99.0)) + LATE_S)
        # The missing answers were due at the tip up to the transit earlier.
        since_s = context.answered_s[places] - context.transit_s
        late += [Late(*pair, "link") for pair in zip(since_s.tolist(), steps_s[places].tolist(), strict=True)]
    return sorted(late)


class _Session(NamedTuple):
    """The series of a session, its context, the hand's greatest force [N], and the step of the read-out [N].

    A read-out that rounds does so in motion and at rest, so its step is found in the whole session. `late`: the delays
    of machine and link, in the order of time.
    """

    hand_s: Series
    hand_n: Series
    tip_s: Series
    tip_n: Series
    tip: Instrument
    known: SessionContext
    greatest_n: float
    step_n: float
    late: list[Late]
    free: Noise | None = None

    @property
    def small_n(self) -> float:
        return SMALL_SHARE * self.greatest_n

    def rest_n(self, force_n: float) -> float | None:
        """Return alpha_f F_s [N] at which the law rests for a force of the hand [N]; None if it does not state it."""
        rest_n = self.known.rest_force(force_n) if self.known.rest_force is not None else np.nan
        return rest_n if np.isfinite(rest_n) else None

    def late_in(self, start_s: float, end_s: float) -> list[Late]:
        """Return the delays of machine and link that start in a span [s], in the order of time."""
        return [one for one in self.late if start_s <= one.start_s < end_s]

    def at(self, start_s: float, end_s: float) -> slice:
        """Return the slice of the tip's samples from a start to before an end [s]."""
        return slice(*np.searchsorted(self.tip_s, (start_s, max(end_s, start_s))).tolist())


class Episode(NamedTuple):
    """A part of a hold: approach, contact, loop open, or tip away; start and end [s], and why it ended."""

    kind: Literal["approach", "contact", "open", "away"]
    start_s: float
    end_s: float
    why: str = ""


def episodes_of(session: "_Session", start_s: float, end_s: float) -> list[Episode]:
    """Return the episodes of a hold, one after the other."""
    episodes: list[Episode] = []
    now_s = start_s
    away_s, away_why = _withdrawn(session, start_s, end_s)
    for first_s, last_s, why in [*_openings(session, start_s, away_s), (away_s, away_s, "")]:
        if first_s > now_s:
            # The tip arrives anew after the start of the press, and after each time with the loop open.
            since_s = _press_s(session, now_s) if now_s == start_s else now_s
            part = session.at(since_s, first_s)
            touching = np.flatnonzero(session.tip.in_contact[part])
            arrived_s = float(session.tip_s[part][touching[0]]) if touching.size else first_s
            if arrived_s > now_s:
                episodes.append(Episode("approach", now_s, min(arrived_s, first_s)))
            if arrived_s < first_s:
                episodes.append(Episode("contact", max(arrived_s, now_s), first_s, why))
        if last_s > first_s:
            episodes.append(Episode("open", max(first_s, now_s), last_s, why))
        now_s = max(now_s, last_s)
    if away_s < end_s:
        episodes.append(Episode("away", away_s, end_s, away_why))
    return episodes


def _press_s(session: _Session, start_s: float) -> float:
    """Return when the hand began the press that is going on at a time [s]."""
    idle = (session.hand_s < start_s) & (np.abs(session.hand_n) <= session.small_n)
    return float(session.hand_s[idle].max(initial=session.hand_s[0] if session.hand_s.size else start_s))


def _openings(session: _Session, start_s: float, end_s: float) -> list[tuple[float, float, str]]:
    """Return each span with the loop open, from its cause to its end [s], with the reason; overlapping ones joined."""
    session_context, openings = session.known, []
    for one in session_context.interruptions:
        back_s = session_context.deadline_s + session_context.transit_s if one.starved else 0.0
        if one.kind != "process_ended":
            openings.append((one.start_s - back_s, one.end_s, in_words([one])))
    if session.tip.held is not None:
        edges = np.flatnonzero(np.diff(session.tip.held, prepend=False, append=False)).reshape(-1, 2)
        ends = [(float(session.tip_s[i]), float(session.tip_s[min(j, len(session.tip_s) - 1)])) for i, j in edges]
        openings += [(first, last, f"at {first:.3f} s the tip was held as somebody asked") for first, last in ends]
    joined: list[tuple[float, float, str]] = []
    for first, last, why in sorted(openings):
        if last < start_s or first >= end_s:
            continue
        if joined and first <= joined[-1][1]:
            joined[-1] = (joined[-1][0], max(min(last, end_s), joined[-1][1]), joined[-1][2])
        else:
            joined.append((max(first, start_s), min(last, end_s), why))
    return joined


def _withdrawn(session: _Session, start_s: float, end_s: float) -> tuple[float, str]:
    """Return when the instrument stopped following in a hold, or the hold's end [s], and the stated reason."""
    part = session.at(start_s, end_s)
    lost = np.flatnonzero(~session.tip.following[part])
    if not lost.size:
        return end_s, ""
    first = part.start + int(lost[0])
    while first > 0 and not session.tip.following[first - 1]:
        first -= 1
    at_s, guards = float(session.tip_s[first]), session.known.guards
    if first == 0:
        guards = [guard for guard in guards if guard.time_s <= at_s][-1:]
        return start_s, guards[0].reason if guards else "never"
    near = [guard for guard in guards if abs(guard.time_s - at_s) <= REPORTED_WITHIN_S]
    reason = min(near, key=lambda guard: abs(guard.time_s - at_s)).reason if near else ""
    if not reason and session.tip.held is not None and bool(session.tip.held[first - 1]):
        reason = "hold_expired"
    return max(at_s, start_s), reason


def _judge_hold(session: _Session, hold: tuple[float, float, float], holds: Sequence[tuple[float, ...]]) -> Hold | None:
    """Return a hold with its verdict and facts; None if the hand does not press and the tip does not touch."""
    start, end, force = hold
    episodes = episodes_of(session, start, end)
    contacts = [one for one in episodes if one.kind == "contact"]
    lacking = lacks_of(session.hand_s, session.tip_s, (start, end), session.known)
    lost = [one for one in lacking if one.lost]
    share = coupled_share(session.known, session.tip_s, session.tip, (start, end))
    away = next((one for one in episodes if one.kind == "away"), None)
    touches = bool(contacts) and bool(session.tip.in_contact[session.at(0.5 * (start + end), end)].all())
    if abs(force) <= session.small_n and not touches and not lacking and away is None:
        return None
    if lost and away is None:
        causes = _causes(session.known, lost[0].start_s, lost[-1].end_s)
        words = "; ".join([*map(str, lost), *causes])
        return Hold(start, end, force, "no_data", None, 0.0, 0.0, words, coupled_share=share)
    first, verdict = _judged_contact(session, contacts, episodes, force)
    if away is not None:
        verdict = _guarded(session, away, verdict, first)
    elif lacking or share < COUPLED_SHARE:
        verdict = _interrupted(session, (start, end), lacking, share, verdict)
    elif first is not None and verdict.kind == "stable":
        own = session.at(first.start_s, first.end_s)
        left_s = float(session.tip_s[own][session.tip.in_contact[own]].max(initial=first.start_s))
        # The tip was away for the last eighth.
        if left_s < first.end_s - 0.125 * (first.end_s - first.start_s):
            words = f"the tip left the surface at {left_s:.3f} s, and stayed away"
            verdict = verdict._replace(kind="contact_lost", reason=words)
    if first is not None and away is None:
        verdict = _seen_long_enough(session, first, verdict)
    judged = Hold(start, end, force, *verdict[:5], coupled_share=share)
    if first is not None:
        rests = verdict.kind == "stable" and verdict.rest_from_s is not None
        rest_s = max(verdict.rest_from_s or 0.0, first.start_s) if rests else None
        judged = judged._replace(judged_from_s=first.start_s, judged_to_s=first.end_s, rest_from_s=rest_s)
    hand_n, tip_n = hold_forces(judged, *session[:4])
    if len(tip_n) and (tip_n > session.small_n).all():
        judged = judged._replace(hold_ratio=float((hand_n / tip_n).mean()))
    before_s = max((one[1] for one in holds if one[1] <= start), default=float(session.hand_s[0]))
    facts = _facts(session, judged, episodes, before_s, tip_n)
    if verdict.cause is Cause.GROWS_SMALL:
        facts.append(Fact("grows_small", verdict.growth_per_s or 0.0, verdict.reason))
    return judged._replace(facts=tuple(facts))


def _seen_long_enough(session: _Session, part: Episode, verdict: Verdict) -> Verdict:
    """Return a verdict, or that it cannot be said if a contact that no guard ended is short beside the round trip."""
    least_s = WAY_TRIPS * session.known.transit_s
    if verdict.kind not in ("diverged", "limit_cycle") or part.end_s - part.start_s >= least_s:
        return verdict
    words = f"{verdict.reason}, and the force may be on its way: a hold of {least_s:.2g} s or more would decide"
    return verdict._replace(kind="cannot_say", reason=words)


def hold_forces(
    hold: Hold, hand_time_s: Series, hand_force_n: Series, tip_time_s: Series, scaled_force_n: Series
) -> tuple[Series, Series]:
    """Return F_m and alpha_f F_s [N] at the tip's times in the later half of a hold's rest; empty without a rest."""
    if hold.rest_from_s is None or hold.judged_to_s is None:
        return np.empty(0), np.empty(0)
    ends = (0.5 * (hold.rest_from_s + hold.judged_to_s), hold.judged_to_s)
    part = slice(*np.searchsorted(tip_time_s, ends).tolist())
    return np.interp(tip_time_s[part], hand_time_s, hand_force_n), scaled_force_n[part]


def _judged_contact(
    session: _Session, contacts: Sequence[Episode], episodes: Sequence[Episode], force_n: float
) -> tuple[Episode | None, Verdict]:
    """Return the episode by which a hold is judged, the longest undisturbed contact, and the verdict.

    The course of a motion in it is due to the loop: an interruption before may have started the motion, but neither
    sustains it nor makes it grow. A machine that was late before may again be late by less than is reported, and
    sustain it: the motion is then a limit cycle only if the motion before does not contradict that.
    """
    if not contacts:
        opened = next((one.why for one in episodes if one.kind == "open"), "")
        words = "the tip had not reached the surface by the end of the hold: a longer hold would decide"
        words = f"{opened}: a hold that nothing interrupts would decide" if opened else words
        return None, Verdict("cannot_say", None, 0.0, 0.0, words)
    parts: list[Episode] = []
    for one in contacts:
        late = [each.span_s(session.known.transit_s) for each in session.late_in(one.start_s, one.end_s)]
        parts += [one._replace(start_s=start, end_s=end) for start, end in outside((one.start_s, one.end_s), late, 0.0)]
    part = max(parts or contacts, key=lambda each: each.end_s - each.start_s)
    verdict = _judge_motion(session, part, force_n)
    longest = max(contacts, key=lambda each: each.end_s - each.start_s)
    if verdict.kind == "cannot_say" and longest != part:
        # A motion that dies out although it is disturbed would die out undisturbed as well.
        whole = _judge_motion(session, longest, force_n)
        part, verdict = (longest, whole) if whole.kind == "stable" else (part, verdict)
    late_there = session.late_in(contacts[0].start_s, contacts[-1].end_s)
    late_words = _late_words(late_there)
    causes = [*dict.fromkeys(one.why for one in contacts if one.why)] + ([late_words] if late_words else [])
    if verdict.kind == "stable" and causes:
        for other in parts:
            if other is not part and 2.0 * (other.end_s - other.start_s) > part.end_s - part.start_s:
                again = _judge_motion(session, other, force_n)
                verdict = again._replace(kind="cannot_say") if again.kind == "diverged" else verdict
    if not causes or verdict.kind == "stable" or (verdict.kind == "diverged" and parts):
        return part, verdict
    if verdict.kind == "limit_cycle" and parts:
        # A single stall is reported at most twice, at the hand and at the tip.
        overloaded = sum(one.who == "machine" for one in late_there) > LEAST_TURNS
        before = [one for one in parts if one.end_s - one.start_s >= SHORTEST_HOLD_S and one.start_s < part.start_s]
        agrees = bool(before) and _judge_motion(session, before[0], force_n).kind != "stable"
        if agrees or not overloaded or part.start_s == contacts[0].start_s:
            return part, verdict
    words = f"{verdict.reason}, from {part.start_s:.3f} s to {part.end_s:.3f} s; {', '.join(causes)}"
    return part, verdict._replace(kind="cannot_say", reason=f"{words}: a hold that nothing interrupts would decide")


def _judge_motion(session: _Session, part: Episode, force_n: float) -> Verdict:
    """Judge the motion of an episode, without the part that follows the hand's trembling.

    A motion of less than STRUCK_FORCES times that of the hand may be the response of a stable loop.
    """
    own = session.at(part.start_s, part.end_s)
    tip_s, touches = session.tip_s[own], session.tip.in_contact[own]
    tip_n, rest_n = _without_hand(session, part.start_s, part.end_s), session.rest_n(force_n)
    first, last = np.searchsorted(session.hand_s, (part.start_s, part.end_s)).tolist()
    # The trembling of a hand varies, so the largest quarter counts.
    quarters = pairwise(np.linspace(first, last, 5).astype(int).tolist())
    trembling = [rms(centred(session.hand_n[i:j])) for i, j in quarters if j > i]
    own_n = 2.0 * math.sqrt(2.0) * max(trembling, default=0.0)
    answers_n = STRUCK_FORCES * own_n

    def judged(samples: slice) -> Verdict:
        force_n, known = tip_n[samples], (session.greatest_n, rest_n, session.step_n)
        return judge(tip_s[samples], force_n, *known, free=session.free, answers_n=answers_n)

    # Judge the motion since the landing of the tip, and the whole one: the milder verdict counts.
    verdicts = [judged(slice(first, None)) for first in dict.fromkeys((_landed(touches), 0))]
    verdict = max(verdicts, key=lambda one: _WORST_FIRST.index(one.kind))
    left = int(np.flatnonzero(touches).max(initial=-1)) + 1
    if verdict.kind in ("stable", "cannot_say") and left < len(touches):
        # The force of a tip that left the surface is not the rest of the loop.
        verdict = judged(slice(left))
    if verdict.kind not in ("diverged", "limit_cycle") or verdict.peak_to_peak_n > answers_n:
        return verdict
    words = f"{verdict.reason}, and the hand trembles by {own_n:.2g} N: a hand that rests would decide"
    return verdict._replace(kind="cannot_say", reason=words)


def _landed(in_contact: npt.NDArray[np.bool_]) -> int:
    """Return the sample from which on a bouncing tip stays in contact; 0 if it may leave the surface again.

    A swing that leaves the surface is bounded by it, and is then no sum of exponentials. The bouncing is over if the
    last contact is more than LEAST_TURNS times as long as each contact before.
    """
    edges = np.flatnonzero(np.diff(in_contact, prepend=False, append=False)).reshape(-1, 2)
    lengths = np.diff(edges, axis=1).ravel().tolist()
    is_last = len(lengths) > 1 and edges[-1, 1] == len(in_contact) and lengths[-1] > LEAST_TURNS * max(lengths[:-1])
    return int(edges[-1, 0]) if is_last and lengths[-1] >= LEAST_SAMPLES else 0


def _without_hand(session: _Session, start_s: float, end_s: float) -> Series:
    """Return the tip's force in a span without the part that follows the trembling of the hand [N].

    The hand's force acts on the tip with a delay of 0 to the transit; it is subtracted with the delay and the gain, 0
    to 1.5, that leave the smallest residual. A law does not amplify the hand, except by a swing of its own.
    """
    part = session.at(start_s, end_s)
    tip_n = session.tip_n[part]
    hand = slice(*np.searchsorted(session.hand_s, (start_s, end_s)).tolist())
    if not session.hand_n[hand].size or float(np.ptp(session.hand_n[hand])) <= STEADY_SHARE * session.greatest_n:
        return tip_n
    best, left = tip_n, float(np.ptp(tip_n)) ** 2 * len(tip_n)
    for share in np.linspace(0.0, 1.0, 11).tolist():
        trembling = np.interp(session.tip_s[part] - share * session.known.transit_s, session.hand_s, session.hand_n)
        bare, moved = centred(trembling), centred(tip_n)
        gain = float(np.cumsum(bare * moved)[-1]) / max(float(np.cumsum(bare * bare)[-1]), 1e-300)
        rest = moved - min(max(gain, 0.0), 1.5) * bare
        if (own := float(np.cumsum(rest * rest)[-1])) < left:
            best, left = tip_n - min(max(gain, 0.0), 1.5) * bare, own
    return best


def _late_words(late: Sequence[Late]) -> str:
    words = []
    for who, what in (("machine", "the machine was late by"), ("link", "no answer reached the hand for")):
        own = [one.by_s for one in late if one.who == who]
        words += [f"{what} {1e3 * max(own):.0f} ms" + (f", {len(own)} times" if len(own) > 1 else "")] if own else []
    return " and ".join(words)


def _guarded(session: _Session, away: Episode, verdict: Verdict, first: Episode | None = None) -> Verdict:
    """Return the verdict on a hold that ended by a withdrawal of the instrument: diverged if the motion grew before."""
    words, starved = (
        ("the instrument followed no command from the beginning on", False)
        if away.why == "never"
        else _in_words(_guard_s(session, away), away.why, session.known)
    )
    if verdict.kind == "diverged" or (verdict.kind == "limit_cycle" and starved):
        return verdict._replace(reason=f"{words}; until then {verdict.reason}")
    if away.why == "force_limit" and first is not None:
        halves = [first.start_s, 0.5 * (first.start_s + first.end_s), first.end_s]
        ways = [session.tip_n[session.at(*ends)] for ends in pairwise(halves)]
        before_n, then_n = (float(np.ptp(way)) if len(way) > 1 else 0.0 for way in ways)
        if before_n > session.small_n and then_n > STRUCK_FORCES * before_n:
            reason = f"{words}; until then the motion grew from {before_n:.3g} N to {then_n:.3g} N from peak to peak"
            return verdict._replace(kind="diverged", peak_to_peak_n=then_n, reason=reason)
    return verdict._replace(kind="guarded", reason=words)


def _interrupted(session: _Session, span_s: Span, lacking: Sequence[Lack], share: float, verdict: Verdict) -> Verdict:
    """Return the verdict on a hold in which hand and tip were coupled for too short a time, with the causes first.

    A motion that grew, or went on, while they were coupled keeps its verdict; any other hold is `guarded`.
    """
    start_s, end_s = span_s
    own = [one for one in session.known.interruptions if one.start_s < end_s and one.end_s > start_s]
    causes = [*map(str, lacking)] if lacking else [in_words(own)] if own else []
    first_s, last_s = (lacking[0].start_s, lacking[-1].end_s) if lacking else span_s
    causes += _causes(session.known, first_s, last_s)
    words = "; ".join([*causes, f"hand and tip were coupled for {100.0 * share:.0f} % of the hold"])
    if verdict.kind in ("diverged", "limit_cycle"):
        return verdict._replace(reason=f"{words}; {verdict.reason}")
    return verdict._replace(kind="guarded", reason=words)


def _guard_s(session: _Session, away: Episode) -> float:
    first = int(np.searchsorted(session.tip_s, away.start_s))
    while first > 0 and not session.tip.following[first - 1]:
        first -= 1
    if first > 0:
        return float(session.tip_s[first])
    return next(
        (guard.time_s for guard in reversed(session.known.guards) if guard.time_s <= session.tip_s[0]), away.start_s
    )


def _facts(session: _Session, hold: Hold, episodes: Sequence[Episode], before_s: float, rest_n: Series) -> list[Fact]:
    """Return the facts on a hold; before_s: the end of the hold before [s]; rest_n: the tip's force at rest [N]."""
    start, end, force = hold[:3]
    facts, session_context = [], session.known
    first = next((one for one in episodes if one.kind == "contact"), None)
    if first is not None and episodes[0].kind == "approach" and episodes[0].end_s == first.start_s:
        late_s = first.start_s - start
        facts.append(Fact("arrived_late", late_s, f"arrived late, {late_s:.2g} s after the hand stood still"))
    part = session.at(before_s, end)
    hand = slice(*np.searchsorted(session.hand_s, (before_s, end)).tolist())
    pressed_n = float(session.hand_n[hand].max(initial=max(abs(force), session.small_n)))
    pressing = session.tip_n[part][session.tip.following[part]]
    # The greatest excursion of noise is not part of a blow.
    blow_n = float(pressing.max(initial=0.0)) - reach_of(noise_of(pressing, session.step_n), len(pressing))
    if blow_n > STRUCK_FORCES * pressed_n:
        text = f"struck with {blow_n:.3g} N, {blow_n / pressed_n:.3g} times the force of the hand"
        facts.append(Fact("struck", blow_n, text))
    if len(rest_n):
        facts += _rest_facts(session, hold, before_s, float(np.cumsum(rest_n)[-1]) / len(rest_n))
    for one in session_context.interruptions:
        if one.start_s < end and one.end_s > start and one.kind != "process_ended":
            away_s = one.end_s - one.start_s
            facts.append(Fact("interrupted", away_s, f"interrupted for {1e3 * away_s:.0f} ms: {in_words([one])}"))
    kinds: tuple[FactKind, ...] = ("machine_late", "link_late")
    for kind in kinds:
        if late := [one for one in session.late_in(start, end) if f"{one.who}_late" == kind]:
            facts.append(Fact(kind, max(one.by_s for one in late), _late_words(late)))
    if not session.tip.knows_contact:
        text = f"contact is taken from the force, above {session.small_n:.2g} N"
        facts.append(Fact("contact_by_force", session.small_n, text))
    return facts


def _rest_facts(session: _Session, hold: Hold, before_s: float, mean_n: float) -> list[Fact]:
    """Return facts on a tip that rests at a mean force [N]: off the law's force, off the hand, or not moved by it."""
    facts, force_n = [], hold.hand_force_n
    due_n = session.rest_n(force_n)
    if due_n is not None and abs(mean_n - due_n) > max(ERROR_SHARE * abs(due_n), session.small_n):
        text = f"off its force by {mean_n - due_n:.3g} N: the tip rests at {mean_n:.3g} N, the law at {due_n:.3g} N"
        facts.append(Fact("off_force", mean_n - due_n, text))
    if session.tip.apart_m is not None:
        last = session.at(0.5 * ((hold.rest_from_s or 0.0) + (hold.judged_to_s or 0.0)), hold.judged_to_s or 0.0)
        apart_m = float(session.tip.apart_m[last].mean())
        if abs(apart_m) > PARTED_M:
            facts.append(Fact("parted", apart_m, f"hand and tip parted by {1e3 * apart_m:.3g} mm"))
    then = session.at(before_s, before_s + LONGEST_STEP_S)
    asked_n = force_n - float(np.interp(before_s, session.hand_s, session.hand_n))
    if then.stop > then.start and abs(asked_n) > session.small_n:
        moved_n = mean_n - float(session.tip_n[then].mean())
        if abs(moved_n) < ERROR_SHARE * abs(asked_n):
            text = f"nothing moved: the hand changed by {asked_n:.3g} N and the tip by less than a tenth of that"
            facts.append(Fact("nothing_moved", moved_n, text))
    return facts


def _judge_swing(session: _Session, swing: Swing) -> Hold:
    """Judge a swing like a hold; unless it grew, was guarded or dies out, it is a limit cycle."""
    at_s, why = _withdrawn(session, swing.start_s, swing.end_s)
    part = session.at(swing.start_s, at_s)
    hand = (session.hand_s >= swing.start_s) & (session.hand_s <= swing.end_s)
    force = float(session.hand_n[hand].mean()) if hand.any() else 0.0
    verdict = judge(session.tip_s[part], session.tip_n[part], session.greatest_n, step_n=session.step_n)
    if why:
        verdict = _guarded(session, Episode("away", at_s, swing.end_s, why), verdict)
    words = f"{swing.peak_to_peak_n:.3g} N from peak to peak at {swing.frequency_hz:.3g} Hz"
    if verdict.kind not in ("diverged", "guarded"):
        # A swing of a few turns, which the models do not fit, is judged by its last turn.
        last_s = max(swing.start_s, swing.end_s - 1.0 / swing.frequency_hz)
        left_n = float(np.ptp(session.tip_n[session.at(last_s, at_s)]))
        dies_out = left_n < 0.5 * swing.peak_to_peak_n
        reason = f"a swing of {words} " + (f"dies out: {left_n:.2g} N are left" if dies_out else "continues")
        kind: Kind = "stable" if dies_out else "limit_cycle"
        verdict = verdict._replace(kind=kind, peak_to_peak_n=swing.peak_to_peak_n, reason=reason)
    span_s = swing.start_s, swing.end_s
    share = coupled_share(session.known, session.tip_s, session.tip, span_s)
    if not why and share < COUPLED_SHARE:
        verdict = _interrupted(session, span_s, (), share, verdict)
    return Hold(span_s[0], span_s[1], force, *verdict[:5], (), span_s[0], at_s, None, None, swing.frequency_hz, share)


def absences(tip_time_s: Series, tip: Instrument | None, context: SessionContext) -> list[tuple[float, float]]:
    """Return start and end [s] of each span in which the tip does not follow the hand on purpose."""
    spans = list(context.programs)
    if tip is None or not tip_time_s.size:
        return spans
    follows = np.concatenate([np.ones(1, dtype=bool), tip.following, np.ones(1, dtype=bool)])
    for first, after in np.flatnonzero(np.diff(follows)).reshape(-1, 2).tolist():
        from_s = float(tip_time_s[first])
        near = [guard for guard in context.guards if abs(guard.time_s - from_s) <= REPORTED_WITHIN_S]
        if near and min(near, key=lambda guard: abs(guard.time_s - from_s)).reason in _ASKED:
            spans.append((from_s, float(tip_time_s[min(after, len(tip_time_s) - 1)])))
    return spans


def outside(stretch: Span, spans: Sequence[Span], least_s: float = SHORTEST_HOLD_S) -> list[Span]:
    """Return the parts [s] of a stretch outside of all spans that last for at least `least_s`."""
    parts = [stretch]
    for from_s, to_s in spans:
        cut = [part for start, end in parts for part in ((start, min(end, from_s)), (max(start, to_s), end))]
        parts = [(start, end) for start, end in cut if end > start and end - start >= least_s]
    return parts


def _covered(stretch: tuple[float, ...], spans: Sequence[tuple[float, ...]]) -> bool:
    """Return whether more than half of a stretch is within spans; the first two items of each are start and end [s]."""
    start_s, end_s = stretch[:2]
    return sum(max(0.0, min(end_s, span[1]) - max(start_s, span[0])) for span in spans) > 0.5 * (end_s - start_s)


def _in_words(at_s: float, reason: str, context: SessionContext) -> tuple[str, bool]:
    """Return a sentence on time, reason and limit of the guard's action, and whether commands were missing."""
    limit = context.limits.words(reason) if context.limits is not None else ""
    why = ": ".join(part for part in (reason, limit) if part)
    if reason in _STARVED:
        words = f"the instrument withdrew at {at_s:.3f} s because no command came ({why}): "
        words += "the network or a node was away, which says nothing of the law"
        # If the device itself, or the hand that it follows, was silent, that is the cause.
        silent = [
            str(Lack(topic, start_s, end_s, lost=False))
            for topic, start_s, end_s in context.silences
            if start_s <= at_s <= end_s + REPORTED_WITHIN_S
        ]
        return "; ".join([*silent, words, *_causes(context, at_s, at_s)]), True
    when = f"at {at_s:.3f} s" + (", before the hand's force profile" if at_s < 0.0 else "")
    return f"{GUARD_ACTED} {when}" + (f" ({why})" if why else ""), False


def guard_of(tip_time_s: Series, tip: Instrument, context: SessionContext = NO_CONTEXT) -> str:
    """Return a sentence on time, reason and limit of the first action of the guard, in a hold or not; empty if none.

    A stop on request, or without a known reason, does not count.
    """
    before = np.concatenate([np.ones(1, dtype=bool), tip.following[:-1]])[: len(tip_time_s)]
    for index in np.flatnonzero(~tip.following & before).tolist():
        at_s = float(tip_time_s[index])
        near = [guard for guard in context.guards if abs(guard.time_s - at_s) <= REPORTED_WITHIN_S]
        # If the tip is withdrawn at the start, the last action of the guard before it counts.
        near = near or [guard for guard in context.guards if index == 0 and guard.time_s <= at_s][-1:]
        if near and near[0].reason in _GUARDING:
            return _in_words(near[0].time_s if index == 0 else at_s, near[0].reason, context)[0]
    return ""


def _causes(context: SessionContext, start_s: float, end_s: float) -> list[str]:
    """Return sentences on the incidents that may explain a span without samples or commands, from start to end [s]."""
    return [
        f"at {incident.time_s:.3f} s: {incident.text}"
        for incident in context.incidents
        if start_s - _CAUSED_WITHIN_S <= incident.time_s <= end_s + _NOTICED_WITHIN_S
    ]


def verdict_of(
    holds: list[Hold], guard: str = "", greatest_n: float | None = None, interrupted: str = ""
) -> tuple[Kind, str]:
    """Return the verdict on a session and the reason: those of its worst hold, or of the last if all are stable.

    Args:
        holds: The judged holds.
        guard: The sentence of `guard_of`, with which the reason starts. It makes a session guarded even if no hold is,
            unless it diverged or has no data.
        greatest_n: The hand's greatest force [N]; None if it is not known.
        interrupted: The sentence of `in_words` on the session's interruptions, with which the reason ends.
    """
    kind, reason = _worst_of(holds, greatest_n)
    if guard:
        kind = kind if kind in ("diverged", "guarded", "no_data") else "guarded"
        reason = reason if reason.startswith(guard) else f"{guard}; {reason}"
    return kind, f"{reason}; in the session {interrupted}" if interrupted else reason


def _worst_of(holds: list[Hold], greatest_n: float | None) -> tuple[Kind, str]:
    if not holds and greatest_n == 0.0:
        return (
            "cannot_say",
            "the hand pressed with no force, so there is no hold to judge: one that presses would decide",
        )
    if not holds:
        return "cannot_say", "the hand never stood still for long enough: a hold of 0.5 s or more would decide"
    pressing_n = SMALL_SHARE * (greatest_n or 0.0)
    pressing = [hold for hold in holds if abs(hold.hand_force_n) > pressing_n] or holds
    # Among several holds that are equally bad, the first one decides.
    decisive = min(holds, key=lambda hold: _WORST_FIRST.index(hold.verdict))
    if decisive.verdict in ("cannot_say", "stable"):
        # An undecided hold does not count if another hold gives a verdict on the law.
        decisive = next((hold for hold in reversed(pressing) if hold.verdict == "stable"), pressing[0])
    return decisive.verdict, decisive.reason
