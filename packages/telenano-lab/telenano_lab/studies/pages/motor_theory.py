"""Poles and bandwidth of the paper's motor under its position servo (Eq. 2)."""

import math

from telenano.hand import MotorParams


def closed_loop_poles(params: MotorParams) -> tuple[complex, complex]:
    """Return the poles [rad/s] of M(s), Eq. 2, the slower one first (E1: -8.281 and -900.8 for the printed gain)."""
    a2, b = params.closed_loop_coefficients()
    discriminant = 0.25 * b * b - a2
    if discriminant < 0.0:
        w = math.sqrt(-discriminant)
        return complex(-0.5 * b, w), complex(-0.5 * b, -w)
    fast = -0.5 * b - math.sqrt(discriminant)
    # The slower pole is computed by the product a^2 of the poles, because a difference would lose its digits.
    return complex(a2 / fast), complex(fast)


def bandwidth_hz(params: MotorParams) -> float:
    """Return the -3 dB bandwidth [Hz] of M(s), Eq. 2: |M(i w)|^2 = 1/2 (E1: 1.318 Hz for the printed gain)."""
    a2, b = params.closed_loop_coefficients()
    p = 2.0 * a2 - b * b
    root = math.hypot(p, 2.0 * a2)
    # Both forms are the positive root of w^4 - p w^2 - a^4 = 0; each is used where no digits cancel.
    w2 = 0.5 * (p + root) if p >= 0.0 else 2.0 * a2 * a2 / (root - p)
    return math.sqrt(w2) / (2.0 * math.pi)
