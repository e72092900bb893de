"""Ratio of the stiffness that the hand feels to the true stiffness of the sample, with an interval.

    found = felt_over(hand, tip, hand_per_tip, facts)
    found.ratio, found.low, found.high          # or found.reason: why the ratio cannot be known

The stiffness that the hand feels is k in F_m = k x_m + b v_m + c + d t + e t^2, fitted while the tip touches and the
hand moves to and fro; for a single swing it is Re(F_m / X_m). The same model is fitted to force and base of the tip;
its k times alpha_f alpha_p is the true stiffness at the hand. The interval of k comes from the scatter of parts of the
record, because neighbouring samples are correlated.

A piezo moves the base less than it is commanded, so that a sample appears softer than it is by up to `SOFTER`, unless
the instrument is simulated without that. The stiffness of a simulated spring is stated in the settings; it counts
unless the measurement at the tip contradicts it.

The ratio cannot be known if the tip does not touch for long enough, if the hand does not move enough or moves faster
than `FASTEST_HZ`, so that the masses of law and device count, or if its motion has another cause than its force: a
loop that swings by itself, a drift, or a device whose force is not measured.
"""

import math
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from telenano.analysis.estimates import GREATEST_SHARE
from telenano.analysis.intervals import student
from telenano.numerics.least_squares import regression
from telenano.sections.controller_section import KNOWN_LAWS, LAWS, ControllerConfig
from telenano.settings.config import section_of

if TYPE_CHECKING:
    from telenano.sections.afm_section import AfmConfig

Series = npt.NDArray[np.float64]
# The sample feels too hard above the first of these ratios, and too soft below the second [1].
TOO_HARD, TOO_SOFT = 1.5, 0.6
# length of a window, interval between windows, and averaging time of the samples in it [s]
WINDOW_S = 10.0
LOOK_S = 1.0
MEAN_S = 0.05
# least time in contact in a window [s]
LEAST_S = 4.0
# The sample counts as too hard or too soft once it was so for the first time, until it was not for the second [s].
LASTS_S, GONE_S = 2.0, 10.0
# Faster motion is governed by masses rather than by a spring [Hz].
FASTEST_HZ = 2.5
# Because of hysteresis and creep, a piezo moves less than commanded, by up to the first share (Physik Instrumente,
# Piezo tutorial); because of noise and its lag, a sample may appear stiffer by the second.
SOFTER, STIFFER = 0.37, 0.05
# Samples within this time of one another count as correlated [s].
_ALIKE_S = 0.5
# least number of times that the hand crosses to the other side, beyond half of its standard deviation
_TURNS = 3
# least share of the variance of the hand's motion that its force explains, or the reverse [1]
_TOGETHER = 0.8
_TERMS = 5


class Felt(NamedTuple):
    """Ratio of felt to true stiffness, with its interval of 95 %, and both stiffnesses at the hand [N/m]."""

    ratio: float
    low: float
    high: float
    felt_n_per_m: float
    there_n_per_m: float

    @property
    def kind(self) -> Literal["hard", "soft", "as it is", "open"]:
        """The class of the ratio by its interval; open: TOO_HARD or TOO_SOFT lies within the interval."""
        if self.low > TOO_HARD:
            return "hard"
        if self.high < TOO_SOFT:
            return "soft"
        return "as it is" if self.low >= TOO_SOFT and self.high <= TOO_HARD else "open"

    def __str__(self) -> str:
        """Return the finding in words."""
        both = f"{self.felt_n_per_m:.0f} of {self.there_n_per_m:.0f} N/m at the hand"
        return f"{self.ratio:.2f} ({self.low:.2f} to {self.high:.2f}) times the stiffness that is there, {both}"


class NotKnown(NamedTuple):
    """Reason why the felt stiffness cannot be known."""

    reason: str

    def __str__(self) -> str:
        """Return the reason in words."""
        return f"not known: {self.reason}"


NO_CONTACT = NotKnown("the tip did not touch the sample for long enough")
NO_MOTION = NotKnown("the hand did not move to and fro enough while the tip touched")
TOO_FAST = NotKnown(f"the hand moved faster than {FASTEST_HZ:g} Hz, where masses count and not the sample")
OTHER_CAUSE = NotKnown("the hand moved otherwise than its force says")
TIP_UNCLEAR = NotKnown("the stiffness that is there is not known: the tip moved too little, or its force is too noisy")


class SampleFacts(NamedTuple):
    """Facts on the sample and its instrument, from the settings.

    stated_n_per_m: the stiffness of a simulated spring [N/m], None for any other sample; has_piezo: whether the base
    may move less than commanded; no_force: why the hand does not feel a force of a sample, empty if it does.
    """

    stated_n_per_m: float | None = None
    has_piezo: bool = True
    no_force: str = ""

    @classmethod
    def of(cls, afm: "AfmConfig") -> "SampleFacts":
        """Return the facts in a section `afm_node` (`telenano.sections.AfmConfig`)."""
        if afm.feel is not None:
            return cls(no_force=f"what is felt is a table of {afm.feel.channel}, and no force on the tip")
        if not afm.simulated:
            return cls()
        own = afm.disturbances
        has_piezo = any(part.enabled for part in (own.hysteresis, own.creep, own.stage))
        is_spring = afm.driver == "simulated" and afm.environment == "spring" and afm.sample is None
        return cls(afm.spring.stiffness_n_per_m if is_spring else None, has_piezo)


class _Slope(NamedTuple):
    """The stiffness k of a fit and half its interval [N/m], explained shares of variance, frequency [Hz], and turns."""

    value: float
    half: float
    force_share: float
    way_share: float
    frequency_hz: float
    turns: int


def felt_over(hand: Series, tip: Series, hand_per_tip: float, facts: SampleFacts) -> Felt | NotKnown:
    """Return the felt and the true stiffness in a window in which the tip touches throughout, or why they are unknown.

    Args:
        hand: Time [s], position x_m [m] and force F_m [N] of the hand, shape (3, n).
        tip: Time [s], position x_s of the base [m] and force F_s [N], shape (3, m).
        hand_per_tip: alpha_f alpha_p: ratio of a stiffness at the hand to that at the tip.
        facts: The facts on the sample from the settings.
    """
    if any(rows.shape[1] < 2 or rows[0, -1] - rows[0, 0] < LEAST_S for rows in (hand, tip)):
        return NO_CONTACT
    felt, met = _slope(*hand), _slope(*tip)
    if felt is None or felt.turns < _TURNS:
        return NO_MOTION
    if felt.frequency_hz > FASTEST_HZ:
        return TOO_FAST
    there = _there(met, hand_per_tip, facts)
    if there is None:
        return TIP_UNCLEAR
    if max(felt.force_share, felt.way_share) < _TOGETHER:
        return OTHER_CAUSE
    if felt.half > GREATEST_SHARE * max(abs(felt.value), there[0]):
        return NO_MOTION
    low, high = felt.value - felt.half, felt.value + felt.half
    # Motion of the hand from other causes than its force reduces the fitted slope.
    high = high / max(felt.force_share, _TOGETHER) if high > 0.0 else high
    ends = [end / value for end in (low, high) for value in there[1:]]
    return Felt(felt.value / there[0], min(ends), max(ends), felt.value, there[0])


def _there(met: _Slope | None, hand_per_tip: float, facts: SampleFacts) -> tuple[float, float, float] | None:
    """Return the true stiffness at the hand, and its interval [N/m]; None if it is not known."""
    found = None
    if met is not None and met.value > 0.0 and met.half < GREATEST_SHARE * met.value:
        softer = SOFTER if facts.has_piezo else STIFFER
        ends = (1.0 - STIFFER) * (met.value - met.half), (met.value + met.half) / (1.0 - softer)
        found = hand_per_tip * met.value, hand_per_tip * ends[0], hand_per_tip * ends[1]
    if facts.stated_n_per_m is None:
        return found
    stated = hand_per_tip * facts.stated_n_per_m
    return found if found is not None and not found[1] <= stated <= found[2] else (stated, stated, stated)


def _slope(time_s: Series, way_m: Series, force_n: Series) -> _Slope | None:
    """Fit a spring and a damper beside a drift; None if nothing moves, or there are too few samples."""
    if time_s.size < 8:
        return None
    # The filter attenuates a tremor of the hand, around 9 Hz, in position and force alike, so that their ratio stays.
    frequency_hz = _frequency_hz(time_s, way_m)
    time_s, way_m, force_n = (
        0.25 * values[:-2] + 0.5 * values[1:-1] + 0.25 * values[2:] for values in (time_s, way_m, force_n)
    )
    since = (time_s - time_s.mean()) / max(float(np.ptp(time_s)), 1e-9)
    drift = (np.ones_like(since), since, since * since)
    away, pressed = _beside(drift, way_m), _beside(drift, force_n)
    deviation = float(away.std())
    parts = np.unique(np.floor((time_s - time_s[0]) / _ALIKE_S), return_inverse=True)[1]
    freedom = int(parts[-1]) + 1 - _TERMS
    # A deviation of less than 1e-9 of the position is a rounding error.
    if freedom < 2 or not deviation > 1e-9 * float(np.abs(way_m).max(initial=0.0)):
        return None
    speed = _beside(drift, np.gradient(way_m, time_s))
    columns = (away / deviation, speed)
    found, left = regression(columns, pressed)
    # The slope comes from the residual of the position on the speed; its error is from the sums of products by part.
    _, own = regression(columns[1:], columns[0])
    scores = np.bincount(parts, own * left) / float((own * own).sum())
    half = student(freedom) * math.sqrt(float((scores * scores).sum()) * (freedom + _TERMS) / freedom)
    rate = _beside(drift, np.gradient(force_n, time_s))
    way_share = _share((pressed, rate), away)
    turns = _turns(away, 0.5 * deviation)
    return _Slope(found[0] / deviation, half / deviation, _share(columns, pressed), way_share, frequency_hz, turns)


def _frequency_hz(time_s: Series, way_m: Series) -> float:
    """Return the frequency [Hz] of a sine with the same ratio of speed to amplitude (rms) as a motion."""
    away = _beside((np.ones_like(time_s), time_s - time_s.mean()), way_m)
    speed = np.diff(away) / np.maximum(np.diff(time_s), 1e-9)
    size = float(away.std())
    return float(np.sqrt(np.mean(speed * speed))) / size / (2.0 * math.pi) if size > 0.0 else 0.0


def _beside(drift: Sequence[Series], values: Series) -> Series:
    """Return values without the drift that fits them best."""
    return regression(drift, values)[1]


def _share(columns: Sequence[Series], values: Series) -> float:
    """Return the share of the variance of values that columns explain; 0 if the values are all 0."""
    whole = float((values * values).sum())
    left = regression(columns, values)[1]
    return 1.0 - float((left * left).sum()) / whole if whole > 0.0 else 0.0


def _turns(away: Series, least: float) -> int:
    """Return how often a motion went from beyond `least` on one side to beyond it on the other."""
    sides = np.sign(away[np.abs(away) > least])
    return int(np.count_nonzero(np.diff(sides)))


class FeltWindow:
    """The newest `WINDOW_S` of hand and tip in a running session, as means over `MEAN_S`."""

    def __init__(self, facts: SampleFacts) -> None:
        self.facts = facts
        self._hand, self._tip = _Means(), _Means()

    def hand(self, time_s: float, way_m: float, force_n: float) -> None:
        """Add a sample of the hand: time by its own clock [s], position [m] and force [N]."""
        self._hand.add(time_s, way_m, force_n)

    def tip(self, time_s: float, way_m: float, force_n: float, *, touches: bool) -> None:
        """Add a sample of the tip, time by its own clock [s]; a tip that does not touch empties the window."""
        if touches:
            self._tip.add(time_s, way_m, force_n)
        else:
            self.forget()

    def forget(self) -> None:
        """Empty the window, because the next samples belong to another contact or another law."""
        self._hand.clear()
        self._tip.clear()

    def look(self, hand_per_tip: float) -> Felt | NotKnown:
        """Return the felt and the true stiffness at present, or why they are unknown."""
        if self.facts.no_force:
            return NotKnown(self.facts.no_force)
        return felt_over(self._hand.rows(), self._tip.rows(), hand_per_tip, self.facts)


class _Means:
    """Means of samples over `MEAN_S`, of the newest `WINDOW_S`."""

    def __init__(self) -> None:
        # Each row has sums of time [s], position [m] and force [N], and the number of samples in them.
        self._sums: deque[list[float]] = deque()
        self._place = -1

    def add(self, time_s: float, way_m: float, force_n: float) -> None:
        place = math.floor(time_s / MEAN_S)
        if place < self._place:
            # The device was restarted with a new clock.
            self.clear()
        if place != self._place:
            self._sums.append([0.0, 0.0, 0.0, 0.0])
            self._place = place
        newest = self._sums[-1]
        for column, value in enumerate((time_s, way_m, force_n, 1.0)):
            newest[column] += value
        while time_s - self._sums[0][0] / self._sums[0][3] > WINDOW_S:
            self._sums.popleft()

    def clear(self) -> None:
        self._sums.clear()
        self._place = -1

    def rows(self) -> Series:
        if not self._sums:
            return np.empty((3, 0))
        sums = np.array(self._sums).T
        return np.asarray(sums[:3] / sums[3], dtype=np.float64)


class Course(NamedTuple):
    """A whole session: hand and tip as in `felt_over`, and whether the tip touches in each sample, shape (m,)."""

    hand: Series
    tip: Series
    touches: npt.NDArray[np.bool_]


class Span(NamedTuple):
    """A span in which a law was in force [s], with alpha_f alpha_p; None if that is unknown, and then the reason."""

    from_s: float
    to_s: float
    hand_per_tip: float | None
    reason: str = ""


class Outside(NamedTuple):
    """A span in which the hand felt more than `TOO_HARD`, or less than `TOO_SOFT`, times the true stiffness."""

    from_s: float
    to_s: float
    felt: Felt

    def __str__(self) -> str:
        """Return the finding in words."""
        felt, than = self.felt, "harder" if self.felt.kind == "hard" else "softer"
        return f"from {self.from_s:.0f} to {self.to_s:.0f} s the hand felt {felt}; the sample felt {than} than it is"


class FeltSession(NamedTuple):
    """The felt stiffness in a session, the median of its windows, None if it is not known; and the same in words."""

    felt: Felt | None
    reason: str
    outside: tuple[Outside, ...] = ()


def felt_in(course: Course, spans: Sequence[Span], facts: SampleFacts) -> FeltSession:
    """Return the felt stiffness in a session, from windows of `WINDOW_S` every `LOOK_S`."""
    if facts.no_force:
        return FeltSession(None, facts.no_force)
    hand, tip = _means_of(course.hand), _means_of(course.tip, course.touches)
    found: list[tuple[float, Felt]] = []
    reasons: list[str] = []
    for span in spans:
        if span.hand_per_tip is None:
            reasons.append(span.reason)
            continue
        for begin_s, end_s in _windows(tip, span):
            felt = felt_over(_within(hand, begin_s, end_s), _within(tip, begin_s, end_s), span.hand_per_tip, facts)
            if isinstance(felt, Felt):
                found.append((end_s, felt))
            else:
                reasons.append(felt.reason)
    if not found:
        reasons = reasons or [NO_CONTACT.reason]
        return FeltSession(None, max(dict.fromkeys(reasons), key=reasons.count))
    outside = tuple(_outside(found))
    # A session with spans outside the limits gets the median of those spans alone.
    of = [felt for at_s, felt in found if any(one.from_s <= at_s <= one.to_s for one in outside)] if outside else []
    ordered = sorted(of or [felt for _, felt in found])
    felt = ordered[len(ordered) // 2]
    return FeltSession(felt, f"the hand felt {felt}", outside)


def _means_of(rows: Series, kept: npt.NDArray[np.bool_] | None = None) -> Series:
    """Return means over `MEAN_S`, shape (3, n), without those in which a sample is not kept."""
    if not rows.shape[1]:
        return np.empty((3, 0))
    places = np.floor(rows[0] / MEAN_S).astype(np.int64)
    _, parts, counts = np.unique(places, return_inverse=True, return_counts=True)
    means = np.stack([np.bincount(parts, row) / counts for row in rows])
    if kept is not None:
        means = means[:, np.bincount(parts, ~kept) == 0]
    return np.asarray(means, dtype=np.float64)


def _within(rows: Series, begin_s: float, end_s: float) -> Series:
    first, last = np.searchsorted(rows[0], (begin_s, end_s))
    return rows[:, first:last]


def _windows(tip: Series, span: Span) -> Iterator[tuple[float, float]]:
    """Yield start and end of the windows of each contact within a span [s]."""
    times = _within(tip, span.from_s, span.to_s)[0]
    breaks = np.flatnonzero(np.diff(times) > 2.5 * MEAN_S)
    for first, last in zip([0, *(breaks + 1)], [*breaks, times.size - 1], strict=True):
        if times.size == 0 or times[last] - times[first] < LEAST_S:
            continue
        begin_s, contact_ends_s = float(times[first]), float(times[last]) + 0.5 * MEAN_S
        end_s = begin_s + LEAST_S
        while True:
            end_s = min(end_s, contact_ends_s)
            yield max(begin_s, end_s - WINDOW_S), end_s
            if end_s >= contact_ends_s:
                break
            end_s += LOOK_S


def _outside(found: list[tuple[float, Felt]]) -> Iterator[Outside]:
    """Yield the spans in which all windows were too hard, or all too soft, for `LASTS_S`, by the ends of windows."""
    run: list[tuple[float, Felt]] = []
    for at_s, felt in [*found, (math.inf, Felt(1.0, 1.0, 1.0, 0.0, 0.0))]:
        if run and (felt.kind != run[-1][1].kind or at_s - run[-1][0] > 2.0 * LOOK_S):
            if run[-1][0] - run[0][0] >= LASTS_S:
                ordered = sorted(one for _, one in run)
                yield Outside(run[0][0], run[-1][0], ordered[len(ordered) // 2])
            run = []
        if felt.kind in ("hard", "soft"):
            run.append((at_s, felt))


def scale_of(controller: ControllerConfig, law: str) -> tuple[float | None, str]:
    """Return alpha_f alpha_p of a law from the section `controller`, or None and the reason why it has none."""
    if law not in KNOWN_LAWS:
        return None, f"the law {law} is not installed, so that its scales are not known"
    if law not in LAWS:
        return None, f"with the law {law} the hand does not move the tip, and feels no stiffness"
    section = section_of(controller, law)
    return section.force_scale * section.position_scale, ""


def changes_scale(texts: Iterable[str]) -> bool:
    """Return whether controllers acknowledged a change of a scale, after which the scale is not known."""
    return any("controller" in text and "_scale" in text for text in texts)


SCALE_CHANGED = NotKnown("position_scale or force_scale was changed while the session ran")
