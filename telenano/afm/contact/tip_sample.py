"""The whole force on the tip, F(h), with its memory: free, bridged by a meniscus, in contact, or both.

A branch is a pair of flags (contact, meniscus). On one branch the force is a plain function of h over one interval;
at the ends of that interval the tip passes to another branch (`cantilever` does this). Two readings of the paper:

`consistent` (default): Lennard-Jones outside and Maugis-Dugdale inside; the switch is at h*, where the two are equal
(E7), so the force is continuous. The meniscus is that of E3 and E4 and also acts in contact.
`as_printed`: Eq. 4 and 6 to the letter: the switch stands at a0, where the force jumps from 0 to F_MD(0), and the
capillary force belongs to the non-contact side alone.

h* is the outermost crossing of Eq. 5 with the contact proper (a > 0) or, where there is none, with the cohesive branch,
whose steep end is an artefact of the constant stress. Below lambda = 0.938 the switch is at h* in both directions.
Above it the contact folds under displacement control: it begins at h* and ends at the fold, if the contact pulls harder
than Eq. 5 there (the contact hysteresis of Johnson and Greenwood 1997).
"""

import math
from typing import NamedTuple

import numpy as np

from telenano.afm.contact.capillary import meniscus_force, printed_meniscus_force
from telenano.afm.contact.contact_table import ContactTable, build_contact_table, table_force
from telenano.afm.contact.lennard_jones import contact_distance_m, lennard_jones_force
from telenano.afm.contact.maugis_dugdale import FOLD_TRANSITION, MaugisDugdale, cohesive_stress_pa
from telenano.numerics.compiler import compiled

CONSISTENT = 0
AS_PRINTED = 1
_SCAN_POINTS = 4000


class TipSampleProperties(NamedTuple):
    """Properties of tip, sample and meniscus from which `build_tip_sample` prepares the force."""

    radius_m: float  # R
    hamaker_j: float  # H
    sigma_m: float  # sigma
    work_of_adhesion_j_per_m2: float  # w
    reduced_modulus_pa: float  # E*
    liquid_energy_j_per_m2: float  # gamma_L
    meniscus_radius_m: float  # r1
    break_distance_m: float  # delta_b
    reading: int  # CONSISTENT or AS_PRINTED
    meniscus: bool  # True: a meniscus can form


class TipSample(NamedTuple):
    """Everything `branch_force` needs; made by `build_tip_sample`."""

    radius_m: float
    hamaker_j: float
    sigma_m: float
    contact_distance_m: float  # a0
    capillary_force_n: float  # 4 pi R gamma_L
    meniscus_width_m: float  # 2 r1
    meniscus_break_m: float  # delta_b
    contact_onset_m: float  # h*: contact begins
    contact_end_m: float  # contact ends, >= h*
    as_printed: bool
    has_meniscus: bool
    table: ContactTable

    def branch(self, distance_m: float, *, contact: bool, meniscus: bool) -> tuple[float, float]:
        """Return force [N] and gradient [N/m] at h [m] on a branch, as `branch_force`."""
        return branch_force(self, distance_m, contact, meniscus)

    def bridge(self, distance_m: float, *, retracting: bool = False) -> tuple[float, float]:
        """Return force [N] and gradient [N/m] of the meniscus alone at h [m]; `as_printed` has two branches."""
        own = self.capillary_force_n, self.meniscus_width_m, self.contact_distance_m
        if self.as_printed:
            return printed_meniscus_force(distance_m, retracting, *own, self.meniscus_break_m)
        return meniscus_force(distance_m, *own)


@compiled
def branch_force(tip: TipSample, distance_m: float, contact: bool, meniscus: bool) -> tuple[float, float]:
    """Force [N] on the tip, and gradient dF/dh [N/m], at h [m] on the branch (contact, meniscus).

    `contact` selects Maugis-Dugdale (Eq. 7-11) instead of Lennard-Jones (Eq. 5). `meniscus` says that a bridge exists
    (`consistent`) or that the retract law holds (`as_printed`). Positive is repulsive.
    """
    if contact:
        force, stiffness = table_force(tip.table, tip.contact_distance_m - distance_m)
        gradient = -stiffness
    else:
        force, gradient = lennard_jones_force(distance_m, tip.hamaker_j, tip.radius_m, tip.sigma_m)
    if not tip.has_meniscus:
        return force, gradient
    if not tip.as_printed:
        if meniscus:
            pull, slope = meniscus_force(
                distance_m, tip.capillary_force_n, tip.meniscus_width_m, tip.contact_distance_m
            )
            return force + pull, gradient + slope
    elif not contact:
        pull, slope = printed_meniscus_force(
            distance_m,
            meniscus,
            tip.capillary_force_n,
            tip.meniscus_width_m,
            tip.contact_distance_m,
            tip.meniscus_break_m,
        )
        return force + pull, gradient + slope
    return force, gradient


def build_tip_sample(properties: TipSampleProperties, largest_force_n: float) -> TipSample:
    """Prepare F(h): contact table, contact point, hand-over distance.

    Args:
        properties: The properties of tip and sample.
        largest_force_n: The contact force up to which the table has to reach [N], > 0.

    Raises:
        ValueError: A property is impossible; the message names it with its unit. In the `consistent` reading also if
            Lennard-Jones and Maugis-Dugdale do not cross; the message gives lambda, H and omega (E7).
    """
    p = properties
    _check(p)
    a0 = contact_distance_m(p.sigma_m)
    stress = cohesive_stress_pa(p.work_of_adhesion_j_per_m2, a0)
    contact = MaugisDugdale.of(p.radius_m, p.work_of_adhesion_j_per_m2, p.reduced_modulus_pa, stress)
    table = build_contact_table(contact, largest_force_n)
    as_printed = p.reading == AS_PRINTED
    hand_over, release = (a0, a0) if as_printed else _hand_over(p, table, a0)
    return TipSample(
        radius_m=p.radius_m,
        hamaker_j=p.hamaker_j,
        sigma_m=p.sigma_m,
        contact_distance_m=a0,
        capillary_force_n=4.0 * math.pi * p.radius_m * p.liquid_energy_j_per_m2,
        meniscus_width_m=2.0 * p.meniscus_radius_m,
        meniscus_break_m=p.break_distance_m,
        contact_onset_m=hand_over,
        contact_end_m=release,
        as_printed=as_printed,
        has_meniscus=p.meniscus,
        table=table,
    )


def _check(p: TipSampleProperties) -> None:
    if not (math.isfinite(p.hamaker_j) and p.hamaker_j > 0.0):
        raise ValueError(f"Hamaker constant H = {p.hamaker_j} J must be finite and > 0 J")
    if not (math.isfinite(p.liquid_energy_j_per_m2) and p.liquid_energy_j_per_m2 >= 0.0):
        raise ValueError(f"liquid surface energy gamma_L = {p.liquid_energy_j_per_m2} J/m^2 must be finite and >= 0")
    if p.reading not in (CONSISTENT, AS_PRINTED):
        raise ValueError(f"reading = {p.reading} must be {CONSISTENT} (consistent) or {AS_PRINTED} (as_printed)")
    if not (p.meniscus_radius_m > 0.0 and math.isfinite(p.break_distance_m)):
        raise ValueError(f"meniscus radius r1 = {p.meniscus_radius_m} m must be > 0 m, delta_b finite")
    if p.break_distance_m <= 2.0 * p.meniscus_radius_m:
        raise ValueError(
            f"meniscus breaking distance delta_b = {p.break_distance_m} m must lie beyond 2 r1 = "
            f"{2.0 * p.meniscus_radius_m} m, where the meniscus forms"
        )


def _difference(p: TipSampleProperties, table: ContactTable, a0: float, h: float) -> float:
    """F_LJ(h) - F_MD(a0 - h)."""
    return lennard_jones_force(h, p.hamaker_j, p.radius_m, p.sigma_m)[0] - table_force(table, a0 - h)[0]


def _hand_over(p: TipSampleProperties, table: ContactTable, a0: float) -> tuple[float, float]:
    """Return the distances h* at which contact begins and h_release >= h* at which it ends (E7)."""
    contact_end = a0 - table.start_m
    hand_over = _outermost_crossing(p, table, a0, a0, contact_end)
    if hand_over is None:
        hand_over = _outermost_crossing(p, table, a0, contact_end, a0 - table.cohesive_end_m)
    if hand_over is None:
        raise ValueError(
            f"no hand-over from Lennard-Jones to Maugis-Dugdale: the two forces cross nowhere between the contact "
            f"point and pull-off for lambda = {table.contact.transition:.6g}, H = {p.hamaker_j:.6g} J, "
            f"omega = {p.work_of_adhesion_j_per_m2:.6g} J/m^2; {_remedy(p, table, a0)} lower omega, or use the "
            f"reading as_printed"
        )
    folded = table.contact.transition > FOLD_TRANSITION
    if folded and _difference(p, table, a0, math.nextafter(contact_end, 0.0)) > 0.0:
        return hand_over, contact_end
    return hand_over, hand_over


def hamaker_of(work_of_adhesion_j_per_m2: float) -> float:
    """Return the Hamaker constant [J] of two surfaces with this work of adhesion: H = 12 pi D_0^2 omega.

    D_0 = 0.165 nm (J. N. Israelachvili, Intermolecular and Surface Forces). H and omega are two measures of one
    attraction, so values that are far from this belong to different materials, or to different surroundings.
    """
    return 12.0 * math.pi * 0.165e-9**2 * work_of_adhesion_j_per_m2


def _remedy(p: TipSampleProperties, table: ContactTable, a0: float) -> str:
    """Return advice for the error message: the least H at which the forces cross, and the H that belongs to omega."""

    def crosses(hamaker_j: float) -> bool:
        other = p._replace(hamaker_j=hamaker_j)
        return _outermost_crossing(other, table, a0, a0, a0 - table.cohesive_end_m) is not None

    low, high = p.hamaker_j, p.hamaker_j
    for _ in range(12):
        low, high = high, 2.0 * high
        if crosses(high):
            break
    else:
        return "no H within reach helps:"
    for _ in range(12):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if crosses(middle) else (middle, high)
    belongs = hamaker_of(p.work_of_adhesion_j_per_m2)
    return f"raise H to {high:.3g} J or more ({belongs:.3g} J belongs to this omega by H = 12 pi D0^2 omega),"


def _outermost_crossing(
    p: TipSampleProperties, table: ContactTable, a0: float, near_m: float, far_m: float
) -> float | None:
    """Largest h in [near, far] at which F_LJ = F_MD, or None."""
    # Stay just inside the stable branch: beyond its end the contact force is zero.
    grid = np.linspace(far_m, near_m, _SCAN_POINTS + 1)
    grid[0] = math.nextafter(far_m, near_m)
    previous = _difference(p, table, a0, float(grid[0]))
    for far, near in zip(grid[:-1].tolist(), grid[1:].tolist(), strict=True):
        value = _difference(p, table, a0, near)
        if (value > 0.0) != (previous > 0.0):
            return _bisect(p, table, a0, near, far)
        previous = value
    return None


def _bisect(p: TipSampleProperties, table: ContactTable, a0: float, near: float, far: float) -> float:
    positive_near = _difference(p, table, a0, near) > 0.0
    while True:
        mid = 0.5 * (near + far)
        if mid <= near or mid >= far:
            return mid
        if (_difference(p, table, a0, mid) > 0.0) == positive_near:
            near = mid
        else:
            far = mid
