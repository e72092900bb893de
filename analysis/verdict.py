"""What became of a hold: judged by what the tip's force does while the hand's force stands still.

One function decides, for recordings, maps and the check of the bus against lockstep. In this order:

- no_data: the hold has no samples of the hand or of the tip, or no answer reached the hand (`analysis.holds`);
- guarded, diverged: the instrument's guard ended the hold, diverged if the force was large or growing then, guarded
  whatever it did if the guard acted because commands were missing: that is the network's fault and not the law's;
- cannot_say: the hold is too short for its slowest motion, or noise hides whether it grows;
- contact_lost: the hand presses, and the tip is off the surface and moves by less than a twentieth of the hand's force,
  but for a jump into contact at the very end: what grows there is no motion of the loop;
- diverged: a mode of the motion grows (`analysis.modes`), or the motion begins in the last eighth of the hold;
- drifting: the force goes on in one direction without coming to rest;
- limit_cycle: the motion neither grows nor dies out and is larger than a twentieth of the hand's force;
- released: neither hand nor tip presses with a twentieth of the hand's force: there is no hold to judge;
- contact_lost: the tip does not touch although the hand presses;
- wrong_force: the tip's force differs from the hand's by more than a tenth;
- settling: the tip came to rest with the right force, from one side, but too late for a later half at rest;
- struck: the tip came to rest as it should after it was pressed with more than twice the hand's force;
- cannot_say as well: the tip met the surface in the hold, and was on its way to the hand's force when it ended;
- stable: none of these.

A mode that is said to go on has to be seen: a swing of f Hz turns 2 f times a second by nearly all of its size. Where
the force turns less than f times a second by a third of it, and hardly moves in the last quarter of the hold, the fit
has taken a jump or an approach for a swing. A mode that is said to grow has to be seen at its end: where the force
moves in the last sixteenth of the hold by less than the mode would do there at the very least, the fit has made a
dip of a few millinewtons, such as a late message leaves, of large modes that cancel.

A growth rate counts where it exceeds three of its standard errors and changes the motion by more than a tenth over the
later part of the hold, and where the mode is more than a tenth of the motion that is left: friction makes that no sum
of exponentials, and leaves a fit with modes a hundredth as large. One of less than a quarter of a cycle is the bend of
a drift, and has to be larger than a twentieth of the hand's force. What would be no larger after another hold of that
length is small and stays so: what a settled motion leaves has such rates. Over a link with jitter or loss a motion that
the link's randomness keeps up is a limit cycle too, and a trend has to be a factor of two, because it may be chance.
There a fit that finds a growing mode has to explain the motion in the later half of the hold as well. A motion that
grows is largest there, so that this takes nothing from it. Where the tip lands in the hold, the landing is all of the
motion that a fit of the whole has to explain, and the few millinewtons that lost messages leave afterwards are its
remainder. White noise of the read-out is estimated from the data and is no motion.
"""

import math
from collections.abc import Sequence
from itertools import combinations, pairwise
from typing import Literal, NamedTuple, get_args

import numpy as np
import numpy.typing as npt

from analysis.modes import LEAST_SAMPLES, Mode, modes_of, noise_floor
from analysis.swings import turning_points

Series = npt.NDArray[np.float64]
Kind = Literal[
    "stable",
    "limit_cycle",
    "diverged",
    "drifting",
    "released",
    "wrong_force",
    "contact_lost",
    "guarded",
    "cannot_say",
    "settling",
    "no_data",
    "struck",
]
KINDS: tuple[Kind, ...] = get_args(Kind)

WINDOWS = 8
# the windows that a trend is taken from: the first show the answer to the step before them
_LATE_WINDOWS = 6
# These are shares of the hand's force.
SMALL_SHARE = 0.05
FORCE_ERROR_SHARE = 0.1
# A step onto an undamped spring overshoots to twice its force; what strikes harder has been given energy by the loop.
STRUCK_FORCES = 2.0
# a read-out noisier than this, as a standard deviation, is taken for motion
MOST_NOISE_SHARE = 0.08
# below this share of the hand's force nothing is left to fit
_FLOOR_SHARE = 1e-7
# a motion that changes by less than a tenth neither grows nor dies out; where chance has a hand in it, by less than a
# factor of two; over this share of the hold
_SUSTAINED_CHANGE, _NOISY_CHANGE, _SPAN = 0.1, 0.7, 0.7
_SURE_ERRORS = 3.0
# 14 of the 15 pairs of six windows in the same order: by chance that happens once in 60 times, either way
_CLEAR_TREND = 0.85
# the last window against the greatest before it
_LATE_ONSET = 4.0
# cycles in a hold below which a motion is a drift and no swing; and below which noise makes its growth uncertain
_DRIFT_CYCLES = 0.25
# A growing mode below this share of the motion at the end of the hold is a residue of the rest.
_RESIDUE_SHARE = 0.1
# cycles that a hold has to have for a swing to be looked for in its turning points, and those that a fit of the band
# about zero may have; the share of a swing by which the force has to turn, and that which is left in its last quarter
_SEEN_CYCLES, _SLOW_CYCLES, _SEEN_SHARE, _SEEN_AT_END = 1.5, 8.0, 1.0 / 3.0, 0.25
# A growing mode is looked for in this last share of the hold, at so many phases and times of it; the force has to move
# there by this share of the least that the mode moves.
_END_SHARE, _END_PHASES, _END_TIMES, _END_SEEN = 1.0 / 16.0, 12, 48, 0.9
# The longest way of an approach is at least so many times the height that counts as a turn.
_APPROACH_HEIGHTS = 4.0
# Where there is noise, turning points are looked for in so many means of neighbouring samples.
_TURN_SAMPLES = 256
# A tip that touches for less than this share of the later half was in the air.
_AIR_SHARE = 0.25
# What a landing in the hold may be taken for. A force is on its way to its rest if it moves in the last eighth of the
# hold by this share of what it lacks there: one of a time constant of half a hold does.
_OF_LANDINGS = ("drifting", "limit_cycle", "wrong_force", "contact_lost")
_UNDER_WAY_SHARE = 0.25
# A motion that has come to rest by this last share of the hold has settled.
_SETTLED_SHARE = 0.25
# What a hand sets in motion and what grows is above this share of the hand's force, and rounding errors are not.
_NOTHING_SHARE = 1e-6


class Verdict(NamedTuple):
    """What became of a hold.

    growth_per_s: of the mode that decides [1/s], None where nothing moves; peak_to_peak_n: of the motion at its end,
    without noise [N]; noise_n: standard deviation of the read-out's noise [N]; reason: the verdict in words.
    """

    kind: Kind
    growth_per_s: float | None
    peak_to_peak_n: float
    noise_n: float
    reason: str


class Circumstances(NamedTuple):
    """What else is known of a hold.

    guarded: the instrument's guard ended it; noisy: the link is random; touching: share of the later half in which the
    tip was in contact, None where contact is not asked for; expected_n: what the tip should press with [N], if known;
    touching_at_end: the same share of the last quarter; guard: what the guard did and why, in words; starved: it acted
    because commands were missing; landed_s: for how long before the hold's end the tip touches, if it met the surface
    in the hold and has stayed there [s].
    """

    guarded: bool = False
    noisy: bool = False
    touching: float | None = None
    expected_n: float | None = None
    touching_at_end: float | None = None
    guard: str = ""
    starved: bool = False
    landed_s: float | None = None


NOTHING_ELSE = Circumstances()
GUARD_ACTED = "the instrument's guard acted"


class _Motion(NamedTuple):
    """The sizes of the motion in the windows [N], its modes, the trend of the sizes, and the read-out's noise [N]."""

    length_s: float
    sizes_n: Series
    modes: list[Mode]
    growth_per_s: float | None
    change: float
    trend: float
    noise_n: float


def judge(time_s: Series, force_n: Series, hand_force_n: float, known: Circumstances = NOTHING_ELSE) -> Verdict:
    """Judge one hold.

    Parameters: time_s, force_n: the hold, from its start (or the end of the transient that is to be left out) to where
    it ended, alpha_f F_s [N], shape (n,); hand_force_n: what is large beside it [N], > 0: the hand's greatest force.
    Raises: ValueError if the hand's force is not positive.
    """
    if not hand_force_n > 0.0:
        raise ValueError(f"the hand's force in a hold is {hand_force_n} N, it must be > 0 N")
    finite = np.isfinite(force_n)
    if not finite.all():
        size = float(np.ptp(force_n[finite])) if finite.any() else 0.0
        return Verdict("diverged", None, size, 0.0, "the force is no number from some time on")
    if len(time_s) < LEAST_SAMPLES:
        size = float(np.ptp(force_n)) if len(force_n) else 0.0
        left = f"the hold has {len(time_s)} samples"
        if known.guarded:
            return Verdict("guarded", None, size, 0.0, f"{known.guard or GUARD_ACTED}; until then {left}")
        return Verdict("cannot_say", None, size, 0.0, f"{left}: {LEAST_SAMPLES} are needed to judge it")
    values, period_s = _even(time_s, force_n)
    noise = noise_floor(values)
    noise = noise if noise <= MOST_NOISE_SHARE * hand_force_n else 0.0
    motion = _motion(values, period_s, noise, _FLOOR_SHARE * hand_force_n)
    small = SMALL_SHARE * hand_force_n
    size = float(
        max(motion.sizes_n[-1], max((2.0 * m.end_n for m in motion.modes if m.frequency_hz > 0.0), default=0.0))
    )
    kind, growth, reason = _decided(values, motion, hand_force_n, small, known)
    if known.landed_s is not None and kind in _OF_LANDINGS and (known.touching or 0.0) > _AIR_SHARE:
        kind, reason = _landing(values, motion, small, known, known.landed_s) or (kind, reason)
    return Verdict(kind, growth, min(size, float(np.ptp(values))), noise, reason)


def struck(found: Verdict, peak_n: float, hand_force_n: float) -> Verdict:
    """Return a verdict, which is `struck` where it was stable although the tip was pressed with peak_n [N] before."""
    if found.kind != "stable" or peak_n <= STRUCK_FORCES * hand_force_n:
        return found
    blow = f"before, the tip was pressed with {peak_n:.3g} N, {peak_n / hand_force_n:.3g} times the force of the hand"
    return found._replace(kind="struck", reason=f"{found.reason}; {blow}")


def _decided(
    values: Series, motion: _Motion, hand_force_n: float, small_n: float, known: Circumstances
) -> tuple[Kind, float | None, str]:
    least = _NOISY_CHANGE if known.noisy else _SUSTAINED_CHANGE
    span_s = _SPAN * motion.length_s
    large = [mode for mode in motion.modes if _reach(mode) > small_n]
    residue_n = max(_RESIDUE_SHARE * float(motion.sizes_n[-1]), _NOTHING_SHARE * hand_force_n)
    growing = [
        mode
        for mode in motion.modes
        if _sure(mode, 1.0, span_s, least)
        and ((mode.explained and mode.explained_late) or not known.noisy)
        and 2.0 * mode.end_n > residue_n
        and (mode.frequency_hz * motion.length_s >= _DRIFT_CYCLES or _reach(mode) > small_n)
        and _reach(mode) > small_n * math.exp(-mode.growth_per_s * motion.length_s)
    ]
    leading = max(large or motion.modes, key=lambda mode: mode.growth_per_s, default=None)
    rate = leading.growth_per_s if leading is not None and leading.explained else motion.growth_per_s
    if growing:
        fastest = max(growing, key=lambda mode: mode.end_n)
        rate = fastest.growth_per_s
    late = float(motion.sizes_n[-1])
    begins = late > small_n and late > _LATE_ONSET * float(motion.sizes_n[-_LATE_WINDOWS:-1].max())
    trend_up = motion.change > least and motion.trend >= _CLEAR_TREND and late > small_n
    if known.guarded:
        guard = known.guard or GUARD_ACTED
        if not known.starved and (growing or begins or trend_up or float(np.ptp(values)) > 0.5 * hand_force_n):
            return "diverged", rate, f"{guard}; until then the motion grew"
        return "guarded", rate, guard
    before = float(motion.sizes_n[WINDOWS // 2 : -1].max())
    presses = known.expected_n is None or abs(known.expected_n) >= small_n
    if known.touching is not None and known.touching <= _AIR_SHARE and before <= small_n and presses:
        # in the air there is no loop that could swing, and what begins at the end is the jump into contact
        return _steady(values, hand_force_n, motion, rate, known)
    if growing:
        mode = max(growing, key=lambda mode: mode.end_n)
        return "diverged", rate, f"a motion of {_words(mode)} grows by {mode.growth_per_s:.3g}/s"
    if begins:
        return "diverged", rate, f"a motion of {late:.3g} N begins in the last eighth of the hold"
    if trend_up and not large:
        return "diverged", motion.growth_per_s, f"the motion grows by {motion.growth_per_s:.3g}/s"
    unseen = [mode for mode in large if not _is_seen(values, mode, motion)]
    lasting = [mode for mode in large if mode not in unseen and not _sure(mode, -1.0, span_s, least)]
    moving = float(motion.sizes_n[WINDOWS // 2 :].max()) > small_n
    falls = motion.change < -least and motion.trend <= -_CLEAR_TREND
    dies_out = not lasting and (
        falls
        or bool(large and all(mode.explained and mode not in unseen for mode in large))
        or (moving and late <= small_n and _dwindles(values, 0.5 * small_n, motion.noise_n))
    )
    if (moving or lasting) and not dies_out:
        return _lasting(motion, lasting, small_n, rate, known)
    return _settled(values, hand_force_n, motion, rate, known)


def _lasting(
    motion: _Motion, lasting: list[Mode], small_n: float, rate: float | None, known: Circumstances
) -> tuple[Kind, float | None, str]:
    """Name a motion that neither grows for sure nor dies out."""
    slowest = min(lasting, key=lambda mode: mode.frequency_hz, default=None)
    if slowest is not None and slowest.frequency_hz * motion.length_s < 2.0:
        unsure = _SURE_ERRORS * slowest.error_per_s * _SPAN * motion.length_s
        if slowest.frequency_hz * motion.length_s < _DRIFT_CYCLES:
            return "drifting", rate, f"the force drifts: {slowest.end_n:.3g} N in the hold"
        if unsure > _NOISY_CHANGE and not known.noisy:
            words = f"the hold of {motion.length_s:.3g} s is too short for a swing at {slowest.frequency_hz:.3g} Hz"
            return "cannot_say", rate, words
    size = float(motion.sizes_n[WINDOWS // 2 :].max())
    kept = max(lasting, key=lambda mode: mode.end_n, default=None)
    if kept is not None and 2.0 * kept.end_n > small_n and kept.frequency_hz > 0.0:
        words = f"a motion of {_words(kept)} neither grows nor dies out"
    else:
        words = f"a motion of {size:.3g} N from peak to peak goes on irregularly"
    if known.touching is not None and known.touching < 1.0:
        words += ", and takes the tip off the surface"
    return "limit_cycle", rate, words


def _settled(
    values: Series, hand_force_n: float, motion: _Motion, rate: float | None, known: Circumstances
) -> tuple[Kind, float | None, str]:
    """Ask of a hold whose motion dies out whether it stands still as it should: in its later half, or at its end."""
    found = _steady(values, hand_force_n, motion, rate, known)
    if found[0] not in ("contact_lost", "wrong_force"):
        return found
    at_end = known._replace(touching=known.touching_at_end if known.touching is not None else None)
    last = values[-max(1, round(_SETTLED_SHARE * len(values))) :]
    small = SMALL_SHARE * hand_force_n
    if _steady(last, hand_force_n, motion, rate, at_end, all_of_it=True)[0] != "stable":
        return found
    off_n = abs(float(values[-max(1, len(values) // WINDOWS) :].mean()) - known.expected_n) if known.expected_n else 0.0
    if off_n > SMALL_SHARE * abs(known.expected_n or 0.0):
        return found
    if float(motion.sizes_n[-1]) > small or not _dwindles(values, 0.5 * small, motion.noise_n):
        return found
    words = f"the tip came to rest with the hand's force late in the hold, from one side; before, {found[2]}"
    return "settling", rate, words


def _landing(
    values: Series, motion: _Motion, small_n: float, known: Circumstances, landed_s: float
) -> tuple[Kind, str] | None:
    """Say what became of a tip that met the surface in the hold; None where it goes not straight to its right rest.

    A fit of the whole hold takes the way through the air, the jump into contact and the approach to the hand's force
    for one swing, or for a drift. What follows the jump, or the first way after it, has to dwindle.
    """
    since = values[-max(1, round(landed_s / motion.length_s * len(values))) :]
    travels = _travels(since, 0.5 * small_n, motion.noise_n)
    if not travels or max(travels[:2]) < max(travels) or not _dwindles(since, 0.5 * small_n, motion.noise_n):
        return None
    at_end_n, moved_n = float(values[-max(1, len(values) // WINDOWS) :].mean()), float(motion.sizes_n[-1])
    lacks_n = abs(at_end_n - known.expected_n) if known.expected_n is not None else 0.0
    words = f"the tip met the surface {landed_s:.3g} s before the end of the hold, and"
    if moved_n <= small_n and lacks_n <= SMALL_SHARE * abs(known.expected_n or 0.0):
        return "settling", f"{words} came to rest with the hand's force"
    if moved_n < _UNDER_WAY_SHARE * lacks_n:
        return None
    return "cannot_say", f"{words} was on its way to its rest then"


def _is_seen(values: Series, mode: Mode, motion: _Motion) -> bool:
    """Return whether the force turns as often as a swing would, or moves at the end as far as it would.

    Of a swing of n >= 1.5 cycles at least 2 n - 1 turns by a third of its size are seen wherever it begins, and in its
    last quarter a motion of 0.3 of its size. What is too slow or too fast to tell is taken to be there.
    """
    cycles = mode.frequency_hz * motion.length_s
    size_n = 2.0 * mode.end_n
    if not _SEEN_CYCLES <= cycles <= _SLOW_CYCLES:
        return True
    travels = _travels(values, _SEEN_SHARE * size_n, motion.noise_n)
    if travels is None or len(travels) - 1 >= cycles:
        return True
    last = values[-max(1, round(_SETTLED_SHARE * len(values))) :]
    return _size(last, motion.noise_n) >= _SEEN_AT_END * size_n


def _is_spurious(values: Series, mode: Mode, length_s: float) -> bool:
    """Return whether a mode is said to grow for sure, and the force moves less at the end than it does in any phase."""
    grows = mode.explained and mode.growth_per_s > _SURE_ERRORS * mode.error_per_s
    if not grows or mode.frequency_hz <= 0.0:
        return False
    last = values[-max(2, round(_END_SHARE * len(values))) :]
    least = math.inf
    for n in range(_END_PHASES):
        course = []
        for k in range(_END_TIMES + 1):
            back_s = _END_SHARE * length_s * k / _END_TIMES
            phase = math.pi * (n / _END_PHASES + 2.0 * mode.frequency_hz * back_s)
            course.append(math.exp(-mode.growth_per_s * back_s) * math.cos(phase))
        least = min(least, max(course) - min(course))
    return float(np.ptp(last)) < _END_SEEN * least * mode.end_n


def _dwindles(values: Series, height_n: float, noise_n: float) -> bool:
    """Return whether each way of the force from turn to turn is less than half the one before, from the longest on.

    So an approach from one side does, with or without an overshoot; ways of less than height_n [N] do not count, and
    one that is no longer than a few of them is a ripple and no approach.
    """
    travels = _travels(values, height_n, noise_n)
    if not travels or max(travels) < _APPROACH_HEIGHTS * height_n:
        return False
    rest = travels[travels.index(max(travels)) :]
    return all(after <= 0.5 * before for before, after in pairwise(rest))


def _travels(values: Series, height_n: float, noise_n: float) -> list[float] | None:
    """Return how far a force goes from each turn by at least a height to the next [N]; None where noise reaches it."""
    block = max(1, len(values) // _TURN_SAMPLES) if noise_n > 0.0 else 1
    if block > 1:
        values = np.diff(np.cumsum(values)[block - 1 :: block], prepend=0.0) / block
    if _reached_by_noise(noise_n / math.sqrt(block), len(values)) > height_n:
        return None
    force_n = values.tolist()
    places = turning_points(force_n, range(len(force_n)), height_n)
    turns = [force_n[place] for place in places]
    # The force goes as far as it gets from its last turn on.
    turns += [max(force_n[place:], key=lambda value: abs(value - force_n[place])) for place in places[-1:]]
    return [abs(after - before) for before, after in pairwise(turns)]


def _steady(
    values: Series,
    hand_force_n: float,
    motion: _Motion,
    rate: float | None,
    known: Circumstances,
    *,
    all_of_it: bool = False,
) -> tuple[Kind, float | None, str]:
    """Ask of a hold that stands still whether it is the right one: of its later half, or of all that is given."""
    later = values if all_of_it else values[len(values) // 2 :]
    mean = float(np.cumsum(later)[-1]) / len(later)
    small = SMALL_SHARE * hand_force_n
    if known.expected_n is not None and max(abs(known.expected_n), abs(mean)) < small:
        words = f"the hand presses with {known.expected_n:.2g} N and the tip with {mean:.2g} N: this is no hold"
        return "released", rate, words
    if known.touching is not None and known.touching < 1.0:
        share = 100.0 * (1.0 - known.touching)
        return "contact_lost", rate, f"the tip is off the surface for {share:.3g} % of the later half of the hold"
    if known.expected_n is not None and abs(mean - known.expected_n) > FORCE_ERROR_SHARE * max(
        abs(known.expected_n), SMALL_SHARE * hand_force_n
    ):
        return "wrong_force", rate, f"the tip presses with {mean:.3g} N, the hand with {known.expected_n:.3g} N"
    size = float(motion.sizes_n[-1])
    if rate is not None and rate * motion.length_s < -_SUSTAINED_CHANGE and size > 0.0:
        return "stable", rate, f"the motion dies out by {-rate:.3g}/s, {size:.2g} N are left"
    return "stable", rate, f"what moves, {size:.2g} N, is less than {100.0 * SMALL_SHARE:g} % of the hand's force"


def _sure(mode: Mode, sign: float, span_s: float, least: float) -> bool:
    """Return whether a mode grows (sign 1) or dies out (-1) beyond its error, by more than the least change."""
    rate = sign * mode.growth_per_s
    return rate > _SURE_ERRORS * mode.error_per_s and rate * span_s > least


def _reach(mode: Mode) -> float:
    """Return what a mode still moves at the end [N]: from peak to peak, or, without frequency, its way."""
    return 2.0 * mode.end_n if mode.frequency_hz > 0.0 else mode.end_n


def _words(mode: Mode) -> str:
    return f"{2.0 * mode.end_n:.3g} N from peak to peak at {mode.frequency_hz:.3g} Hz"


def _even(time_s: Series, force_n: Series) -> tuple[Series, float]:
    """Return the force on an even grid of as many samples, and its period [s]; messages come when they come."""
    grid = np.linspace(time_s[0], time_s[-1], len(time_s))
    period_s = float(time_s[-1] - time_s[0]) / (len(time_s) - 1)
    if float(np.abs(time_s - grid).max()) <= 1e-6 * period_s:
        return np.asarray(force_n, dtype=np.float64), period_s
    return np.interp(grid, time_s, force_n), period_s


def _motion(values: Series, period_s: float, noise_n: float, floor_n: float) -> _Motion:
    length_s = period_s * len(values)
    times: Series = period_s * np.arange(len(values), dtype=np.float64)
    centres, sizes = window_sizes(times, values, noise_n)
    if float(np.ptp(values)) <= floor_n:
        return _Motion(length_s, sizes, [], None, 0.0, 0.0, noise_n)
    late = slice(WINDOWS - _LATE_WINDOWS, None)
    growth, trend = growth_rate(centres[late], sizes[late], floor_n)
    change = growth * float(centres[-1] - centres[WINDOWS - _LATE_WINDOWS]) if growth is not None else 0.0
    modes = [mode for mode in modes_of(values, period_s, noise_n, floor_n) if not _is_spurious(values, mode, length_s)]
    return _Motion(length_s, sizes, modes, growth, change, trend, noise_n)


def window_sizes(time_s: Series, force_n: Series, noise_n: float = 0.0) -> tuple[Series, Series]:
    """Return the middle [s] of each window and how far the force moves in it [N], shape (WINDOWS,) each.

    Peak to peak less what white noise of standard deviation noise_n reaches in so many samples; also of means over an
    eighth of the window, in which there is less noise, and the larger of the two.
    """
    edges = np.linspace(0, len(time_s), WINDOWS + 1).astype(int)
    parts = [slice(a, b) for a, b in pairwise(edges)]
    centres = np.array([0.5 * (time_s[part][0] + time_s[part][-1]) for part in parts])
    return centres, np.array([_size(force_n[part], noise_n) for part in parts])


def _size(values: Series, noise_n: float) -> float:
    found = float(np.ptp(values)) - _reached_by_noise(noise_n, len(values))
    block = max(1, len(values) // WINDOWS)
    if noise_n > 0.0 and block > 1:
        means = np.diff(np.cumsum(values)[block - 1 :: block]) / block
        found = max(found, float(np.ptp(means)) - _reached_by_noise(noise_n / math.sqrt(block), len(means)))
    return max(found, 0.0)


def _reached_by_noise(noise_n: float, samples: int) -> float:
    """Return a peak-to-peak [N] that white noise of so many samples exceeds once in some thousand times."""
    return 2.0 * noise_n * (math.sqrt(2.0 * math.log(max(samples, 2))) + 1.0)


def growth_rate(time_s: Series, size_n: Series, floor_n: float) -> tuple[float | None, float]:
    """Return the slope [1/s] of log(size) over time, and how clear the trend is, -1 (falls throughout) to 1 (rises).

    Parameters: time_s, size_n, shape (n,); sizes up to floor_n count as nothing. The slope is the median over all pairs
    (Theil and Sen), because a window may miss the one burst of a slow limit cycle; the trend is Kendall's tau. A motion
    that has died out leaves no pairs: the slope is then unknown (None) and the trend 0.
    """
    alive = np.flatnonzero(size_n > floor_n)
    logs, times = np.log(size_n[alive]), time_s[alive]
    rises = [(logs[j] - logs[i], times[j] - times[i]) for i, j in combinations(range(len(alive)), 2)]
    if not rises:
        return None, 0.0
    slope = float(np.median([rise / run for rise, run in rises]))
    return slope, float(np.mean([np.sign(rise) for rise, _ in rises]))


def worst(kinds: Sequence[Kind]) -> Kind:
    """Return stable if all are, or else the first that is not."""
    return next((kind for kind in kinds if kind != "stable"), "stable")
