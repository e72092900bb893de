import math
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq

from telenano.afm.contact import maugis_dugdale as md
from telenano.afm.contact.lennard_jones import contact_distance_m

R, W, E_TIP, E_SAMPLE = 10e-9, 0.072, 170e9, 4e9
A0 = contact_distance_m(3.49e-10)


@pytest.fixture(scope="module")
def table_2():
    modulus = md.reduced_modulus_pa(E_TIP, 0.5, E_SAMPLE, 0.3)
    return md.MaugisDugdale.of(R, W, modulus, md.cohesive_stress_pa(W, A0))


def printed_contact(lam, A):
    """(P, Delta) for a given A, from Eq. 7, 9, 10 in the printed variables, by root finding on m = c/a."""

    def left_side(log_excess):
        m = 1 + math.exp(log_excess)
        root, arc = math.sqrt(m * m - 1), math.acos(1 / m)
        first = lam * A * A / 2 * (root + (m * m - 2) * arc)
        return first + 4 * lam * lam * A / 3 * (root * arc - m + 1) - 1

    m = 1 + math.exp(brentq(left_side, math.log(1e-9), math.log(1e9), xtol=1e-14, rtol=1e-14))
    root, arc = math.sqrt(m * m - 1), math.acos(1 / m)
    return A**3 - lam * A * A * (root + m * m * arc), A * A - 4 * lam * A / 3 * root


def test_derived_values_of_table_2(table_2):
    assert round(md.reduced_modulus_pa(E_TIP, 0.5, E_SAMPLE, 0.3) * 1e-9, 5) == 4.31198
    assert round(md.cohesive_stress_pa(W, A0) * 1e-9, 6) == 0.374568
    assert round(table_2.transition, 5) == 0.82538
    assert round(md.pull_off(table_2)[0] * 1e9, 3) == -3.684
    assert round(md.pull_off(table_2)[1] * 1e9, 3) == -0.124
    assert round(md.force_n(table_2, 0.0) * 1e9, 3) == -3.225


@pytest.mark.parametrize(
    ("delta_nm", "stiffness", "digits"), [(0, 6.74, 2), (0.2, 13.15, 2), (0.5, 19.6, 1), (1, 27.4, 1), (2, 38.6, 1)]
)
def test_contact_stiffness_of_table_2(table_2, delta_nm, stiffness, digits):
    assert round(md.stiffness_n_per_m(table_2, delta_nm * 1e-9), digits) == stiffness


@pytest.mark.parametrize(
    ("lam", "force", "radius", "indentation"),
    [
        (0.1, -1.9506, 0.199, -0.430),
        (0.5, -1.7182, 0.679, -0.530),
        (1, -1.6007, 0.904, -0.484),
        (5, -1.5063, 1.126, -0.440),
    ],
)
def test_golden_pull_off(lam, force, radius, indentation):
    point = md.contact_at(lam, md.pull_off_angle(lam))
    assert round(point.force, 4) == force
    assert round(point.contact_radius, 3) == radius
    assert round(point.indentation, 3) == indentation


def test_agrees_with_the_printed_equations_over_random_contacts():
    rng = np.random.default_rng(7)
    compared = 0
    for _ in range(400):
        lam, A = 10 ** rng.uniform(-1.3, 1.0), rng.uniform(0.05, 6.0)
        force, indentation = printed_contact(lam, A)
        fold = md.contact_at(lam, md.end_angle(lam))
        if fold.contact_radius * (1 + 1e-6) > A:
            continue  # beyond the fold: unstable
        found = md.force_at(lam, indentation)
        assert math.isclose(found[0], force, rel_tol=1e-7, abs_tol=1e-7)
        assert math.isclose(found[2], A, rel_tol=1e-6)
        compared += 1
    assert compared > 300


@pytest.mark.parametrize("A", [1.0, 2.0, 5.0])
def test_limits(A):
    # DMT: P = A^3 - 2, D = A^2; JKR: P = A^3 - sqrt(6 A^3), D = A^2 - (2/3) sqrt(6 A)
    assert math.isclose(md.force_at(1e-10, A * A)[0], A**3 - 2, rel_tol=0, abs_tol=1e-3)
    jkr = A**3 - math.sqrt(6 * A**3)
    assert math.isclose(md.force_at(1e4, A * A - 2 / 3 * math.sqrt(6 * A))[0], jkr, rel_tol=0, abs_tol=1e-3)


def test_pull_off_goes_from_dmt_to_jkr():
    pull_offs = [md.contact_at(lam, md.pull_off_angle(lam)).force for lam in np.geomspace(1e-4, 1e4, 41)]
    assert math.isclose(pull_offs[0], -2, rel_tol=1e-4)
    assert math.isclose(pull_offs[-1], -1.5, rel_tol=1e-4)
    assert all(a < b for a, b in pairwise(pull_offs))


def test_the_contact_folds_only_above_0_938():
    assert round(md.FOLD_TRANSITION, 3) == 0.938
    for lam in [*np.geomspace(0.01, 0.937, 20), md.FOLD_TRANSITION - 1e-6]:
        assert md.end_angle(lam) == md.HALF_PI
    assert md.end_angle(md.FOLD_TRANSITION + 1e-6) < md.HALF_PI
    for lam in np.geomspace(0.939, 100, 20):
        end = md.end_angle(lam)
        assert end < md.HALF_PI
        # on both sides of the fold the indentation is larger
        fold = md.contact_at(lam, end).indentation
        assert md.contact_at(lam, 0.5 * (end + md.HALF_PI)).indentation > fold
        assert md.contact_at(lam, 0.99 * end).indentation > fold


@pytest.mark.parametrize("lam", [0.05, 0.3, 0.82538, 0.93])
def test_the_cohesive_branch_meets_the_contact_with_equal_slope(lam):
    last = md.contact_at(lam, md.HALF_PI)
    force, stiffness = md.cohesive_at(lam, last.indentation)
    assert last.contact_radius == 0.0
    assert math.isclose(force, last.force, rel_tol=1e-11)
    assert math.isclose(stiffness, last.force_slope / last.indentation_slope, rel_tol=1e-9)


def test_the_cohesive_branch_closes_the_gap_at_its_edge(table_2):
    # numerically, in SI: a uniform stress inside r < c lifts the edge by sigma0 / (pi E*) times int dA/distance
    lam, modulus = table_2.transition, md.reduced_modulus_pa(E_TIP, 0.5, E_SAMPLE, 0.3)
    stress = md.cohesive_stress_pa(W, A0)
    end, last = md.cohesive_end(lam)[0], md.contact_at(lam, md.HALF_PI).indentation
    for indentation in np.linspace(end, last, 5):
        force = md.cohesive_at(lam, indentation)[0] * table_2.force_unit_n
        c = math.sqrt(-force / (math.pi * stress))
        lift = (
            stress
            / (math.pi * modulus)
            * quad(lambda angle, c=c: 2 * c * math.cos(angle), -math.pi / 2, math.pi / 2)[0]
        )
        gap = c * c / (2 * R) - indentation * table_2.indentation_unit_m - lift
        assert math.isclose(gap, W / stress, rel_tol=1e-9)
        # in the middle the surfaces do not overlap: u(0) = 2 sigma0 c / E*
        assert -indentation * table_2.indentation_unit_m - 2 * stress * c / modulus > -1e-18


@pytest.mark.parametrize("lam", [0.1, 0.82538, 0.93, 1.0, 5.0])
def test_beyond_the_end_the_surfaces_are_apart(lam):
    end, force = md.cohesive_end(lam)
    assert md.force_at(lam, end - 1e-9) == (0.0, 0.0, 0.0)
    assert math.isclose(md.force_at(lam, end + 1e-12)[0], force, rel_tol=1e-4)


@pytest.mark.parametrize("lam", [0.05, 0.5, 0.82538, 1.5, 20.0])
def test_stiffness_is_the_numerical_derivative(lam):
    for indentation in (-0.3, 0.0, 0.5, 3.0, 30.0):
        step = 1e-5
        numerical = (md.force_at(lam, indentation + step)[0] - md.force_at(lam, indentation - step)[0]) / (2 * step)
        assert math.isclose(md.force_at(lam, indentation)[1], numerical, rel_tol=1e-6)


def test_separation_from_force_is_the_inverse(table_2):
    pull_off, first = md.pull_off(table_2)
    for force in np.array([-3.68e-9, -2e-9, 0.0, 1e-9, 5e-8, 1e-6]):
        assert math.isclose(md.force_n(table_2, md.indentation_m(table_2, force)), force, rel_tol=1e-9, abs_tol=1e-20)
    rng = np.random.default_rng(3)
    for delta in rng.uniform(first, 5e-9, 50):
        found = md.indentation_m(table_2, md.force_n(table_2, delta))
        assert math.isclose(found, delta, rel_tol=1e-6, abs_tol=1e-16)
    with pytest.raises(ValueError, match="below the pull-off force"):
        md.indentation_m(table_2, pull_off * (1 + 1e-9))
    assert md.indentation_m(table_2, pull_off * (1 - 1e-9)) < 0


@pytest.mark.parametrize("position", range(4))
@pytest.mark.parametrize("bad", [0.0, -1.0, math.nan, math.inf])
def test_impossible_contacts_are_named(position, bad):
    values = [R, W, 4e9, 4e8]
    values[position] = bad
    with pytest.raises(ValueError, match="must be finite and > 0"):
        md.MaugisDugdale.of(*values)


@pytest.mark.parametrize(
    ("arguments", "name"), [((0.0, 0.3, 1e9, 0.3), "tip modulus"), ((1e9, 0.3, 1e9, 0.6), "sample Poisson")]
)
def test_impossible_moduli_are_named(arguments, name):
    with pytest.raises(ValueError, match=name):
        md.reduced_modulus_pa(*arguments)
