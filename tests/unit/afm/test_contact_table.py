import math

import numpy as np
import pytest

from telenano.afm.contact import maugis_dugdale as md
from telenano.afm.contact.contact_table import (
    FORCE_FLOOR,
    FORCE_TOLERANCE,
    STIFFNESS_TOLERANCE,
    build_contact_table,
    table_force,
)

UNIT_N, UNIT_M = 2.26e-9, 2.49e-10
LARGEST_N = 400e-9


def contact(lam):
    return md.MaugisDugdale(lam, UNIT_N, UNIT_M, 1.57e-9)


@pytest.mark.parametrize("lam", [1e-3, 0.1, 0.5, 0.82538, 0.93, 0.9379, 0.938, 0.94, 1.0, 5.0, 100.0])
def test_force_and_stiffness_agree_with_the_direct_solution(lam):
    table = build_contact_table(contact(lam), LARGEST_N)
    assert table.force_error <= FORCE_TOLERANCE
    rng = np.random.default_rng(11)
    span = math.sqrt(table.end_m - table.start_m)
    # uniform in depth, and logarithmic towards the end of the contact
    depths = np.concatenate([rng.uniform(0, span, 150) ** 2, (span * 10 ** rng.uniform(-5, 0, 150)) ** 2])
    for delta in table.start_m + depths:
        force, stiffness = table_force(table, delta)
        exact, exact_stiffness, _ = md.force_at(lam, delta / UNIT_M)
        assert abs(force - exact * UNIT_N) <= FORCE_TOLERANCE * UNIT_N * max(abs(exact), FORCE_FLOOR)
        allowed = STIFFNESS_TOLERANCE * UNIT_N / UNIT_M * max(abs(exact_stiffness), 1.0)
        assert abs(stiffness - exact_stiffness * UNIT_N / UNIT_M) <= allowed


@pytest.mark.parametrize("lam", [0.1, 0.82538, 0.93])
def test_the_cohesive_branch_is_exact(lam):
    table = build_contact_table(contact(lam), LARGEST_N)
    for delta in np.linspace(table.cohesive_end_m, table.start_m, 7)[1:-1]:
        assert math.isclose(table_force(table, delta)[0], md.force_at(lam, delta / UNIT_M)[0] * UNIT_N, rel_tol=1e-9)


@pytest.mark.parametrize("lam", [0.1, 0.82538, 1.0, 5.0])
def test_beyond_the_range(lam):
    table = build_contact_table(contact(lam), LARGEST_N)
    assert table_force(table, table.cohesive_end_m - 1e-15) == (0.0, 0.0)
    assert table_force(table, -1.0) == (0.0, 0.0)
    force, stiffness = table_force(table, table.end_m)
    assert math.isclose(force, LARGEST_N, rel_tol=1e-6)
    beyond, same = table_force(table, table.end_m + 1e-9)
    assert math.isclose(beyond, force + 1e-9 * stiffness, rel_tol=1e-12)
    assert same == stiffness
    # softer than the contact, and continuous with the table just inside
    assert beyond < md.force_at(lam, (table.end_m + 1e-9) / UNIT_M)[0] * UNIT_N
    inside, inside_stiffness = table_force(table, math.nextafter(table.end_m, 0))
    assert math.isclose(inside, force, rel_tol=1e-9)
    assert math.isclose(inside_stiffness, stiffness, rel_tol=1e-6)


@pytest.mark.parametrize("lam", [0.82538, 5.0])
def test_the_end_of_the_contact_is_finite(lam):
    table = build_contact_table(contact(lam), LARGEST_N)
    for delta in (table.start_m, math.nextafter(table.start_m, 1), table.cohesive_end_m):
        assert all(math.isfinite(value) for value in table_force(table, delta))


def test_a_table_is_built_once():
    assert build_contact_table(contact(0.7), LARGEST_N) is build_contact_table(contact(0.7), LARGEST_N)
    assert build_contact_table(contact(0.7), LARGEST_N) is not build_contact_table(contact(0.71), LARGEST_N)


@pytest.mark.parametrize("force", [0.0, -1e-9, math.nan, math.inf])
def test_an_impossible_reach_is_refused(force):
    with pytest.raises(ValueError, match="largest force of the contact table"):
        build_contact_table(contact(0.8), force)
