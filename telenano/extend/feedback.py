"""The feedback of an image, proportional and integral, and its stability.

The error e is a length [m], positive where the base is to go towards the sample: the amplitude of a tapping tip above
its set-point, or the deflection in contact below its own. After each period T the base x goes to

    x' = x + Ki T e + Kp (e - e_before),       Ki in 1/s, Kp without a unit,

which is Kp e beside an integral that begins where the base is. The part Kp e that is in the base is kept instead of
e_before: where a limit of speed or range holds the base back, that part gives way first, and the integral goes no
further than the base (anti-windup).

A rigid sample is the quickest: a base that moves by b changes the error by -b, on a softer one by less, with which the
loop is further from its limit. In contact e answers within the period, so z^2 + (Ki T + Kp - 1) z - Kp = 0, whose roots
lie within the unit circle (Jury) for Kp < 1 and

    Ki T < 2 (1 - Kp).

In tapping mode the amplitude follows as exp(-t pi f / Q), and is read before it has: with r = exp(-pi f T / Q), of the
move a period ago it has 1 - r, and z^3 - (1 + r) z^2 + (r + (1 - r)(Ki T + Kp)) z - (1 - r) Kp = 0, which Jury's
conditions put within the circle for (1 - r) Kp < 1 and

    Ki T < (1 + Kp) (1 - (1 - r) Kp).

A reading that has part of the last move is further from it. The amplitude of a real tip answers by more than the base
moves where attraction or a high Q bends its curve: of tips of 40 N/m and Q from 100 to 1000 the first that swung on had
two thirds of these gains. So in tapping mode gains are refused that would be unstable when 1.5 times as great.

A feedback that acts as often as the drive meets another limit first: amplitude and phase answer together, as
K / (s^2 + 2 s b + K) with b = pi f / Q and a K that the sample decides. With it s^3 + 2 b s^2 + K (1 + Kp) s + K Ki is
stable (Routh), whatever K, for

    Ki < 2 (1 + Kp) pi f / Q,

18.8e3/s for Table 2 and Kp = 1. The images of the simulated tip swing on from 0.8 to 1.3 times that without Kp, and
with it from 0.4 times (set-point 0.5) to more than it (0.95).
"""

import math

from telenano.numerics.compiler import compiled

# Gains are multiplied by the margin of their mode before they are compared with the limit.
CONTACT_MARGIN = 1.0
TAPPING_MARGIN = 1.5
# A step that comes late takes the integral no further than this share of the stable limit of its mode.
_CONTACT_SHARE = 0.45
_TAPPING_SHARE = 0.5


@compiled
def feedback_step(
    base_m: float, proportional_m: float, error_m: float, integral_share: float, proportional: float
) -> tuple[float, float]:
    """Return where the base is to go [m], and the proportional part in that [m].

    Without a proportional gain that part is 0, and the base is the same number as without it.

    Args:
        base_m: The base as it is [m].
        proportional_m: The proportional part in it [m].
        error_m: The error of the regulated height [m].
        integral_share: The integral gain in a period, Ki T.
        proportional: The proportional gain.
    """
    part_m = proportional * error_m
    return base_m + error_m * integral_share + (part_m - proportional_m), part_m


@compiled
def carried_out(proportional_m: float, missing_m: float) -> float:
    """Return the proportional part [m] in a base that a limit has kept missing_m [m] short of where it was to go."""
    if proportional_m > 0.0:
        return proportional_m - min(max(missing_m, 0.0), proportional_m)
    return proportional_m - max(min(missing_m, 0.0), proportional_m)


def most_integral_share(proportional: float, lag: float | None) -> float:
    """Return Ki T at which the loop becomes unstable, 0 or less where it is at any.

    Args:
        proportional: The proportional gain.
        lag: None in contact; in tapping mode r, the share of a change of the amplitude that is left after a period.
    """
    if lag is None:
        return 2.0 * (1.0 - proportional)
    return (1.0 + proportional) * (1.0 - (1.0 - lag) * proportional)


def integral_share(gain_per_s: float, proportional: float, period_s: float, lag: float | None, dt: float) -> float:
    """Return Ki T of a step of dt [s], limited where it is late; other arguments as in `gain_fault`."""
    share = _CONTACT_SHARE if lag is None else _TAPPING_SHARE
    greatest = max(share * most_integral_share(proportional, lag), gain_per_s * period_s)
    return min(gain_per_s * dt, greatest)


def gain_fault(
    gain_per_s: float, proportional: float, period_s: float, lag: float | None, names: tuple[str, str]
) -> str:
    """Return which gain is impossible in a loop, and what would be right; empty for none.

    Args:
        gain_per_s: The integral gain [1/s], positive and finite, as the model of the program has it.
        proportional: The proportional gain, 0 or more, and finite.
        period_s: The period of the feedback [s].
        lag: The lag, as in `most_integral_share`.
        names: The names of the integral and of the proportional gain, as the user knows them; the second is empty where
            there is none.
    """
    loop = f"in {'contact' if lag is None else 'tapping'} mode at {1.0 / period_s:g} Hz"
    margin = CONTACT_MARGIN if lag is None else TAPPING_MARGIN
    greatest = 1.0 if lag is None else 1.0 / (1.0 - lag) / margin
    if not proportional < greatest:
        return f"{names[1]} = {proportional:g} makes the feedback unstable {loop}: it must be below {greatest:.4g}"
    most_per_s = most_integral_share(margin * proportional, lag) / margin / period_s
    if lag is not None and lag > 0.0:
        most_per_s = min(most_per_s, -2.0 * (1.0 + proportional) * math.log(lag) / period_s)
    if not gain_per_s < most_per_s:
        beside = f" with {names[1]} = {proportional:g}" if names[1] else ""
        return (
            f"{names[0]} = {gain_per_s:g} 1/s makes the feedback unstable {loop}{beside}:"
            f" it must be below {most_per_s:.6g} 1/s"
        )
    return ""


def remaining(period_s: float, resonance_hz: float, quality: float) -> float:
    """Return r, the share of a change of the amplitude that is still to come after a period [s]."""
    return math.exp(-math.pi * resonance_hz * period_s / quality)
