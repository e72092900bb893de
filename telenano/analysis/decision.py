"""What a motion does, by the modes of all of it and of its last parts, and by its envelope.

A fit is believed where it leaves noise alone and no mode bends away from its exponential. Where it is not, the last
half, quarter and eighth are fitted: a blow, a landing and a growth that has reached its limit come before that. A short
part knows a growth less well than the whole: it decides only what it surely tells otherwise (`beside`). What no modes
explain is judged by its envelope. A motion is at rest, and goes on, only if its end is and does: a swing that may last
is at rest only in a part that would show it, and what goes on by a fit that leaves more than noise may surely die out
in a later part.
"""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from telenano.analysis.beyond_noise import checked
from telenano.analysis.envelope import WINDOWS, by_envelope, envelope_of, recurs, sizes_of, turns_of
from telenano.analysis.findings import Cause, Finding, on_its_way
from telenano.analysis.modes import LEAST_SAMPLES, LINE_OVER_NOISE, Mode, centred, rms
from telenano.analysis.motion_fit import (
    MAY_LAST,
    Fate,
    Motion,
    Window,
    cancels,
    classify,
    decided_by_modes,
    explains,
    fits_to_the_end,
    leaves_noise,
    modes_near,
)
from telenano.analysis.read_out import gone_of, line_n
from telenano.analysis.verdict_thresholds import (
    ERROR_SHARE,
    LEAST_CHANGE,
    LEAST_TURNS,
    SMALL_SHARE,
    SURE_ERRORS,
)

Series = npt.NDArray[np.float64]
# the last shares of a motion that are fitted, all of it first
TAILS = (1.0, 0.5, 0.25, 0.125)
# a motion that is there is as large as what a fit leaves [1]; sizes of few turns err by a third
_SHOWN_OVER_LEFT = 1.5
# a way is half of what is left, in power, where it is this multiple of its root mean square [1]
_WAY_OVER_LEFT = 2.5


def decide(motion: Motion) -> Finding:
    """Judge by the modes of the motion and of its last parts, and by its envelope where these may be wrong.

    | the modes                                      | the envelope                                    | counts        |
    |---|---|---|
    | decide                                         | is not looked at                                | what they say |
    | are in doubt, and their fit may be wrong       | moves or dies out, and is mostly of that motion | the envelope  |
    | are in doubt otherwise                         | is anything                                     | the doubt     |
    | explain nothing, and a swing in them may last  | is at rest, and would not show that swing       | a doubt       |
    | explain nothing                                | is anything else                                | the envelope  |
    """
    found, doubt, parts = by_parts(motion)
    if found is not None:
        return checked(found, motion, parts[-1])
    return checked(_in_doubt(motion, doubt, parts), motion, None)


def _in_doubt(motion: Motion, doubt: "Doubt | None", parts: list[Window]) -> Finding:
    """Return what the envelope says of a motion that no modes decide."""
    envelope = by_envelope(motion)
    if doubt is not None:
        return envelope if _settles(envelope, doubt) else doubt.found
    return _hidden_in(envelope, parts, motion) or envelope


def _hidden_in(envelope: Finding, parts: list[Window], motion: Motion) -> Finding | None:
    """Return the doubt about a swing that may last in an envelope at rest, which would not show it; None of none."""
    swing_n, at_hz = _lasting(parts, MAY_LAST) if envelope.cause is Cause.AT_REST else (0.0, 0.0)
    last = motion.values[-max(2, len(motion.values) // 4) :]
    if not swing_n or shown_beside(swing_n, at_hz, last, motion.period_s * len(last)):
        return None
    needs_n = SMALL_SHARE * motion.hand_n
    cause = Cause.WITHIN_A_STEP if needs_n < swing_n <= motion.small_n else Cause.IRREGULAR_UNKNOWN
    return Finding("cannot_say", cause, swing_n, envelope.growth_per_s, swing_n, needs_noise_n=needs_n)


def _settles(envelope: Finding, doubt: "Doubt") -> bool:
    """Return whether an envelope decides what is in doubt: it moves or dies out, and is mostly of that motion."""
    growth, error = doubt.found.growth_per_s or 0.0, SURE_ERRORS * doubt.found.error_per_s
    is_cycle = envelope.kind == "limit_cycle" and growth + error >= 0.0
    # The motion that dies out is another one where that in doubt grows.
    falls = envelope.cause is Cause.DIES_OUT and growth < 0.0
    is_motion = is_cycle or falls or envelope.kind == "diverged"
    is_of_it = doubt.found.decisive_n > 0.5 * envelope.size_n
    return doubt.found.cause is Cause.CHANGE_UNKNOWN and doubt.may_be_wrong and is_motion and is_of_it


class Doubt(NamedTuple):
    """What the first fit that explains a motion cannot say, and whether that fit may be wrong.

    It may be where it leaves more than noise, or has a motion grow, or change by less than 0.3: what grows comes to a
    limit. A fit that leaves noise alone, of a motion that dies out slowly, says itself how little is known.
    """

    found: Finding
    may_be_wrong: bool


def by_parts(motion: Motion) -> tuple[Finding | None, Doubt | None, list[Window]]:
    """Return what the modes of the motion say, or of the first of its last parts that decides; else the doubt.

    The parts are returned as well, of which none decided.
    """
    doubt: Doubt | None = None
    swings_hz: list[float] = []
    earlier: list[Window] = []
    for share in TAILS:
        window = motion.last(share)
        # less than half of a motion shows too little of a force on its way
        is_short = share < TAILS[1] and doubt is not None and doubt.found.cause is Cause.ON_ITS_WAY
        if window is None or is_short:
            break
        found = _of_part(motion, window)
        if not earlier:
            swings_hz = _lasting_hz(window)
        elif found is not None and _hides(motion, window, found, earlier, swings_hz):
            break
        else:
            found = beside(earlier, found, window, motion)
        earlier.append(window)
        if found is None:
            continue
        if found.kind != "cannot_say" and (doubt is None or _overrules(found, doubt, window, share)):
            return _at_the_end(motion, found, window, share), None, earlier
        may_be_wrong = _may_be_wrong(found, window) if doubt is None else doubt.may_be_wrong
        doubt = Doubt(found if doubt is None else doubt.found, may_be_wrong or not leaves_noise(window))
        if found.frequency_hz and doubt.found is found and found.cause is not Cause.ON_ITS_WAY:
            swings_hz = [*swings_hz, found.frequency_hz]
    return None, doubt, earlier


def beside(earlier: list[Window], found: Finding | None, window: Window, motion: Motion) -> Finding | None:
    """Return what a last part says beside the parts that it is in the end of; None where it says nothing new.

    | the part                             | the parts before it                                 | it says             |
    |---|---|---|
    | is at rest                           | show a swing that it would not                      | nothing             |
    | goes on, or grows, by too many modes | are anything                                        | a doubt             |
    | goes on, or grows                    | fall twice, and it does not surely change otherwise | what the first says |
    | goes on, or grows                    | fall once, and it does not surely change otherwise  | a doubt             |
    | is anything else                     | are anything                                        | what it says        |

    Modes are too many where each has fewer than LEAST_SAMPLES: they would fit any noise.
    """
    if found is None:
        return None
    if found.kind == "stable":
        falls = (
            found.cause is Cause.DIES_OUT and leaves_noise(window) and not cancels(window) and _is_less_at_end(motion)
        )
        lasting_n, at_hz = (0.0, 0.0) if falls else _lasting(earlier, MAY_LAST)
        return None if lasting_n and not _shows_rest(found, lasting_n, at_hz, window) else found
    if found.kind != "cannot_say" and len(window.fit.left) < LEAST_SAMPLES * len(window.fit.modes):
        return _as_doubt(found, window)
    if not _falls_as_before(found, window, earlier):
        return found
    before = [decided_by_modes(own) for own in earlier if explains(own, motion.hand_n)]
    stable = [own for own in before if own.kind == "stable"]
    return stable[0] if len(stable) > 1 else _as_doubt(found, window)


def _is_less_at_end(motion: Motion) -> bool:
    """Return whether a motion is smaller in its last window than in the one before; one of few turns does not show."""
    turns = turns_of(motion.values)
    sizes = envelope_of(motion.values, motion, turns)
    return turns < WINDOWS or sizes[-1] < sizes[-2]


def _as_doubt(found: Finding, window: Window) -> Finding:
    return found._replace(kind="cannot_say", cause=Cause.CHANGE_UNKNOWN, needs_s=2.0 * window.length_s)


def _falls_as_before(found: Finding, window: Window, earlier: list[Window]) -> bool:
    """Return whether what goes on or grows in a last part may change there as it surely dies out before."""
    if found.kind not in ("limit_cycle", "diverged") or not found.frequency_hz:
        return False
    near = [(mode, own) for own in earlier for mode in modes_near(own, found.frequency_hz, 1.0 / window.length_s)]
    falling = [
        mode for mode, own in near if mode.end_n > 0.5 * found.decisive_n and classify(mode, own) is Fate.FALLING
    ]
    return bool(falling) and not _grows_more(found.growth_per_s or 0.0, found.error_per_s, falling[0])


def _grows_more(growth_per_s: float, error_per_s: float, mode: Mode) -> bool:
    """Return whether a growth is surely larger than that of a mode."""
    return growth_per_s - mode.growth_per_s > SURE_ERRORS * math.hypot(error_per_s, mode.error_per_s)


def _at_the_end(motion: Motion, found: Finding, window: Window, share: float) -> Finding:
    """Return a finding, or that of a later part by which the motion surely dies out where its fit is not sure."""
    if found.kind not in ("limit_cycle", "diverged") or not found.frequency_hz or leaves_noise(window):
        return found
    for later_share in TAILS:
        later = motion.last(later_share) if later_share < share else None
        if later is None or later.length_s * found.frequency_hz < LEAST_TURNS:
            continue
        if not leaves_noise(later) or not explains(later, motion.hand_n) or cancels(later):
            continue
        own, near = decided_by_modes(later), modes_near(later, found.frequency_hz, 1.0 / later.length_s)
        differs = any(_grows_more(found.growth_per_s or 0.0, found.error_per_s, mode) for mode in near)
        if own.kind == "stable" and (own.growth_per_s or 0.0) < 0.0 and differs:
            return own
    return found


def _lasting_hz(window: Window) -> list[float]:
    """Return the frequencies of the large swings of a motion that do not die out."""
    lasts = -LEAST_CHANGE / window.length_s
    large = [mode for mode in window.fit.modes if mode.end_n > window.small_n and mode.growth_per_s > lasts]
    return [mode.frequency_hz for mode in large if mode.frequency_hz * window.length_s >= 1.0]


def _of_part(motion: Motion, window: Window) -> Finding | None:
    """Return what the modes of a part say; None where they do not explain it."""
    if not explains(window, motion.hand_n):
        return None
    found = decided_by_modes(window)
    if found.kind != "stable" and leaves_noise(window) and cancels(window):
        return None
    if _is_open(found, window) and not fits_to_the_end(window):
        return None
    gone_n = gone_of(window.values) if found.kind == "stable" and not window.fit.modes else 0.0
    if gone_n > max(ERROR_SHARE * motion.hand_n, _WAY_OVER_LEFT * rms(window.fit.left)):
        # that is no swing and no exponential, more than an instrument drifts, and does not come to rest
        found = on_its_way(found, gone_n, 4.0 * window.length_s)
    if found.cause is Cause.ON_ITS_WAY and motion.rest_n is not None:
        found = approaching(found, window.values, motion.rest_n)
    if found.kind == "stable" and len(window.values) == len(motion.values):
        return _swing_at_the_end(motion, window) or found
    return found


def _may_be_wrong(found: Finding, window: Window) -> bool:
    rate, error = found.growth_per_s or 0.0, SURE_ERRORS * found.error_per_s
    return rate > 0.0 or abs(rate) + error < 2.0 * LEAST_CHANGE / window.length_s


def _overrules(found: Finding, doubt: Doubt, window: Window, share: float) -> bool:
    """Return whether a last part decides what the whole leaves in doubt: by rest, or by a fit where that was wrong."""
    if _shows_rest(found, doubt.found.size_n, doubt.found.frequency_hz or 0.0, window):
        return True
    is_long = found.kind == "limit_cycle" or share == TAILS[1]
    return is_long and doubt.may_be_wrong and leaves_noise(window)


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


def _hides(motion: Motion, window: Window, found: Finding, earlier: list[Window], swings_hz: list[float]) -> bool:
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
        slowest_hz = min(slowest_hz, turns_of(half) / (motion.period_s * len(half)))
    return slowest_hz * window.length_s < LEAST_TURNS or recurs(sizes_of(motion), motion.small_n)


def _swing_at_the_end(motion: Motion, window: Window) -> Finding | None:
    """Return what the last half says of a large swing, of a motion whose fit leaves more than noise; else None.

    Where the fit of the half leaves more than noise as well, that it goes on or grows is a doubt.
    """
    left_n = 2.0 * math.sqrt(2.0) * window.left_n
    half = motion.last(TAILS[1]) if left_n > motion.small_n and not leaves_noise(window) else None
    if half is None or not explains(half, motion.hand_n):
        return None
    found = decided_by_modes(half)
    if found.kind in ("limit_cycle", "diverged"):
        return found if leaves_noise(half) else _as_doubt(found, half)
    # A fit that leaves noise alone knows a swing by one turn. What stands out for less may be a hand that wanders.
    is_swing = (found.frequency_hz or 0.0) * half.length_s >= (0.5 if leaves_noise(half) else 1.0) * LEAST_TURNS
    is_seen = any(half.cycles(mode) >= 1.0 for mode in half.fit.modes if mode.end_n > motion.small_n)
    # a line that is found in what is left has this size
    found_n = 4.0 * math.sqrt(2.0 * LINE_OVER_NOISE / len(half.fit.left)) * half.left_n
    last = half.values[len(half.values) // 2 :]
    stays_n = 2.0 * line_n(last, 0.5 * (found.frequency_hz or 0.0) * half.length_s)
    is_large = min(found.decisive_n, stays_n) > max(motion.small_n, found_n)
    return found if found.kind == "cannot_say" and is_swing and is_seen and is_large else None


def _shows_rest(found: Finding, swing_n: float, frequency_hz: float, window: Window) -> bool:
    """Return whether a last part is at rest that would show a swing of a size and a frequency."""
    at_rest = found.kind == "stable" and found.rest_from_s is not None
    near = modes_near(window, frequency_hz, 1.0 / window.length_s) if frequency_hz else []
    if any(mode.end_n > 0.5 * swing_n and mode.frequency_hz for mode in near):
        # it is there, and no part of what is left
        return False
    return at_rest and shown_beside(swing_n, frequency_hz, window.fit.left, window.length_s)


def shown_beside(swing_n: float, frequency_hz: float, left: Series, length_s: float) -> bool:
    """Return whether a swing would be seen: what is left is smaller, or is as large and has little at its frequency."""
    left_n = 2.0 * math.sqrt(2.0) * rms(centred(left))
    if swing_n > _SHOWN_OVER_LEFT * left_n or frequency_hz * length_s < 1.0:
        return swing_n > _SHOWN_OVER_LEFT * left_n
    # the frequency is not known better than to half a turn in the part
    lines_n = [line_n(left, frequency_hz * length_s + 0.25 * k) for k in range(-2, 3)]
    return swing_n > left_n / _SHOWN_OVER_LEFT and max(lines_n) < 0.5 * swing_n


def _lasting(parts: list[Window], fates: tuple[Fate, ...]) -> tuple[float, float]:
    """Return size and frequency of the largest swing at the end of parts that has one of these fates; 0 of none."""
    modes = [(mode, own) for own in parts for mode in own.fit.modes]
    swings = [(mode, own) for mode, own in modes if mode.frequency_hz * own.length_s >= LEAST_TURNS]
    # the first line of a motion between two forces is larger than the motion
    large = [(mode, own) for mode, own in swings if min(mode.end_n, float(np.ptp(own.last))) > own.unrounded_n]
    lasting = [mode for mode, own in large if classify(mode, own) in fates]
    return max(((mode.end_n, mode.frequency_hz) for mode in lasting), default=(0.0, 0.0))


def approaching(found: Finding, values: Series, rest_n: float) -> Finding:
    """Return a finding that a force is on its way, which is stable if it goes to the rest of the law."""
    part = max(1, len(values) // 20)
    off_n = [abs(float(np.cumsum(own)[-1]) / part - rest_n) for own in (values[:part], values[-part:])]
    if off_n[1] > off_n[0] * math.exp(-2.0 * LEAST_CHANGE):
        return found
    return found._replace(kind="stable", cause=Cause.TO_THE_REST, decisive_n=off_n[1])
