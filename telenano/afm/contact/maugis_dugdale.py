"""Adhesive elastic contact of a sphere and a flat: Maugis-Dugdale (Eq. 7-11, E5, E6) with its cohesive branch.

Nondimensional: force P in pi w R, indentation D in (pi^2 w^2 R / K^2)^(1/3), radii A (contact) and C (cohesive zone)
in (pi w R^2 / K)^(1/3), K = 4 E* / 3; the transition parameter is lambda (Eq. 8).

With the angle s = arcsec m, m = c/a, and C instead of A, Eq. 9 has only bounded terms and is a quadratic in C:

    (lambda/2) C^2 f1 + (4 lambda^2 / 3) C f2 = 1,   f1 = sin(2s)/2 - s cos(2s),   f2 = s sin s - 1 + cos s      (Eq. 9)
    P = C^3 cos^3 s - lambda C^2 f3,   f3 = sin s cos s + s                                                      (Eq. 7)
    D = C^2 cos^2 s - (4/3) lambda C sin s                                                                      (Eq. 10)

so every contact is one angle in (0, pi/2], without the cancellation of large m. At s = pi/2 the contact radius is zero
and the cohesive branch continues: a uniform stress sigma0 inside radius c lifts the surface by (4/pi) sigma0 c / E* at
r = c, where the gap must be h0 = w / sigma0. Hence

    P = -(pi/2) lambda C^2,   D = C^2/2 - (8 / 3 pi) lambda C - 2 / (pi lambda),

which meets Eq. 7-10 with equal value and slope. It ends where dD/dC = 0, C = 8 lambda / 3 pi: beyond, the surfaces are
apart. That end lies on the contact itself, as a fold of Eq. 7-10, once lambda exceeds 0.938.

Under displacement control the curve from that end to infinite indentation is single valued; `force_at` follows it.
"""

import math
from typing import NamedTuple

from telenano.numerics.compiler import compiled

FOLD_TRANSITION = (9.0 * math.pi / (16.0 * (math.pi - 1.0))) ** (1.0 / 3.0)  # 0.938: the fold enters the contact
HALF_PI = 0.5 * math.pi
_SERIES_BELOW = 0.5
# Relative difference in the last digit of a double.
_LAST_DIGIT = 2e-16
_MOST_NEWTON_STEPS = 50


class MaugisDugdale(NamedTuple):
    """Transition parameter and units of one contact; `MaugisDugdale.of` makes it from physical properties."""

    transition: float  # lambda
    force_unit_n: float  # pi w R
    indentation_unit_m: float  # (pi^2 w^2 R / K^2)^(1/3)
    radius_unit_m: float  # (pi w R^2 / K)^(1/3)

    @classmethod
    def of(
        cls, radius_m: float, work_of_adhesion_j_per_m2: float, reduced_modulus_pa: float, cohesive_stress_pa: float
    ) -> "MaugisDugdale":
        """Return the transition parameter lambda = 2 sigma0 (9 R / 16 pi w E*^2)^(1/3) (Eq. 8) with the units (E6).

        Raises:
            ValueError: An argument is not finite and positive; the message names it.
        """
        R, w, E, sigma0 = radius_m, work_of_adhesion_j_per_m2, reduced_modulus_pa, cohesive_stress_pa
        named = (
            ("radius", R, "m"),
            ("work of adhesion", w, "J/m^2"),
            ("reduced modulus", E, "Pa"),
            ("stress", sigma0, "Pa"),
        )
        for name, value, unit in named:
            if not (math.isfinite(value) and value > 0.0):
                raise ValueError(f"{name} = {value} {unit} must be finite and > 0 {unit}")
        K = 4.0 * E / 3.0
        return cls(
            transition=2.0 * sigma0 * (R / (math.pi * w * K**2)) ** (1.0 / 3.0),
            force_unit_n=math.pi * w * R,
            indentation_unit_m=(math.pi**2 * w**2 * R / K**2) ** (1.0 / 3.0),
            radius_unit_m=(math.pi * w * R**2 / K) ** (1.0 / 3.0),
        )

    def pull_off(self) -> tuple[float, float]:
        """Return the most attractive force [N] and its indentation [m], see the function `pull_off`."""
        return pull_off(self)

    def indentation_m(self, force_n: float) -> float:
        """Return the indentation [m] at a force [N], see the function `indentation_m`."""
        return indentation_m(self, force_n)


class Contact(NamedTuple):
    """One point of the contact branch, nondimensional; the slopes are d/ds divided by cos s, finite on (0, pi/2]."""

    contact_radius: float  # A
    cohesive_radius: float  # C
    force: float  # P
    indentation: float  # D
    force_slope: float
    indentation_slope: float


def reduced_modulus_pa(
    tip_modulus_pa: float, tip_poisson: float, sample_modulus_pa: float, sample_poisson: float
) -> float:
    """Reduced modulus E* [Pa], 1/E* = (1 - nu_t^2)/E_t + (1 - nu_s^2)/E_s (under Eq. 8).

    Raises:
        ValueError: A modulus is not positive, or a Poisson ratio lies outside (-1, 0.5].

    Example:
        >>> round(reduced_modulus_pa(170e9, 0.5, 4e9, 0.3) / 1e9, 5)
        4.31198
    """
    for name, modulus, poisson in (("tip", tip_modulus_pa, tip_poisson), ("sample", sample_modulus_pa, sample_poisson)):
        if not (math.isfinite(modulus) and modulus > 0.0):
            raise ValueError(f"{name} modulus = {modulus} Pa must be finite and > 0 Pa")
        if not -1.0 < poisson <= 0.5:
            raise ValueError(f"{name} Poisson ratio = {poisson} must be in (-1, 0.5]")
    return 1.0 / ((1.0 - tip_poisson**2) / tip_modulus_pa + (1.0 - sample_poisson**2) / sample_modulus_pa)


def cohesive_stress_pa(work_of_adhesion_j_per_m2: float, contact_distance_m: float) -> float:
    """Dugdale stress sigma0 = 1.03 w / a0 [Pa] (E5: the w is missing in print)."""
    return 1.03 * work_of_adhesion_j_per_m2 / contact_distance_m


@compiled
def _f1(s: float) -> float:
    """Return sin(2s)/2 - s cos(2s), by its series where the two terms cancel."""
    z = 2.0 * s
    if z > _SERIES_BELOW:
        return 0.5 * (math.sin(z) - z * math.cos(z))
    # sin z - z cos z = sum over n >= 1 of (-1)^(n+1) 2n z^(2n+1) / (2n+1)!
    term = z * z * z / 3.0
    total = term
    for n in range(2, 9):
        term *= -z * z / ((2.0 * n - 2.0) * (2.0 * n + 1.0))
        total += term
    return 0.5 * total


@compiled
def contact_at(transition: float, s: float) -> Contact:
    """Point of the contact branch at the angle s = arcsec(c/a), nondimensional (Eq. 7, 9, 10).

    Args:
        transition: Maugis' parameter lambda, > 0.
        s: The angle [rad], in (0, pi/2].
    """
    lam = transition
    sin, cos = math.sin(s), math.cos(s)
    if s >= HALF_PI:
        cos = 0.0
    f1 = _f1(s)
    half = math.sin(0.5 * s)
    f2 = s * sin - 2.0 * half * half
    f3 = sin * cos + s
    a2, a1 = 0.5 * lam * f1, 4.0 / 3.0 * lam * lam * f2
    C = 2.0 / (a1 + math.sqrt(a1 * a1 + 4.0 * a2))
    A = C * cos
    P = A * A * A - lam * C * C * f3
    D = A * A - 4.0 / 3.0 * lam * C * sin
    # f1' = 2 s sin 2s, f2' = s cos s, f3' = 2 cos^2 s: each has one factor cos s, which is divided out here.
    C1 = -(2.0 * lam * C * C * s * sin + 4.0 / 3.0 * lam * lam * C * s) / (2.0 * a2 * C + a1)
    P1 = 3.0 * A * A * C1 * cos - 3.0 * A * C * C * sin - lam * (2.0 * C * C1 * f3 + 2.0 * C * C * cos)
    D1 = 2.0 * C * C1 * cos * cos - 2.0 * C * C * sin - 4.0 / 3.0 * lam * (C1 * sin + C)
    return Contact(C * cos, C, P, D, P1, D1)


@compiled
def _decreasing_root(transition: float, target: float, low: float, high: float, quantity: int) -> float:
    """Bisect for the angle [rad] at which a quantity that falls with s passes the target.

    quantity: 0 indentation, 1 force, 2 minus the slope of the indentation, 3 minus the slope of the force. It is
    bisection because, next to a fold, a faster method gains nothing and may leave the branch.
    """
    while True:
        mid = 0.5 * (low + high)
        if mid <= low or mid >= high:
            return mid
        point = contact_at(transition, mid)
        if quantity == 0:
            value = point.indentation
        elif quantity == 1:
            value = point.force
        elif quantity == 2:
            value = -point.indentation_slope
        else:
            value = -point.force_slope
        if value > target:
            low = mid
        else:
            high = mid


@compiled
def end_angle(transition: float) -> float:
    """Angle at which the contact ends under displacement control: pi/2, or the fold once lambda > 0.938."""
    if contact_at(transition, HALF_PI).indentation_slope <= 0.0:
        return HALF_PI
    return _decreasing_root(transition, 0.0, _outer_angle(transition, 0.0, 0), HALF_PI, 2)


@compiled
def pull_off_angle(transition: float) -> float:
    """Angle of the most attractive force, the end of the contact under force control."""
    return _decreasing_root(transition, 0.0, _outer_angle(transition, 0.0, 1), HALF_PI, 3)


@compiled
def _outer_angle(transition: float, target: float, quantity: int) -> float:
    """Find an angle below any extremum at which the indentation (0) or force (1) exceeds the target."""
    s = HALF_PI
    for _ in range(400):
        s *= 0.5
        point = contact_at(transition, s)
        if (point.indentation if quantity == 0 else point.force) > max(target, 0.0):
            break
    return s


@compiled
def cohesive_end(transition: float) -> tuple[float, float]:
    """Smallest indentation D of the whole stable branch and the force P there, nondimensional."""
    if transition > FOLD_TRANSITION:
        point = contact_at(transition, end_angle(transition))
        return point.indentation, point.force
    C = 8.0 * transition / (3.0 * math.pi)
    return -0.5 * C * C - 2.0 / (math.pi * transition), -HALF_PI * transition * C * C


@compiled
def cohesive_at(transition: float, indentation: float) -> tuple[float, float]:
    """Force and stiffness dP/dD of the cohesive branch a = 0, c > 0, nondimensional; lambda < 0.938.

    The stiffness at the end of the branch is minus infinity, which is returned as the largest finite number.

    Args:
        transition: Maugis' parameter lambda.
        indentation: The indentation D, between the end of the branch and the last point of contact.
    """
    C0 = 8.0 * transition / (3.0 * math.pi)
    root = math.sqrt(max(C0 * C0 + 2.0 * (indentation + 2.0 / (math.pi * transition)), 0.0))
    C = C0 + root
    return -HALF_PI * transition * C * C, -math.pi * transition * C / max(root, 1e-150)


@compiled
def force_at(transition: float, indentation: float) -> tuple[float, float, float]:
    """Force P, stiffness dP/dD and contact radius A at an indentation D, nondimensional: the direct solution.

    Zero force, stiffness and radius where no stable contact exists (surfaces apart); the cohesive branch has radius 0.
    """
    end = end_angle(transition)
    if indentation >= contact_at(transition, end).indentation:
        point = contact_at(transition, angle_at(transition, indentation, end))
        slope = point.indentation_slope
        # On the fold itself the slope is zero up to rounding, and the stiffness accordingly large.
        slope = min(slope, -1e-150)
        return point.force, point.force_slope / slope, point.contact_radius
    if indentation >= cohesive_end(transition)[0]:
        force, stiffness = cohesive_at(transition, indentation)
        return force, stiffness, 0.0
    return 0.0, 0.0, 0.0


@compiled
def angle_at(transition: float, indentation: float, end: float) -> float:
    """Angle of the stable contact at an indentation D, given the angle at which the contact ends (`end_angle`)."""
    low = min(_outer_angle(transition, indentation, 0), end)
    ended = contact_at(transition, end).indentation
    return angle_between(transition, indentation, ended, low, end, 0.5 * (low + end))


@compiled
def angle_between(transition: float, indentation: float, ended: float, low: float, high: float, guess: float) -> float:
    """Angle of the stable contact at an indentation D, given angles on both sides of it and one to begin with.

    `ended` is D0, the indentation at which the contact ends. Newton's method solves for u = sqrt(D - D0), because u is
    nearly linear in the angle there.
    """
    s = guess if low < guess < high else 0.5 * (low + high)
    # Newton's method; bisection where it would leave the bracket or does not advance, as next to a fold.
    tries, wanted = 0, math.sqrt(max(indentation - ended, 0.0))
    while True:
        point = contact_at(transition, s)
        if abs(point.indentation - indentation) <= _LAST_DIGIT * abs(indentation):
            return s
        if point.indentation > indentation:
            low = s
        else:
            high = s
        following = 0.5 * (low + high)
        slope = point.indentation_slope * math.cos(s)
        if slope < 0.0 and tries < _MOST_NEWTON_STEPS:
            u = math.sqrt(max(point.indentation - ended, 0.0))
            newton = s - 2.0 * u * (u - wanted) / slope
            if low < newton < high:
                following = newton
        if abs(following - s) <= _LAST_DIGIT * s or not low < following < high:
            return following
        tries += 1
        s = following


@compiled
def force_n(contact: MaugisDugdale, indentation_m: float) -> float:
    """Contact force F [N] at the indentation delta = a0 - h [m]; 0 where the surfaces are apart."""
    return contact.force_unit_n * force_at(contact.transition, indentation_m / contact.indentation_unit_m)[0]


@compiled
def stiffness_n_per_m(contact: MaugisDugdale, indentation_m: float) -> float:
    """Contact stiffness dF/d delta [N/m] at the indentation delta [m]; 0 where the surfaces are apart."""
    unit = contact.force_unit_n / contact.indentation_unit_m
    return unit * force_at(contact.transition, indentation_m / contact.indentation_unit_m)[1]


@compiled
def indentation_m(contact: MaugisDugdale, force_n: float) -> float:
    """Indentation delta [m] under a force [N], on the branch that is stable at constant force.

    Raises:
        ValueError: The force is below the pull-off force (more negative), so that no contact carries it.
    """
    lam, force = contact.transition, force_n / contact.force_unit_n
    pull_off = pull_off_angle(lam)
    if not force >= contact_at(lam, pull_off).force:
        raise ValueError("force in N is below the pull-off force: no contact carries it")
    angle = _decreasing_root(lam, force, min(_outer_angle(lam, force, 1), pull_off), pull_off, 1)
    return contact.indentation_unit_m * contact_at(lam, angle).indentation


@compiled
def pull_off(contact: MaugisDugdale) -> tuple[float, float]:
    """Most attractive force of the contact [N] and the indentation there [m], negative: the surface is drawn out.

    The force is -2 pi w R for lambda -> 0 (DMT), and -1.5 pi w R for infinity (JKR).
    """
    end = contact_at(contact.transition, pull_off_angle(contact.transition))
    return contact.force_unit_n * end.force, contact.indentation_unit_m * end.indentation
