import math

import numpy as np
import pytest

from telenano.afm.contact.contact_table import table_force
from telenano.afm.contact.lennard_jones import lennard_jones_force, minimum_distance_m
from telenano.afm.contact.maugis_dugdale import reduced_modulus_pa
from telenano.afm.contact.tip_sample import (
    AS_PRINTED,
    CONSISTENT,
    TipSampleProperties,
    branch_force,
    build_tip_sample,
)

LARGEST_N = 400e-9
TABLE_2 = TipSampleProperties(
    radius_m=10e-9,
    hamaker_j=1.89e-19,
    sigma_m=3.49e-10,
    work_of_adhesion_j_per_m2=0.072,
    reduced_modulus_pa=reduced_modulus_pa(170e9, 0.5, 4e9, 0.3),
    liquid_energy_j_per_m2=0.073,
    meniscus_radius_m=1.2e-9,
    break_distance_m=4e-9,
    reading=CONSISTENT,
    meniscus=True,
)


def build(**changes):
    return build_tip_sample(TABLE_2._replace(**changes), LARGEST_N)


def test_hand_over_of_table_2():
    tip = build()
    assert round(tip.contact_onset_m * 1e9, 4) == 0.2735
    assert tip.contact_end_m == tip.contact_onset_m
    outside = branch_force(tip, tip.contact_onset_m, False, False)[0]
    inside = branch_force(tip, tip.contact_onset_m, True, False)[0]
    assert round(outside * 1e9, 3) == -3.605
    assert math.isclose(outside, inside, rel_tol=1e-9)
    # outermost: no crossing further out on the contact proper
    contact_end = tip.contact_distance_m - tip.table.start_m
    further = np.linspace(tip.contact_onset_m * (1 + 1e-6), contact_end * (1 - 1e-9), 500)
    differences = [branch_force(tip, h, False, False)[0] - branch_force(tip, h, True, False)[0] for h in further]
    assert min(differences) > 0


def test_the_whole_force_is_continuous_where_it_says_so():
    tip = build()
    for h in (tip.contact_onset_m, tip.contact_distance_m):
        for meniscus in (False, True):
            below = branch_force(tip, math.nextafter(h, 0), True, meniscus)[0]
            above = branch_force(tip, h, h < tip.contact_onset_m, meniscus)[0]
            assert math.isclose(below, above, rel_tol=1e-9)


def test_largest_pull_with_meniscus():
    tip = build()
    h = np.linspace(tip.contact_distance_m, 1e-9, 20000)
    pulls = [branch_force(tip, x, x < tip.contact_onset_m, True)[0] for x in h.tolist()]
    assert round(min(pulls) * 1e9, 1) == -12.5


def test_as_printed_jumps_at_the_contact_point():
    tip = build(reading=AS_PRINTED)
    a0 = tip.contact_distance_m
    assert tip.contact_onset_m == tip.contact_end_m == a0
    assert abs(branch_force(tip, a0, False, False)[0]) < 1e-20
    assert round(branch_force(tip, a0, True, False)[0] * 1e9, 3) == -3.225
    # Eq. 4 has no capillary force in contact, in either branch
    assert branch_force(tip, a0, True, True) == branch_force(tip, a0, True, False)
    assert round(branch_force(tip, math.nextafter(a0, 1), False, True)[0] * 1e9, 2) == -3.34


def test_without_meniscus_the_flag_does_nothing():
    for reading in (CONSISTENT, AS_PRINTED):
        tip = build(reading=reading, meniscus=False)
        for h in (1e-9, 3e-9, 8e-9):
            assert branch_force(tip, h, False, True) == branch_force(tip, h, False, False)
            assert branch_force(tip, h, False, True) == lennard_jones_force(h, 1.89e-19, 10e-9, 3.49e-10)


@pytest.mark.parametrize("meniscus", [False, True])
@pytest.mark.parametrize("reading", [CONSISTENT, AS_PRINTED])
def test_gradients_are_numerical_derivatives(reading, meniscus):
    tip = build(reading=reading)
    for contact, distances in ((False, (0.3e-9, 1e-9, 2e-9, 3e-9)), (True, (-2e-9, -0.5e-9, 0.15e-9))):
        for h in distances:
            step = 2e-14
            forces = [branch_force(tip, h + sign * step, contact, meniscus)[0] for sign in (-1, 1)]
            numerical = (forces[1] - forces[0]) / (2 * step)
            assert math.isclose(branch_force(tip, h, contact, meniscus)[1], numerical, rel_tol=2e-4, abs_tol=1e-4)


def test_no_crossing_is_an_error_that_names_the_cause():
    with pytest.raises(ValueError, match=r"lambda = .*, H = 1e-20 J, omega = 0\.072 J/m\^2"):
        build(hamaker_j=1e-20)
    build(hamaker_j=1e-20, reading=AS_PRINTED)


def test_a_stiff_sample_hands_over_on_the_cohesive_branch():
    # close to DMT the contact pulls harder than van der Waals everywhere; only the cohesive branch comes down to it
    tip = build(reduced_modulus_pa=20e9)
    delta = tip.contact_distance_m - tip.contact_onset_m
    assert tip.table.cohesive_end_m < delta < tip.table.start_m
    outside = branch_force(tip, tip.contact_onset_m, False, False)[0]
    assert math.isclose(table_force(tip.table, delta)[0], outside, rel_tol=1e-6)


def test_a_folding_contact_holds_on_to_its_end():
    # a softer sample has a larger lambda
    soft = build(reduced_modulus_pa=2e9)
    assert soft.table.contact.transition > 0.938
    assert soft.contact_end_m > soft.contact_onset_m
    inside = branch_force(soft, soft.contact_end_m * (1 - 1e-12), True, False)[0]
    assert inside < branch_force(soft, soft.contact_end_m, False, False)[0]
    assert branch_force(soft, soft.contact_end_m * (1 + 1e-12), True, False)[0] == 0.0
    assert build().contact_end_m == build().contact_onset_m


def test_minimum_lies_inside_the_hand_over():
    assert minimum_distance_m(3.49e-10) < build().contact_onset_m


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"hamaker_j": 0.0}, r"H = 0.0 J"),
        ({"hamaker_j": math.nan}, r"H = nan J"),
        ({"liquid_energy_j_per_m2": -0.1}, r"gamma_L = -0.1 J/m\^2"),
        ({"meniscus_radius_m": 0.0}, r"r1 = 0.0 m"),
        ({"break_distance_m": 2.4e-9}, r"delta_b = 2.4e-09 m must lie beyond 2 r1 = 2.4e-09 m"),
        ({"reading": 7}, r"reading = 7"),
        ({"radius_m": -1.0}, r"radius = -1.0 m"),
        ({"sigma_m": 0.0}, r"sigma = 0.0 m"),
    ],
)
def test_impossible_properties_are_named(changes, message):
    with pytest.raises(ValueError, match=message):
        build(**changes)
