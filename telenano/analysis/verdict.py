"""What becomes of the motion of a loop: does it die out, go on, or grow.

    from telenano.analysis.verdict import judge
    judge(time_s, force_n, hand_force_n=1.0).kind          # "limit_cycle"

`judge` is given the force at the tip of one episode alone (`telenano.analysis.holds`): contact under a constant force
with the loop closed. It fits the modes of the motion (`telenano.analysis.modes`) to all of it. `classify` says of one
mode what it does, and `_decided` what the motion does by the largest mode of the first kind that occurs: grows, goes
on, is not known. Else the force is at rest.

A fit is believed where it leaves noise alone and no mode bends away from its exponential. Where it is not, the last
half, quarter and eighth are fitted: a blow, a landing and a growth that has reached its limit come before that. A short
part knows a growth less well than the whole: it decides only what it surely tells otherwise (`_beside`). What no modes
explain is judged by its envelope, the size of the motion in eight windows. A motion is at rest, and goes on, only if
its end is and does: a swing that may last is at rest only in a part that would show it, and what goes on by a fit that
leaves more than noise may surely die out in a later part.
"""

import math
from enum import Enum, auto
from itertools import pairwise
from typing import Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from telenano.analysis.modes import LEAST_SAMPLES, LINE_OVER_NOISE, Fit, Mode, centred, fitted, noise_floor, rms

Series = npt.NDArray[np.float64]
Kind = Literal["stable", "limit_cycle", "diverged", "contact_lost", "guarded", "no_data", "cannot_say"]

# The thresholds of the verdicts, with those of `telenano.analysis.holds`; docs/studies.md has them in one table.
# share of the hand's greatest force [1]: what moves less from peak to peak is rest, and a force below it presses not
SMALL_SHARE = 0.05
# change of a motion over a stretch [1, logarithm]: half of the 0.3 below which growth cannot be told from decay
LEAST_CHANGE = 0.15
# the same of a motion without a swing [1]: a quarter of a slow swing, and a drift that bends, change by less
ONE_SIDED_CHANGE = 1.5
# standard errors of a growth [1]: chance exceeds them to one side once in 160 times
SURE_ERRORS = 2.5
# standard errors [1] of a fall beside which nothing is said to go on: chance exceeds them once in forty times
LIKELY_ERRORS = 2.0
# turns [1], or times: what is seen less often may be chance
LEAST_TURNS = 2.0
# what an instrument may err by, as a share of the hand's force [1]: drift in a hold, noise, two calibrations, and as a
# share of a hold: samples that it lacks
ERROR_SHARE = 0.1

# what modes may leave of a motion, as a share of its root mean square [1]: the wall of a contact leaves a tenth, and
# the instrument errs by as much
_LEFT_SHARE = 2.0 * ERROR_SHARE
# below this share of the hand's force [1] there are rounding errors
_FLOOR_SHARE = 1e-7
# a motion that is there is as large as what a fit leaves [1]; sizes of few turns err by a third
_SHOWN_OVER_LEFT = 1.5
# a way is half of what is left, in power, where it is this multiple of its root mean square [1]
_WAY_OVER_LEFT = 2.5
_TAILS = (1.0, 0.5, 0.25, 0.125)
_WINDOWS = 8
# A motion that goes on is in its last window no less than this part of what it was [1]: a third of a turn goes as far
_LEAST_END = 1.0 / 3.0
# octaves of a spectrum that tell noise from a motion [1]
_OCTAVES = 4
# an octave with more than this of the density of white noise shows another motion [1]
_WHITE_OVER = 3.0
# fall of the density in an octave [1, logarithm] of noise whose density goes with the square of the frequency
_STEEPEST = 2.0 * math.log(2.0)
# chance makes a line over the density of noise, of its neighbours in the octave, less than once in e to this
_LINE_NATS = 7.0


class Fate(Enum):
    """What a mode, or an envelope, does."""

    GROWING = auto()
    LASTING = auto()
    FALLING = auto()
    NEGLIGIBLE = auto()
    UNSURE = auto()


# the fates of a swing that is there at the end, the sure one first
_MAY_LAST = (Fate.LASTING, Fate.GROWING, Fate.UNSURE)


class Cause(Enum):
    """Why a verdict is what it is."""

    NOT_A_NUMBER = auto()
    FEW_SAMPLES = auto()
    HIDDEN_BY_NOISE = auto()
    LIKE_NOISE = auto()
    ON_ITS_WAY = auto()
    CHANGE_UNKNOWN = auto()
    IRREGULAR_UNKNOWN = auto()
    WITHIN_A_STEP = auto()
    GROWS = auto()
    GOES_ON = auto()
    IRREGULAR = auto()
    AT_REST = auto()
    DIES_OUT = auto()
    MOVED = auto()
    TO_THE_REST = auto()


class Finding(NamedTuple):
    """What was found of a motion, before it is put into words.

    size_n: of the motion at its end [N]; decisive_n: of the mode that decides [N], with its growth [1/s], the standard
    error of that and its frequency [Hz], 0 of one without a swing, None of an envelope; needs_s, needs_noise_n: the
    length of a hold, and the noise, that would decide.
    """

    kind: Kind
    cause: Cause
    size_n: float = 0.0
    growth_per_s: float | None = None
    decisive_n: float = 0.0
    error_per_s: float = 0.0
    frequency_hz: float | None = None
    needs_s: float = 0.0
    needs_noise_n: float = 0.0
    rest_from_s: float | None = None
    samples: int = 0


class Verdict(NamedTuple):
    """What becomes of a motion.

    growth_per_s: of the mode that decides [1/s], None where nothing moves; peak_to_peak_n: of the motion that decides,
    at its end, without noise [N]; noise_n: standard deviation of the read-out's noise [N]; reason: the verdict in
    words; rest_from_s: from when on the force is at rest, None if it never is [s]; cause: the reason as a value.
    """

    kind: Kind
    growth_per_s: float | None
    peak_to_peak_n: float
    noise_n: float
    reason: str
    rest_from_s: float | None = None
    cause: Cause | None = None


class Window(NamedTuple):
    """The stretch that a mode is classified within.

    length_s, end_s: its length and end [s]; small_n: what is small [N]; rounded_n: what rounding makes [N];
    unrounded_n: what is small without rounding [N]; values: the force [N]; fit: its fit, which leaves left_n [N] in its
    last quarter.
    """

    length_s: float
    end_s: float
    small_n: float
    rounded_n: float
    unrounded_n: float
    values: Series
    fit: Fit

    @property
    def left_n(self) -> float:
        return rms(self.fit.left[-max(2, len(self.fit.left) // 4) :])

    @property
    def last(self) -> Series:
        """The force in the last quarter [N]."""
        return self.values[-max(2, len(self.values) // 4) :]

    @property
    def noise_n(self) -> float:
        """The noise of the read-out [N], of which the step that it rounds to is a part."""
        return max(self.fit.noise_n, self.rounded_n / 1.5 / math.sqrt(12.0))

    def cycles(self, mode: Mode) -> float:
        """Return how often a mode turns within the window while it stands out of what the fit leaves."""
        change, seen = mode.growth_per_s * self.length_s, self.seen(mode)
        return mode.frequency_hz * self.length_s * (min(seen / change, 1.0) if change > seen else 1.0)

    def seen(self, mode: Mode) -> float:
        """Return by how much a mode stands out of what the fit leaves at its end [1, logarithm]."""
        return math.log(max(mode.end_n / max(SURE_ERRORS * self.left_n, 1e-300), 1.0))


def judge(
    time_s: Series, force_n: Series, hand_force_n: float, rest_n: float | None = None, step_n: float | None = None
) -> Verdict:
    """Judge the motion of an episode.

    Args:
        time_s: The times of the samples [s], shape (n,), rising.
        force_n: alpha_f F_s at those times [N], shape (n,).
        hand_force_n: What is large beside it [N], > 0: the hand's greatest force.
        rest_n: The force that the law rests at [N], None if it does not say: an approach to it is one.
        step_n: The step of a read-out that rounds [N], as `rounding_of` finds it in the whole recording, 0 of one that
            does not; None finds it in the episode, where a motion between two values looks the same.

    Raises:
        ValueError: The hand's force is not positive.
    """
    if not hand_force_n > 0.0:
        raise ValueError(f"the hand's force in a hold is {hand_force_n} N, it must be > 0 N")
    finite = np.isfinite(force_n)
    size = float(np.ptp(force_n[finite])) if finite.any() else 0.0
    if not finite.all():
        return _in_words(Finding("diverged", Cause.NOT_A_NUMBER, size), 0.0)
    if len(time_s) < LEAST_SAMPLES:
        return _in_words(Finding("cannot_say", Cause.FEW_SAMPLES, size, samples=len(time_s)), 0.0)
    values, period_s = _even(time_s, force_n)
    step = rounding_of(values) if step_n is None else step_n
    noise = noise_of(values, step)
    if noise > ERROR_SHARE * max(hand_force_n, float(np.ptp(values))):
        least_n = ERROR_SHARE * hand_force_n
        return _in_words(Finding("cannot_say", Cause.HIDDEN_BY_NOISE, needs_noise_n=least_n), noise)
    motion = _Motion(values, period_s, float(time_s[-1]), hand_force_n, step, noise, rest_n)
    return _in_words(_found(motion), noise)


def _found(motion: "_Motion") -> Finding:
    """Judge by the modes of the motion and of its last parts, and by its envelope where these may be wrong.

    | the modes                                 | the envelope                                   | counts       |
    |---|---|---|
    | decide                                    | is not looked at                               | what they say |
    | are in doubt, and their fit may be wrong  | moves or dies out, and is mostly of that motion | the envelope |
    | are in doubt otherwise                    | is anything                                    | the doubt    |
    | explain nothing, and a swing in them lasts | is at rest, and does not show that it is not there | a doubt  |
    | explain nothing                           | is anything else                               | the envelope |

    An envelope does not go on whose largest swing seems to become smaller.
    """
    found, doubt, parts = _by_parts(motion)
    if found is not None:
        return found
    envelope = _by_envelope(motion)
    seems_to_fall = envelope.kind == "limit_cycle" and _seems_to_fall(parts)
    if doubt is not None:
        return doubt.found if seems_to_fall or not _settles(envelope, doubt) else envelope
    fates = _MAY_LAST if envelope.cause is Cause.AT_REST else _MAY_LAST[:1]
    lasting_n, at_hz = _lasting(parts, fates) if envelope.kind == "stable" else (0.0, 0.0)
    last = motion.values[-max(2, len(motion.values) // 4) :]
    if seems_to_fall:
        return envelope._replace(kind="cannot_say", cause=Cause.IRREGULAR_UNKNOWN)
    if envelope.cause is Cause.DIES_OUT and lasting_n > 0.5 * envelope.size_n:
        return envelope._replace(kind="cannot_say", cause=Cause.IRREGULAR_UNKNOWN)
    if (
        envelope.cause is Cause.AT_REST
        and lasting_n
        and not _shown_beside(lasting_n, at_hz, last, motion.period_s * len(last))
    ):
        needs_n = SMALL_SHARE * motion.hand_n
        cause = Cause.WITHIN_A_STEP if needs_n < lasting_n <= motion.small_n else Cause.IRREGULAR_UNKNOWN
        return Finding("cannot_say", cause, lasting_n, envelope.growth_per_s, lasting_n, needs_noise_n=needs_n)
    return envelope


def _settles(envelope: Finding, doubt: "_Doubt") -> bool:
    """Return whether an envelope decides what is in doubt: it moves or dies out, and is mostly of that motion."""
    growth, error = doubt.found.growth_per_s or 0.0, SURE_ERRORS * doubt.found.error_per_s
    is_cycle = envelope.kind == "limit_cycle" and growth + error >= 0.0
    # The motion that dies out is another one where that in doubt grows.
    falls = envelope.cause is Cause.DIES_OUT and growth < 0.0
    is_motion = is_cycle or falls or envelope.kind == "diverged"
    is_of_it = doubt.found.decisive_n > 0.5 * envelope.size_n
    return doubt.found.cause is Cause.CHANGE_UNKNOWN and doubt.may_be_wrong and is_motion and is_of_it


class _Motion(NamedTuple):
    """The force of an episode [N] at even times, the hand's, the step and the noise of its read-out, and its rest."""

    values: Series
    period_s: float
    end_s: float
    hand_n: float
    step_n: float
    noise_n: float
    rest_n: float | None

    @property
    def small_n(self) -> float:
        # One step of a read-out that rounds is no motion.
        return max(SMALL_SHARE * self.hand_n, 1.5 * self.step_n)

    def last(self, share: float) -> Window | None:
        """Return the last share of the motion with its fit; None where it has too few samples."""
        tail = self.values[len(self.values) - round(share * len(self.values)) :]
        if len(tail) < LEAST_SAMPLES:
            return None
        fit = fitted(tail, self.period_s, _FLOOR_SHARE * self.hand_n)
        least = (self.small_n, 1.5 * self.step_n, SMALL_SHARE * self.hand_n)
        return Window(self.period_s * len(tail), self.end_s, *least, tail, fit)


class _Doubt(NamedTuple):
    """What the first fit that explains a motion cannot say, and whether that fit may be wrong.

    It may be where it leaves more than noise, or has a motion grow, or change by less than 0.3: what grows comes to a
    limit. A fit that leaves noise alone, of a motion that dies out slowly, says itself how little is known.
    """

    found: Finding
    may_be_wrong: bool


def _by_parts(motion: _Motion) -> tuple[Finding | None, _Doubt | None, list[Window]]:
    """Return what the modes of the motion say, or of the first of its last parts that decides; else the doubt.

    The parts are returned as well, of which none decided.
    """
    doubt: _Doubt | None = None
    swings_hz: list[float] = []
    earlier: list[Window] = []
    for share in _TAILS:
        window = motion.last(share)
        # less than half of a motion shows too little of a force on its way
        is_short = share < _TAILS[1] and doubt is not None and doubt.found.cause is Cause.ON_ITS_WAY
        if window is None or is_short:
            break
        found = _of_part(motion, window)
        if not earlier:
            swings_hz = _lasting_hz(window)
        elif found is not None and _hides(motion, window, found, earlier, swings_hz):
            break
        else:
            found = _beside(earlier, found, window, motion)
        earlier.append(window)
        if found is None:
            continue
        if found.kind != "cannot_say" and (doubt is None or _overrules(found, doubt, window, share)):
            return _at_the_end(motion, found, window, share), None, earlier
        may_be_wrong = _may_be_wrong(found, window) if doubt is None else doubt.may_be_wrong
        doubt = _Doubt(found if doubt is None else doubt.found, may_be_wrong or not _leaves_noise(window))
        if found.frequency_hz and doubt.found is found and found.cause is not Cause.ON_ITS_WAY:
            swings_hz = [*swings_hz, found.frequency_hz]
    return None, doubt, earlier


def _beside(earlier: list[Window], found: Finding | None, window: Window, motion: _Motion) -> Finding | None:
    """Return what a last part says beside the parts that it is in the end of; None where it says nothing new.

    | the part           | the parts before it                                  | it says           |
    |---|---|---|
    | is at rest         | show a swing that it would not                       | nothing           |
    | goes on, or grows  | fall twice, and it does not surely change otherwise  | what the first says |
    | goes on, or grows  | fall once, and it does not surely change otherwise   | a doubt           |
    | is anything else   | are anything                                         | what it says      |
    """
    if found is None:
        return None
    if found.kind == "stable":
        falls = (
            found.cause is Cause.DIES_OUT and _leaves_noise(window) and not _cancels(window) and _is_less_at_end(motion)
        )
        lasting_n, at_hz = (0.0, 0.0) if falls else _lasting(earlier, _MAY_LAST)
        return None if lasting_n and not _shows_rest(found, lasting_n, at_hz, window) else found
    if not _falls_as_before(found, window, earlier):
        return found
    before = [_decided(own) for own in earlier if _explains(own, motion.hand_n)]
    stable = [own for own in before if own.kind == "stable"]
    return stable[0] if len(stable) > 1 else _as_doubt(found)


def _is_less_at_end(motion: _Motion) -> bool:
    """Return whether a motion is smaller in its last window than in the one before; one of few turns does not show."""
    turns = _turns(motion.values)
    sizes = _envelope(motion.values, motion, turns)
    return turns < _WINDOWS or sizes[-1] < sizes[-2]


def _as_doubt(found: Finding) -> Finding:
    return found._replace(kind="cannot_say", cause=Cause.CHANGE_UNKNOWN)


def _near(window: Window, frequency_hz: float, apart_hz: float) -> list[Mode]:
    """Return the modes that are less than that apart from a frequency."""
    return [mode for mode in window.fit.modes if abs(mode.frequency_hz - frequency_hz) < apart_hz]


def _falls_as_before(found: Finding, window: Window, earlier: list[Window]) -> bool:
    """Return whether what goes on or grows in a last part may change there as it surely dies out before."""
    if found.kind not in ("limit_cycle", "diverged") or not found.frequency_hz:
        return False
    near = [(mode, own) for own in earlier for mode in _near(own, found.frequency_hz, 1.0 / window.length_s)]
    falling = [
        mode for mode, own in near if mode.end_n > 0.5 * found.decisive_n and classify(mode, own) is Fate.FALLING
    ]
    return bool(falling) and not _grows_more(found.growth_per_s or 0.0, found.error_per_s, falling[0])


def _grows_more(growth_per_s: float, error_per_s: float, mode: Mode) -> bool:
    """Return whether a growth is surely larger than that of a mode."""
    return growth_per_s - mode.growth_per_s > SURE_ERRORS * math.hypot(error_per_s, mode.error_per_s)


def _at_the_end(motion: _Motion, found: Finding, window: Window, share: float) -> Finding:
    """Return a finding, or that of a later part by which the motion surely dies out where its fit is not sure."""
    if found.kind not in ("limit_cycle", "diverged") or not found.frequency_hz or _leaves_noise(window):
        return found
    for later_share in _TAILS:
        later = motion.last(later_share) if later_share < share else None
        if later is None or later.length_s * found.frequency_hz < LEAST_TURNS:
            continue
        if not _leaves_noise(later) or not _explains(later, motion.hand_n) or _cancels(later):
            continue
        own, near = _decided(later), _near(later, found.frequency_hz, 1.0 / later.length_s)
        differs = any(_grows_more(found.growth_per_s or 0.0, found.error_per_s, mode) for mode in near)
        if own.kind == "stable" and (own.growth_per_s or 0.0) < 0.0 and differs:
            return own
    return found


def _lasting_hz(window: Window) -> list[float]:
    """Return the frequencies of the large swings of a motion that do not die out."""
    lasts = -LEAST_CHANGE / window.length_s
    large = [mode for mode in window.fit.modes if mode.end_n > window.small_n and mode.growth_per_s > lasts]
    return [mode.frequency_hz for mode in large if mode.frequency_hz * window.length_s >= 1.0]


def _of_part(motion: _Motion, window: Window) -> Finding | None:
    """Return what the modes of a part say; None where they do not explain it."""
    if not _explains(window, motion.hand_n):
        return None
    found = _decided(window)
    if found.kind != "stable" and _leaves_noise(window) and _cancels(window):
        return None
    if _is_open(found, window) and not (_fits_to_the_end(window) and _falls_to_the_end(found, window, motion)):
        return None
    gone_n = _gone(window.values) if found.kind == "stable" and not window.fit.modes else 0.0
    if gone_n > max(ERROR_SHARE * motion.hand_n, _WAY_OVER_LEFT * rms(window.fit.left)):
        # that is no swing and no exponential, more than an instrument drifts, and does not come to rest
        found = _on_its_way(found, gone_n, 4.0 * window.length_s)
    if found.cause is Cause.ON_ITS_WAY and motion.rest_n is not None:
        found = _approaching(found, window.values, motion.rest_n)
    if found.kind == "stable" and len(window.values) == len(motion.values):
        return _swing_at_the_end(motion, window) or found
    return found


def _falls_to_the_end(found: Finding, window: Window, motion: _Motion) -> bool:
    """Return whether a motion that dies out, and is still large, is smaller at its end than before.

    Modes that all die out may cancel one another before, so that their sum grows.
    """
    turns = _turns(window.values)
    if found.kind != "stable" or turns < 2.0 * LEAST_TURNS or (_leaves_noise(window) and not _cancels(window)):
        return True
    sizes = _envelope(window.values, motion, turns)
    return sizes[-1] < min(sizes[0], sizes[_WINDOWS // 2])


def _may_be_wrong(found: Finding, window: Window) -> bool:
    rate, error = found.growth_per_s or 0.0, SURE_ERRORS * found.error_per_s
    return rate > 0.0 or abs(rate) + error < 2.0 * LEAST_CHANGE / window.length_s


def _overrules(found: Finding, doubt: _Doubt, window: Window, share: float) -> bool:
    """Return whether a last part decides what the whole leaves in doubt: by rest, or by a fit where that was wrong."""
    if _shows_rest(found, doubt.found.size_n, doubt.found.frequency_hz or 0.0, window):
        return True
    is_long = found.kind == "limit_cycle" or share == _TAILS[1]
    return is_long and doubt.may_be_wrong and _leaves_noise(window)


def _is_open(found: Finding, window: Window) -> bool:
    """Return whether a finding is one only if its fit is right.

    It is where more is left than is small, where the change of a motion is not known, and where something larger dies
    out beside what lasts.
    """
    if found.kind == "stable":
        return found.size_n > window.small_n
    others = [mode.begin_n for mode in window.fit.modes if mode.growth_per_s * window.length_s < -LEAST_CHANGE]
    falls = found.cause is Cause.GOES_ON and max(others, default=0.0) > found.decisive_n
    return falls or found.cause is Cause.CHANGE_UNKNOWN


def _hides(motion: _Motion, window: Window, found: Finding, earlier: list[Window], swings_hz: list[float]) -> bool:
    """Return whether a last part that rests, or runs to one side, may hide a swing: it turns less than twice in it."""
    slowest_hz = min(swings_hz, default=math.inf)
    if found.kind == "diverged" and found.frequency_hz == 0.0:
        modes = [(mode, own.length_s) for own in earlier for mode in own.fit.modes]
        large = [(mode.frequency_hz, length_s) for mode, length_s in modes if mode.end_n > 0.5 * found.decisive_n]
        slowest_hz = min((own_hz for own_hz, length_s in large if own_hz * length_s > LEAST_TURNS), default=math.inf)
        return slowest_hz * window.length_s < LEAST_TURNS
    if found.kind != "stable":
        return False
    if any(max(mode.begin_n, mode.end_n) > motion.small_n for mode in window.fit.modes):
        half = motion.values[len(motion.values) // 2 :]
        slowest_hz = min(slowest_hz, _turns(half) / (motion.period_s * len(half)))
    return slowest_hz * window.length_s < LEAST_TURNS or _recurs(_sizes(motion), motion.small_n)


def _swing_at_the_end(motion: _Motion, window: Window) -> Finding | None:
    """Return what the last half says of a large swing, of a motion whose fit leaves more than noise; else None.

    Where the fit of the half leaves more than noise as well, that it goes on or grows is a doubt.
    """
    left_n = 2.0 * math.sqrt(2.0) * window.left_n
    half = motion.last(_TAILS[1]) if left_n > motion.small_n and not _leaves_noise(window) else None
    if half is None or not _explains(half, motion.hand_n):
        return None
    found = _decided(half)
    if found.kind in ("limit_cycle", "diverged"):
        return found if _leaves_noise(half) else _as_doubt(found)
    # A fit that leaves noise alone knows a swing by one turn. What stands out for less may be a hand that wanders.
    is_swing = (found.frequency_hz or 0.0) * half.length_s >= (0.5 if _leaves_noise(half) else 1.0) * LEAST_TURNS
    is_seen = any(half.cycles(mode) >= 1.0 for mode in half.fit.modes if mode.end_n > motion.small_n)
    # a line that is found in what is left has this size
    line_n = 4.0 * math.sqrt(2.0 * LINE_OVER_NOISE / len(half.fit.left)) * half.left_n
    last = half.values[len(half.values) // 2 :]
    stays_n = 2.0 * _line_n(last, 0.5 * (found.frequency_hz or 0.0) * half.length_s)
    is_large = min(found.decisive_n, stays_n) > max(motion.small_n, line_n)
    return found if found.kind == "cannot_say" and is_swing and is_seen and is_large else None


def _shows_rest(found: Finding, swing_n: float, frequency_hz: float, window: Window) -> bool:
    """Return whether a last part is at rest that would show a swing of a size and a frequency."""
    at_rest = found.kind == "stable" and found.rest_from_s is not None
    near = _near(window, frequency_hz, 1.0 / window.length_s) if frequency_hz else []
    if any(mode.end_n > 0.5 * swing_n and mode.frequency_hz for mode in near):
        # it is there, and no part of what is left
        return False
    return at_rest and _shown_beside(swing_n, frequency_hz, window.fit.left, window.length_s)


def _shown_beside(swing_n: float, frequency_hz: float, left: Series, length_s: float) -> bool:
    """Return whether a swing would be seen: what is left is smaller, or is as large and has little at its frequency."""
    left_n = 2.0 * math.sqrt(2.0) * rms(centred(left))
    if swing_n > _SHOWN_OVER_LEFT * left_n or frequency_hz * length_s < 1.0:
        return swing_n > _SHOWN_OVER_LEFT * left_n
    # the frequency is not known better than to half a turn in the part
    lines_n = [_line_n(left, frequency_hz * length_s + 0.25 * k) for k in range(-2, 3)]
    return swing_n > left_n / _SHOWN_OVER_LEFT and max(lines_n) < 0.5 * swing_n


def _line_n(left: Series, turns: float) -> float:
    """Return from peak to peak what a series has at a line that turns so often in it [N]."""
    angle = 2.0 * math.pi * turns * np.arange(len(left)) / max(1, len(left) - 1)
    bare = centred(left)
    cosine, sine = (float(np.cumsum(bare * wave)[-1]) for wave in (np.cos(angle), np.sin(angle)))
    return 4.0 * math.hypot(cosine, sine) / len(left)


def _lasting(parts: list[Window], fates: tuple[Fate, ...]) -> tuple[float, float]:
    """Return size and frequency of the largest swing at the end of parts that has one of these fates; 0 of none."""
    modes = [(mode, own) for own in parts for mode in own.fit.modes]
    swings = [(mode, own) for mode, own in modes if mode.frequency_hz * own.length_s >= LEAST_TURNS]
    # the first line of a motion between two forces is larger than the motion
    large = [(mode, own) for mode, own in swings if min(mode.end_n, float(np.ptp(own.last))) > own.unrounded_n]
    lasting = [mode for mode, own in large if classify(mode, own) in fates]
    return max(((mode.end_n, mode.frequency_hz) for mode in lasting), default=(0.0, 0.0))


def _seems_to_fall(parts: list[Window]) -> bool:
    """Return whether the largest swing of a part that is explained becomes smaller, by however little, as it seems."""
    for own in parts:
        large = max(own.fit.modes, key=lambda mode: mode.end_n, default=None)
        if large is None or large.frequency_hz * own.length_s < 2.0 * LEAST_TURNS or large.end_n <= own.small_n:
            continue
        falls = large.growth_per_s + LIKELY_ERRORS * large.error_per_s < 0.0
        if falls and _explains(own, own.unrounded_n / SMALL_SHARE):
            return True
    return False


def _explains(window: Window, hand_force_n: float) -> bool:
    """Return whether modes that do not bend leave of the motion, and of its last quarter, noise or a small share."""
    fit = window.fit
    for part in (slice(None), slice(-max(2, len(fit.left) // 4), None)):
        moved = rms(centred(fit.motion[part]))
        noise = 1.5 * fit.noise_n
        coloured_n = hand_force_n if fit.whole else 0.0
        seen_n = SURE_ERRORS * (float(np.ptp(fit.motion[part])) + max(noise, ERROR_SHARE * coloured_n))
        left_n = max(
            noise, _coloured(fit.left) * coloured_n, _LEFT_SHARE * moved, _LEFT_SHARE**2 * SMALL_SHARE * hand_force_n
        )
        # large modes that cancel are no motion
        if any(mode.end_n > seen_n for mode in fit.modes) or rms(fit.left[part]) > left_n:
            return False
    return _leaves_noise(window) or not any(_bends(mode, window) for mode in fit.modes)


def _coloured(left: Series) -> float:
    """Return up to which share of the hand's force what a fit leaves is noise: less where an octave has most of it."""
    power = np.abs(np.fft.rfft(centred(left))) ** 2
    octaves = [float(np.cumsum(power[2**k : 2 ** (k + 1)])[-1]) for k in range(int(math.log2(len(power))))]
    return SMALL_SHARE if max(octaves[:-1], default=0.0) > 0.5 * math.fsum(octaves) else ERROR_SHARE


def _cancels(window: Window) -> bool:
    """Return whether two large modes are apart by less than a turn, and one of their growths is not known alone."""
    large = sorted(
        (mode.frequency_hz, SURE_ERRORS * mode.error_per_s * window.length_s)
        for mode in window.fit.modes
        if max(mode.begin_n, mode.end_n) > window.small_n and mode.frequency_hz * window.length_s > LEAST_TURNS
    )
    return any(
        above - below < 1.0 / window.length_s and max(*errors) > LEAST_CHANGE
        for (below, *first), (above, *then) in pairwise(large)
        for errors in [(*first, *then)]
    )


def _bends(mode: Mode, window: Window) -> bool:
    """Return whether the amplitude of a large swing is, in a third, not what its exponential has there."""
    if mode.frequency_hz * window.length_s < 3.0 * LEAST_TURNS or mode.end_n <= window.small_n:
        return False
    error_n = SURE_ERRORS * rms(window.fit.left) * math.sqrt(12.0 / len(window.fit.left))
    least_n = _LEFT_SHARE * max(mode.thirds_n) + error_n
    factor = math.exp(min(max(mode.growth_per_s * window.length_s / 3.0, -50.0), 50.0))
    first_n, middle_n, last_n = mode.thirds_n
    return abs(middle_n - first_n * factor) > least_n or abs(last_n - middle_n * factor) > least_n * max(factor, 1.0)


def _leaves_noise(window: Window) -> bool:
    """Return whether the modes leave the white noise of the read-out alone, or next to nothing of the motion."""
    moved_n = rms(centred(window.fit.motion[-max(2, len(window.fit.motion) // 4) :]))
    return window.left_n <= max(1.5 * window.noise_n, _LEFT_SHARE**2 * moved_n)


def _fits_to_the_end(window: Window) -> bool:
    """Return whether the modes leave of the last quarter noise, which has no line where it is not white."""
    return _leaves_noise(window) or (window.fit.whole and window.left_n <= window.unrounded_n)


def classify(mode: Mode, window: Window) -> Fate:
    """Return what a mode does in a window. `change` is its growth times the length, `error` 2.5 of its standard errors.

    | the mode                                                                            | is         |
    |---|---|
    | is below what a fit leaves that some line is left of                                | NEGLIGIBLE |
    | surely grows by more than the least change, is seen to, and is or becomes large     | GROWING    |
    | surely grows, is large or may become so, and is not seen to                         | UNSURE     |
    | surely grows and neither is nor becomes large                                       | NEGLIGIBLE |
    | surely dies out by more than the least change                                       | FALLING    |
    | turns twice, surely changes by less than 0.3, is large and falls not in each third  | LASTING    |
    | the same, and small only beside the step of the read-out                            | UNSURE     |
    | is small, or drifts by less than an instrument errs                                 | NEGLIGIBLE |
    | is anything else                                                                    | UNSURE     |

    The least change is LEAST_CHANGE of what turns twice, and ONE_SIDED_CHANGE, or twice that, of what does not.
    """
    if not window.fit.whole and mode.end_n < 2.0 * math.sqrt(2.0) * window.left_n:
        return Fate.NEGLIGIBLE
    change, error, cycles = *_change(mode, window), window.cycles(mode)
    is_swing = cycles >= 0.5
    # The growth of a swing that is seen once has to be as clear on either side.
    least = LEAST_CHANGE if cycles >= LEAST_TURNS else ONE_SIDED_CHANGE * (2.0 if is_swing else 1.0)
    falls_by = LEAST_CHANGE if is_swing or not mode.frequency_hz else ONE_SIDED_CHANGE
    if change - error > least:
        return _growing(mode, window, change, cycles, least)
    if change + error < -falls_by:
        return Fate.FALLING
    if (
        cycles >= LEAST_TURNS
        and abs(change) + error + window.rounded_n / mode.end_n / 3.0 < 2.0 * LEAST_CHANGE
        and -change < max(error, _LEFT_SHARE * LEAST_CHANGE)
    ):
        # friction makes of one swing that dies out a swing that does, less one that stays
        falls = all(after < before * math.exp(-LEAST_CHANGE) for before, after in pairwise(mode.thirds_n))
        if mode.end_n > window.small_n and not falls:
            return Fate.LASTING
        return Fate.UNSURE if mode.end_n > window.unrounded_n else Fate.NEGLIGIBLE
    drifts = not is_swing and max(mode.begin_n, mode.end_n) < ERROR_SHARE * window.small_n / SMALL_SHARE
    # a swing within a step of the read-out may grow or die out unseen
    within_n = window.unrounded_n if cycles >= LEAST_TURNS else window.small_n
    is_over = is_swing or change < -2.0 * ONE_SIDED_CHANGE
    is_small = drifts or max(mode.end_n, 0.0 if is_over else mode.begin_n) <= within_n
    return Fate.NEGLIGIBLE if is_small else Fate.UNSURE


def _change(mode: Mode, window: Window) -> tuple[float, float]:
    """Return by how much a mode changes over a window, and SURE_ERRORS of its standard errors [1, logarithm]."""
    if 0.0 < mode.frequency_hz * window.length_s < 0.5:
        # less than half a swing looks like an exponential: what counts is how far it goes in either half
        return 2.0 * math.log(max(mode.end_n, 1e-300) / max(mode.begin_n, 1e-300)), 0.0
    return mode.growth_per_s * window.length_s, SURE_ERRORS * mode.error_per_s * window.length_s


def _growing(mode: Mode, window: Window, change: float, cycles: float, least: float) -> Fate:
    """Return what a mode does whose fit surely grows."""
    # A growth is seen over the residue, and from each part to the next if it turns often enough.
    rises = window.seen(mode) > least and (cycles < LEAST_TURNS or _rises(window.fit, mode, change))
    # what has been seen for two swings is said to go on for a stretch more
    own = window.values[-max(2, math.ceil(len(window.values) * min(1.0, max(cycles, 1.0) / change))) :]
    # in the time of its growth, or of a turn that is seen, it goes as far as more than half of what it is
    end_n = min(mode.end_n, 2.0 * float(np.ptp(own)))
    reaches = end_n * (math.exp(min(change, 50.0)) if cycles >= LEAST_TURNS else 1.0) > window.small_n
    if rises and reaches and end_n > max(2.0 * SURE_ERRORS * window.left_n, window.rounded_n):
        return Fate.GROWING
    # what may only just be seen is not said to be at rest
    within_n = window.unrounded_n if cycles >= LEAST_TURNS else window.small_n
    is_near = end_n > within_n or (rises and reaches and cycles >= 0.5 and end_n > window.rounded_n)
    return Fate.UNSURE if is_near else Fate.NEGLIGIBLE


def _decided(window: Window) -> Finding:
    """Decide by the largest mode of the first fate that occurs: growth, what lasts, doubt; else the force is at rest.

    A growth is as large as what lasts, and a doubt is about more than twice as much.
    """
    modes = sorted(window.fit.modes, key=lambda one: one.end_n, reverse=True)
    fates = [(classify(mode, window), mode) for mode in modes]
    first = {fate: next((mode for own, mode in fates if own is fate), None) for fate in Fate}
    growing, lasting, unsure = first[Fate.GROWING], first[Fate.LASTING], first[Fate.UNSURE]
    is_doubt = unsure is not None and growing is not None and unsure.end_n > 2.0 * growing.end_n
    if growing is not None and (lasting is None or growing.end_n >= lasting.end_n) and not is_doubt:
        return _finding("diverged", Cause.GROWS, growing, window)
    if lasting is not None and (unsure is None or unsure.end_n < 2.0 * lasting.end_n):
        lowest_hz = min(mode.frequency_hz for fate, mode in fates if fate is Fate.LASTING)
        return _finding("limit_cycle", Cause.GOES_ON, lasting, window)._replace(
            size_n=_cycle_size_n(lasting, lowest_hz, window)
        )
    if unsure is not None:
        return _undecided(unsure, window, modes[0].end_n)
    return _at_rest(modes, window)


def _finding(kind: Kind, cause: Cause, mode: Mode, window: Window) -> Finding:
    turns = mode.frequency_hz if mode.frequency_hz * window.length_s >= 0.5 else 0.0
    return Finding(kind, cause, mode.end_n, mode.growth_per_s, mode.end_n, mode.error_per_s, turns)


def _cycle_size_n(mode: Mode, lowest_hz: float, window: Window) -> float:
    """Return how far a cycle goes [N], whose harmonics make it another motion than its largest mode."""
    values, noise_n = window.values, noise_of(window.values, window.rounded_n / 1.5)
    size_n = _moved(values[-math.ceil(len(values) / (window.length_s * lowest_hz)) :], noise_n)
    return size_n if size_n > 0.5 * mode.end_n else mode.end_n


def _undecided(mode: Mode, window: Window, size_n: float) -> Finding:
    """Return what is not known of a mode, and what would decide it."""
    found, cycles = _finding("cannot_say", Cause.CHANGE_UNKNOWN, mode, window), mode.frequency_hz * window.length_s
    if cycles < 1.0:
        need_s = LEAST_TURNS / mode.frequency_hz if cycles >= 0.25 else 4.0 * window.length_s
        return _on_its_way(found._replace(size_n=size_n), mode.end_n, need_s)
    noise_n = window.fit.noise_n / 2.0 if window.fit.noise_n > ERROR_SHARE * mode.end_n else 0.0
    return found._replace(size_n=size_n, needs_s=2.0 * window.length_s, needs_noise_n=noise_n)


def _on_its_way(found: Finding, way_n: float, needs_s: float) -> Finding:
    return found._replace(kind="cannot_say", cause=Cause.ON_ITS_WAY, decisive_n=way_n, needs_s=needs_s)


def _at_rest(modes: list[Mode], window: Window) -> Finding:
    """Return that a force is at rest, or comes to it, whose modes die out or are small."""
    size_n = max((mode.end_n for mode in modes), default=0.0)
    rate = max((mode.growth_per_s for mode in modes if mode.end_n > 0.0), default=None)
    rest_s = window.end_s - window.length_s + max((_until(mode, window.small_n) for mode in modes), default=0.0)
    rest_from_s = min(rest_s, window.end_s) if size_n <= window.small_n else None
    nothing = size_n <= _FLOOR_SHARE * window.unrounded_n / SMALL_SHARE or rate is None
    is_dying, is_large = rate is not None and rate < 0.0, size_n > window.small_n
    cause = Cause.DIES_OUT if is_dying and not nothing else Cause.MOVED if is_large and not nothing else Cause.AT_REST
    decisive_n = 0.0 if nothing else size_n
    return Finding("stable", cause, size_n, rate, decisive_n, rest_from_s=rest_from_s)


def _rises(fit: Fit, mode: Mode, change: float) -> bool:
    """Return whether a line grows from each third of a stretch to the next by half of what its fit says."""
    least_n = max(SURE_ERRORS * rms(fit.left) * math.sqrt(12.0 / len(fit.left)), _LEFT_SHARE**2 * mode.thirds_n[-1])
    factor = math.exp(change / 6.0)
    return all(after >= before * factor or before <= least_n for before, after in pairwise(mode.thirds_n))


def _until(mode: Mode, small_n: float) -> float:
    """Return after which time a mode that dies out is small [s]."""
    if mode.growth_per_s >= 0.0 or mode.begin_n <= small_n:
        return 0.0
    return math.log(mode.begin_n / small_n) / -mode.growth_per_s


def _approaching(found: Finding, values: Series, rest_n: float) -> Finding:
    """Return a finding that a force is on its way, which is stable if it goes to the rest of the law."""
    part = max(1, len(values) // 20)
    off_n = [abs(float(np.cumsum(own)[-1]) / part - rest_n) for own in (values[:part], values[-part:])]
    if off_n[1] > off_n[0] * math.exp(-2.0 * LEAST_CHANGE):
        return found
    return found._replace(kind="stable", cause=Cause.TO_THE_REST, decisive_n=off_n[1])


def _by_envelope(motion: _Motion) -> Finding:
    """Judge a motion that no modes explain by its envelope, the size of the motion in eight windows.

    | the envelope                                                                           | is         |
    |---|---|
    | is that of a motion without a line whose spectrum is that of 1/f noise                 | UNSURE     |
    | is small in the last two windows, did not rise twice before, and the force has stopped | NEGLIGIBLE |
    | rose twice from rest, and is not smaller than before                                   | LASTING    |
    | is that of a motion of fewer than four turns, or one whose spectrum has no main octave | UNSURE     |
    | surely changes by less than 0.3 in its later half                                      | LASTING    |
    | surely grows, also in its later half                                                   | GROWING    |
    | surely dies out, also in its later half and there nearly as quickly                    | FALLING    |
    | is irregular, and as large in the later half as in the earlier                         | LASTING    |
    | is anything else                                                                       | UNSURE     |
    """
    values, small_n = motion.values, motion.small_n
    if len(values) < _WINDOWS**2:
        return Finding("cannot_say", Cause.FEW_SAMPLES, float(np.ptp(values)), samples=len(values))
    sizes = _sizes(motion)
    window_s = motion.period_s * len(values) / _WINDOWS
    rate, end_n = _trend(sizes, small_n)[0] / (window_s * _WINDOWS), max(sizes[-2:])
    late = Finding(
        "cannot_say", Cause.IRREGULAR_UNKNOWN, max(sizes[_WINDOWS // 2 :]), rate, max(sizes[_WINDOWS // 2 :])
    )
    if end_n > small_n and _falls_as_noise(values, motion.noise_n):
        return late._replace(cause=Cause.LIKE_NOISE, size_n=max(sizes), decisive_n=max(sizes))
    if end_n <= small_n and not _recurs(sizes, small_n):
        last = max((k for k, own in enumerate(sizes) if own > small_n), default=-1)
        rest_s = motion.end_s - (_WINDOWS - 1 - last) * window_s
        rest = values[len(values) * (last + 1) // _WINDOWS :]
        if len(rest) >= _WINDOWS and (gone_n := _gone(rest)) > ERROR_SHARE * motion.hand_n:
            # it is small in each window, and goes on from one to the next
            return _on_its_way(late, gone_n, 4.0 * _WINDOWS * window_s)
        return Finding("stable", Cause.AT_REST, sizes[-1], rate, sizes[-1], rest_from_s=rest_s)
    turns, is_motion = _turns(values), _coloured(values) < ERROR_SHARE
    fate = _fate(_envelope(values, motion, turns), small_n) if turns >= 2.0 * LEAST_TURNS and is_motion else Fate.UNSURE
    if fate is Fate.GROWING:
        return Finding("diverged", Cause.GROWS, sizes[-1], rate, sizes[-1])
    if fate is Fate.FALLING:
        return Finding("stable", Cause.DIES_OUT, sizes[-1], rate, sizes[-1])
    goes_on = fate is Fate.LASTING and sizes[-1] > _LEAST_END * late.size_n
    if goes_on or (_recurs(sizes, small_n) and max(sizes[-3:]) > 0.5 * max(sizes)):
        return late._replace(kind="limit_cycle", cause=Cause.IRREGULAR)
    return late


def _fate(sizes: list[float], small_n: float) -> Fate:
    """Return what an envelope does that is not small at its end: see `_by_envelope`."""
    half = _WINDOWS // 2
    (late, late_error), (whole, whole_error) = _trend(sizes[half:], small_n), _trend(sizes, small_n)
    earlier, later = max(sizes[half:-2]), max(sizes[-2:])
    if abs(late) + late_error < 2.0 * LEAST_CHANGE and -late < max(late_error, _LEFT_SHARE * LEAST_CHANGE):
        return Fate.LASTING
    if whole - whole_error > LEAST_CHANGE and late > 0.0 and sizes[-1] > (1.0 - _LEFT_SHARE) * max(sizes):
        return Fate.GROWING if late - late_error > LEAST_CHANGE or later > earlier else Fate.UNSURE
    early = _trend(sizes[:half], small_n)[0]
    if whole + whole_error < -LEAST_CHANGE and late < 0.0:
        # what falls to a swing that stays falls more slowly at the end
        return Fate.FALLING if late + late_error < -LEAST_CHANGE and late < 0.6 * early else Fate.UNSURE
    stays = max(sizes[half:]) > 0.5 * max(sizes[:half]) and later > 0.5 * earlier
    # the later half and all of it, each in its own errors, together tell of a fall
    falls = late / max(late_error, 1e-9) + whole / max(whole_error, 1e-9) < -math.sqrt(2.0)
    return Fate.LASTING if stays and not falls and abs(late) < LEAST_TURNS * late_error else Fate.UNSURE


def _trend(sizes: list[float], small_n: float) -> tuple[float, float]:
    """Return by how much sizes change over all their windows [1, logarithm], and SURE_ERRORS of its standard errors."""
    count = len(sizes)
    logs = [math.log(max(size, 1e-3 * small_n)) for size in sizes]
    middle, mean = 0.5 * (count - 1.0), math.fsum(logs) / count
    spread = math.fsum((k - middle) ** 2 for k in range(count))
    slope = math.fsum((k - middle) * (own - mean) for k, own in enumerate(logs)) / spread
    left = math.fsum((own - mean - slope * (k - middle)) ** 2 for k, own in enumerate(logs))
    return slope * count, SURE_ERRORS * count * math.sqrt(left / (count - 2.0) / spread)


def rounding_of(values: Series) -> float:
    """Return the step of a read-out that rounds [N]; 0 of one that does not."""
    steps = np.abs(np.diff(values))
    moved = steps[steps > 0.0]
    return float(moved.min()) if len(moved) and len(np.unique(values)) < len(values) / 4 else 0.0


def _sizes(motion: _Motion) -> list[float]:
    """Return how far the force goes in each of eight windows [N]: from end to end, or as a swing of its power does."""
    edges = np.linspace(0, len(motion.values), _WINDOWS + 1).astype(int)
    return [_size(motion.values[first:last], motion) for first, last in pairwise(edges)]


def _turns(values: Series) -> float:
    """Return how often the strongest line of a motion turns."""
    count = len(values)
    window = 0.5 - 0.5 * np.cos(2.0 * np.pi * (np.arange(count) + 0.5) / count)
    return float(1 + np.argmax(np.abs(np.fft.rfft(centred(values) * window))[1:]))


def _envelope(values: Series, motion: _Motion, turns: float) -> list[float]:
    """Return how far the force goes about eight instants [N], in an eighth or in a turn if that is longer."""
    count = len(values)
    wide = math.ceil(count * max(1.0 / _WINDOWS, 1.25 / turns))
    firsts = [round(min(max((k + 0.5) / _WINDOWS * count - 0.5 * wide, 0.0), count - wide)) for k in range(_WINDOWS)]
    return [_size(values[first : first + wide], motion) for first in firsts]


def _size(values: Series, motion: _Motion) -> float:
    """Return how far a force goes [N], without what noise reaches, or adds to its power, or a step that flickers."""
    noise_n = max(motion.noise_n * math.sqrt(1.0 + SURE_ERRORS * math.sqrt(2.0 / len(values))), 0.5 * motion.step_n)
    power = rms(centred(values)) ** 2 - noise_n**2
    return max(_moved(values, motion.noise_n), 2.0 * math.sqrt(2.0 * max(power, 0.0)))


def _gone(values: Series) -> float:
    """Return how far the force goes [N] from eighth to eighth, if it goes farther in the later half; otherwise 0."""
    part = max(1, len(values) // _WINDOWS)
    middle = (len(values) - part) // 2
    first, then, last = (float(np.cumsum(values[k : k + part])[-1]) / part for k in (0, middle, len(values) - part))
    return abs(last - first) if (last - then) * (last - first) > 0.5 * (last - first) ** 2 else 0.0


def _falls_as_noise(values: Series, noise_n: float) -> bool:
    """Return whether the density of a motion falls from octave to octave as 1/f noise does, and no line stands out.

    A cycle has a line, and one that is irregular has a band; the density of noise is greatest where it begins. It may
    come to the white noise of the read-out.
    """
    count = len(values)
    window = 0.5 - 0.5 * np.cos(2.0 * np.pi * (np.arange(count) + 0.5) / count)
    power = np.abs(np.fft.rfft(centred(values) * window)) ** 2 / float(np.cumsum(window * window)[-1])
    octaves = [power[2**k : 2 ** (k + 1)] for k in range(1, int(math.log2(len(power))))]
    # of the white part the density is the variance
    above = [own for own in octaves if float(own.mean()) > _WHITE_OVER * noise_n * noise_n]
    if len(above) < _OCTAVES or len(above) != len(octaves[: len(above)]):
        return False
    levels = [math.log(float(own.mean())) for own in above]
    steps = [before - after for before, after in pairwise(levels)]
    # the logarithms of the means of n and 2 n neighbours under this window differ by so much, by chance
    errors = [SURE_ERRORS * math.sqrt(3.0 / (len(own) - 0.5)) for own in above]
    falls = all(-error < step < _STEEPEST + error for step, error in zip(steps, errors, strict=False))
    slope = (levels[0] - levels[-1]) / (len(levels) - 1)
    return bool(falls and 0.25 * _STEEPEST < slope < _STEEPEST and not any(map(_has_line, above)))


def _has_line(power: Series) -> bool:
    """Return whether a line stands out of the density of an octave as noise makes it once in a thousand times."""
    at = int(np.argmax(power))
    others = np.concatenate([power[: max(at - 1, 0)], power[at + 2 :]])
    # this number of them are independent under this window
    count = len(others) / 1.5
    if count < 2.0:
        return False
    # the ratio of an exponential number to the mean of others exceeds x with the probability (1 + x / count)^-count
    most = count * ((len(power) * math.exp(_LINE_NATS)) ** (1.0 / count) - 1.0)
    # within an octave the density of 1/f noise differs from its mean by 1.4
    return bool(power[at] > 1.4 * most * others.mean())


def _recurs(sizes: list[float], small_n: float) -> bool:
    """Return whether a motion began at least twice after a rest, as a cycle of snaps does, and a landing does not."""
    return sum(before <= small_n and after > 2.0 * small_n for before, after in pairwise(sizes)) >= LEAST_TURNS


def _moved(values: Series, noise_n: float) -> float:
    """Return how far a force goes [N], less what white noise of as many samples reaches once in a thousand times."""
    return max(float(np.ptp(values)) - 2.0 * reach_of(noise_n, len(values)), 0.0)


def reach_of(noise_n: float, count: int) -> float:
    """Return what white noise of a standard deviation [N] reaches to one side in a number of samples [N]."""
    return noise_n * (math.sqrt(2.0 * math.log(max(count, 2))) + 1.0)


def noise_of(values: Series, step_n: float) -> float:
    """Return the standard deviation of the noise of a read-out [N], of which a step that it rounds to is a part."""
    return max(noise_floor(values) if len(values) >= LEAST_SAMPLES else 0.0, step_n / math.sqrt(12.0))


def _even(time_s: Series, force_n: Series) -> tuple[Series, float]:
    """Return the force on an even grid of as many samples, and its period [s]; messages come when they come."""
    grid = np.linspace(time_s[0], time_s[-1], len(time_s))
    period_s = float(time_s[-1] - time_s[0]) / (len(time_s) - 1)
    if float(np.abs(time_s - grid).max()) <= 1e-6 * period_s:
        return np.asarray(force_n, dtype=np.float64), period_s
    return np.interp(grid, time_s, force_n), period_s


def _in_words(found: Finding, noise_n: float) -> Verdict:
    """Return a finding with its sentence."""
    growth, size_n = found.growth_per_s, found.size_n
    return Verdict(found.kind, growth, size_n, noise_n, _sentence(found, noise_n), found.rest_from_s, found.cause)


def _sentence(found: Finding, noise_n: float) -> str:
    moved, rate = f"{found.decisive_n:.3g} N", found.growth_per_s or 0.0
    turns = f" at {found.frequency_hz:.3g} Hz" if found.frequency_hz else ""
    swing = f"{moved} to one side" if found.frequency_hz == 0.0 else f"{moved} from peak to peak{turns}"
    left = f", {found.decisive_n:.2g} N are left" if found.decisive_n >= 1e-6 else ""
    less = f" or noise of less than {found.needs_noise_n:.2g} N" if found.needs_noise_n else ""
    cycle = f"a motion of {found.size_n:.3g} N from peak to peak"
    few = f"a motion of {found.size_n:.2g} N: a longer hold" if found.samples >= LEAST_SAMPLES else "it"
    sentences = {
        Cause.NOT_A_NUMBER: "the force is no number from some time on",
        Cause.FEW_SAMPLES: f"{found.samples} samples were taken of {few}"
        + (" would decide" if few != "it" else f": {LEAST_SAMPLES} or more would decide"),
        Cause.HIDDEN_BY_NOISE: f"noise of {noise_n:.2g} N hides what moves: a read-out with less than "
        f"{found.needs_noise_n:.2g} N would decide",
        Cause.LIKE_NOISE: f"{cycle} has no line and falls with the frequency as 1/f noise does: a read-out and a hand "
        "with less would decide",
        Cause.ON_ITS_WAY: f"the force was on its way, {moved}: a hold of {found.needs_s:.2g} s or more would decide",
        Cause.CHANGE_UNKNOWN: f"a motion of {swing} changes by {rate:.2g} ± {found.error_per_s:.2g}/s: a hold of "
        f"{found.needs_s:.2g} s or more{less} would decide",
        Cause.IRREGULAR_UNKNOWN: f"{cycle} continues irregularly: a longer hold would decide",
        Cause.WITHIN_A_STEP: f"{cycle} is no larger than a step of the read-out: steps of less than "
        f"{found.needs_noise_n:.2g} N would decide",
        Cause.GROWS: f"a motion of {swing} grows by {rate:.3g}/s",
        Cause.GOES_ON: f"{cycle}{turns} neither grows nor dies out",
        Cause.IRREGULAR: f"{cycle} continues irregularly",
        Cause.AT_REST: f"at rest but for {found.decisive_n:.2g} N from peak to peak" if found.decisive_n else "at rest",
        Cause.DIES_OUT: f"the motion dies out by {-rate:.3g}/s{left}",
        Cause.MOVED: f"nothing swings, and the force moves by {found.decisive_n:.2g} N to one side",
        Cause.TO_THE_REST: f"the force goes to the rest of the law, {found.decisive_n:.2g} N are left",
    }
    return sentences[found.cause]
