"""Contacts of a tip at the end of a spring: the force on the tip at each place of the base.

    F = k (x - x0 - d),   F = F(d)

x is the place of the base towards the sample, x0 the one at which the undeflected tip touches the undeformed surface, d
the indentation and k the spring constant. F and d are functions of one variable s, and so is the place of the base,
which is inverted by Newton steps between bounds. E* is the reduced modulus, R the radius of the tip:

| model | s | d | F | source |
|---|---|---|---|---|
| hertz | sqrt(d) | s^2 | 4/3 E* sqrt(R) s^3 | H. Hertz, J. reine angew. Math. 92 (1882) 156 |
| sneddon | d | s | 2/pi E* tan(half angle) s^2 | I. N. Sneddon, Int. J. Eng. Sci. 3 (1965) 47 |
| dmt | sqrt(d) | s^2 | that of Hertz, less the pull-off | B. V. Derjaguin and others, JCIS 53 (1975) 314 |
| jkr | sqrt(a) | s^4/R - sqrt(4 P/(3 R E*)) s | K s^6 - 2 sqrt(K P) s^3, K = 4 E*/(3 R) | K. L. Johnson, 1971 |

a is the radius of the contact and P the pull-off, 2 pi w R of DMT and 3/2 pi w R of JKR. A sample of thickness h bonded
to a hard ground presses more than Hertz, by the factor 1 + 1.133 c + 1.283 c^2 + 0.769 c^3 + 0.0975 c^4 with
c = sqrt(R d)/h, for a Poisson ratio of 0.5 (E. K. Dimitriadis and others, Biophys. J. 82 (2002) 2798).

The code uses only arithmetic and square roots in a fixed order, so that every processor gives the same bits.
"""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from telenano.numerics import compiled

Array = npt.NDArray[np.float64]

HERTZ, SNEDDON, DMT, JKR = range(4)
MODELS = {"hertz": HERTZ, "sneddon": SNEDDON, "dmt": DMT, "jkr": JKR}
_MOST_STEPS = 80
# The inversion ends when s changes by less than this share of itself.
_ENOUGH = 1e-13


class Contact(NamedTuple):
    """A contact: model number, R [m], tangent of the half angle, spring constant [N/m], E* [Pa], pull-off [N], 1/h.

    per_thickness_per_m is 1/h [1/m], 0 for a thick sample.
    """

    model: int
    radius_m: float
    tangent: float
    stiffness_n_per_m: float
    modulus_pa: float
    pull_off_n: float
    per_thickness_per_m: float


@compiled
def at(contact: Contact, s: float) -> tuple[float, float, float, float]:
    """Return indentation [m] and force [N] at a value of s, and their derivatives by s."""
    e, r = contact.modulus_pa, contact.radius_m
    if contact.model == 1:
        b = 2.0 / math.pi * e * contact.tangent
        return s, b * s * s, 1.0, 2.0 * b * s
    if contact.model == 3:
        k = 4.0 * e / (3.0 * r)
        pull = max(contact.pull_off_n, 0.0)
        c, d = 2.0 * math.sqrt(k * pull), math.sqrt(4.0 * pull / (3.0 * r * e))
        cube = s * s * s
        return (
            s * cube / r - d * s,
            k * cube * cube - c * cube,
            4.0 * cube / r - d,
            6.0 * k * cube * s * s - 3.0 * c * s * s,
        )
    a = 4.0 / 3.0 * e * math.sqrt(r)
    c = math.sqrt(r) * contact.per_thickness_per_m * s
    factor = 1.0 + c * (1.133 + c * (1.283 + c * (0.769 + c * 0.0975)))
    # s times the derivative of the factor
    slope = c * (1.133 + c * (2.0 * 1.283 + c * (3.0 * 0.769 + c * 4.0 * 0.0975)))
    pull = contact.pull_off_n if contact.model == 2 else 0.0
    return s * s, a * s * s * s * factor - pull, 2.0 * s, a * s * s * (3.0 * factor + slope)


@compiled
def _base(contact: Contact, s: float) -> tuple[float, float]:
    """Return the place of the base from the touch [m] at a value of s, and its derivative by s."""
    depth, force, depth_slope, force_slope = at(contact, s)
    return depth + force / contact.stiffness_n_per_m, depth_slope + force_slope / contact.stiffness_n_per_m


@compiled
def end_of(contact: Contact) -> float:
    """Return the s at which the contact ends on retraction: 0, or for JKR the end of its equilibria."""
    if contact.model != 3 or not contact.pull_off_n > 0.0:
        return 0.0
    # The upper bound is s at the greatest pull; under controlled displacement the contact ends below it.
    high = math.sqrt(_cube_root(contact.pull_off_n * 3.0 * contact.radius_m / (4.0 * contact.modulus_pa)))
    low = 0.0
    for _ in range(200):
        middle = 0.5 * (low + high)
        if _base(contact, middle)[1] < 0.0:
            low = middle
        else:
            high = middle
    return high


@compiled
def _cube_root(value: float) -> float:
    """Return the cube root of a positive number by Newton steps, using arithmetic alone."""
    guess = 1.0
    while guess * guess * guess < value:
        guess *= 2.0
    while guess * guess * guess > value:
        guess *= 0.5
    for _ in range(8):
        guess = (2.0 * guess + value / (guess * guess)) / 3.0
    return guess


@compiled
def forces(contact: Contact, touch_m: float, base_m: Array, out_n: Array, depth_m: Array) -> None:
    """Fill the forces [N] and indentations [m] at places of the base [m]; before the touch both are 0.

    An adhesive contact is followed on retraction to its end. Beyond that the force falls quadratically from the end,
    so that a fit whose contact ends before that of the curve is led back without an edge.
    """
    k, count = contact.stiffness_n_per_m, base_m.shape[0]
    soft_m = 0.02 * abs(base_m[count - 1] - base_m[0]) + 1e-15
    first = end_of(contact)
    first_base = _base(contact, first)[0]
    first_depth, first_force, _, _ = at(contact, first)
    pulls = contact.model >= 2
    s = first
    for i in range(base_m.shape[0]):
        x = base_m[i] - touch_m
        if x <= first_base:
            depth_m[i] = first_depth
            beyond = x - first_base
            out_n[i] = first_force - k * beyond * beyond / soft_m if pulls else 0.0
            continue
        low, high = first, max(2.0 * s, 1e-9)
        while _base(contact, high)[0] < x:
            low, high = high, 2.0 * high
        s = min(max(s, low), high)
        for _ in range(_MOST_STEPS):
            place, slope = _base(contact, s)
            if place < x:
                low = s
            else:
                high = s
            new = s - (place - x) / slope if slope > 0.0 else high
            if not low < new < high:
                new = 0.5 * (low + high)
            moved = abs(new - s)
            s = new
            if moved <= _ENOUGH * s:
                break
        depth_m[i], out_n[i], _, _ = at(contact, s)
