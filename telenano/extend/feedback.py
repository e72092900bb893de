"""The proportional-integral feedback of an image, and its stability limits.

The error e is a length [m], positive if the base must move towards the sample: the amplitude of a tapping tip minus its
set-point, or the set-point minus the deflection in contact. After each period T the base x moves to

    x' = x + Ki T e + Kp (e - e_before),       Ki in 1/s, Kp without a unit,

which is Kp e plus an integral that begins where the base is. The part Kp e in the base is stored instead of e_before:
if a limit of speed or range holds the base back, that part is reduced first, and the integral never exceeds the base
(anti-windup).

A rigid sample is the critical case: if the base moves by b, the error changes by -b; on a softer sample it changes less
and the loop is further from its limit. In contact e responds within the period, so z^2 + (Ki T + Kp - 1) z - Kp = 0,
whose roots lie within the unit circle (Jury) for Kp < 1 and

    Ki T < 2 (1 - Kp).

In tapping mode the amplitude settles as exp(-t pi f / Q) and is read before it has settled: with r = exp(-pi f T / Q)
it contains 1 - r of the move one period ago, so z^3 - (1 + r) z^2 + (r + (1 - r)(Ki T + Kp)) z - (1 - r) Kp = 0, whose
roots lie within the circle by Jury's conditions for (1 - r) Kp < 1 and

    Ki T < (1 + Kp) (1 - (1 - r) Kp).

A reading that contains part of the last move is further from this limit. The amplitude of a real tip responds by more
than the motion of the base if attraction or a high Q bends its curve: of tips of 40 N/m and Q from 100 to 1000 the
first to oscillate had two thirds of these gains. In tapping mode, gains are therefore refused if 1.5 times their value
would be unstable.

A feedback that acts as often as the drive meets another limit first: amplitude and phase respond together, as
K / (s^2 + 2 s b + K) with b = pi f / Q and a K that depends on the sample. Then s^3 + 2 b s^2 + K (1 + Kp) s + K Ki is
stable (Routh) for any K if

    Ki < 2 (1 + Kp) pi f / Q,

18.8e3/s for Table 2 and Kp = 1. Images of the simulated tip begin to oscillate at 0.8 to 1.3 times this limit without
Kp, and with it at 0.4 times (set-point 0.5) to more than this limit (set-point 0.95).
"""

import math

from telenano.numerics.compiler import compiled

# Safety factors by which gains are multiplied before they are compared with the limit of their mode.
CONTACT_MARGIN = 1.0
TAPPING_MARGIN = 1.5
# Greatest integral share of a late step, as a fraction of the stability limit of its mode.
_CONTACT_SHARE = 0.45
_TAPPING_SHARE = 0.5


@compiled
def feedback_step(
    base_m: float, proportional_m: float, error_m: float, integral_share: float, proportional: float
) -> tuple[float, float]:
    """Return the new base position [m], and its proportional part [m].

    Without a proportional gain that part is 0, and the base has the same bits as that of a purely integral feedback.

    Args:
        base_m: The present base position [m].
        proportional_m: The proportional part in it [m].
        error_m: The error of the regulated height [m].
        integral_share: The integral gain over a period, Ki T.
        proportional: The proportional gain.
    """
    part_m = proportional * error_m
    return base_m + error_m * integral_share + (part_m - proportional_m), part_m


@compiled
def carried_out(proportional_m: float, missing_m: float) -> float:
    """Return the proportional part [m] of a base that a limit has stopped `missing_m` [m] before its target."""
    if proportional_m > 0.0:
        return proportional_m - min(max(missing_m, 0.0), proportional_m)
    return proportional_m - max(min(missing_m, 0.0), proportional_m)


def most_integral_share(proportional: float, lag: float | None) -> float:
    """Return the Ki T at which the loop becomes unstable; 0 or less if it is unstable for any Ki.

    Args:
        proportional: The proportional gain.
        lag: None in contact; in tapping mode r, the share of a change of the amplitude that remains after a period.
    """
    if lag is None:
        return 2.0 * (1.0 - proportional)
    return (1.0 + proportional) * (1.0 - (1.0 - lag) * proportional)


def integral_share(gain_per_s: float, proportional: float, period_s: float, lag: float | None, dt: float) -> float:
    """Return Ki T of a step of `dt` [s], limited if the step is late; other arguments as in `gain_fault`."""
    share = _CONTACT_SHARE if lag is None else _TAPPING_SHARE
    greatest = max(share * most_integral_share(proportional, lag), gain_per_s * period_s)
    return min(gain_per_s * dt, greatest)


def gain_fault(
    gain_per_s: float, proportional: float, period_s: float, lag: float | None, names: tuple[str, str]
) -> str:
    """Return a sentence on a gain that makes the loop unstable, with the greatest valid value; empty if both are valid.

    Args:
        gain_per_s: The integral gain [1/s], positive and finite.
        proportional: The proportional gain, finite and not negative.
        period_s: The period of the feedback [s].
        lag: The lag, as in `most_integral_share`.
        names: The user's names of the integral and the proportional gain; the second is empty if there is none.
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
    """Return r = exp(-pi f T / Q), the share of a change of the amplitude that remains after a period T [s]."""
    return math.exp(-math.pi * resonance_hz * period_s / quality)
