import math

import numpy as np
import pytest
from instrument_theory import base_for

from telenano.afm.cantilever import PlantState, build_plant, deflection_m, equilibrium, initial_state, volts_per_m
from telenano.afm.contact.maugis_dugdale import reduced_modulus_pa
from telenano.afm.contact.tip_sample import (
    AS_PRINTED,
    CONSISTENT,
    TipSampleProperties,
    branch_force,
    build_tip_sample,
)

REST_M = 10e-9


def plant(k=40.0, reading=CONSISTENT, meniscus=True, modulus_pa=None, **changes):
    properties = TipSampleProperties(
        radius_m=10e-9,
        hamaker_j=1.89e-19,
        sigma_m=3.49e-10,
        work_of_adhesion_j_per_m2=0.072,
        reduced_modulus_pa=modulus_pa or reduced_modulus_pa(170e9, 0.5, 4e9, 0.3),
        liquid_energy_j_per_m2=0.073,
        meniscus_radius_m=1.2e-9,
        break_distance_m=4e-9,
        reading=reading,
        meniscus=meniscus,
    )
    return build_plant(build_tip_sample(properties._replace(**changes), 400e-9), k, REST_M, volts_per_m(2.5, 1e4, 1e3))


def trace(p, bases_m, state=None):
    """Distances, spring forces and branch flags along a motion of the base."""
    state = initial_state(p, bases_m[0]) if state is None else state
    rows = []
    for base in bases_m:
        state = equilibrium(p, state, base)
        force = p.stiffness_n_per_m * deflection_m(p, state.distance_m, base)
        rows.append((state.distance_m, force, state.contact, state.meniscus))
    return np.array(rows), state


def there_and_back(low_m, high_m, steps):
    up = np.linspace(low_m, high_m, steps)
    return np.concatenate([up, up[::-1]])


def test_read_out_gain_of_table_2():
    assert math.isclose(volts_per_m(2.5, 1e4, 1e3), 6.25e-3 / 1e-9, rel_tol=1e-12)


@pytest.mark.parametrize("meniscus", [False, True])
@pytest.mark.parametrize("k", [0.1, 1.0, 8.0, 40.0, 1000.0])
def test_forces_balance_and_the_equilibrium_is_stable(k, meniscus):
    p = plant(k, meniscus=meniscus)
    rng = np.random.default_rng(5)
    state = initial_state(p, -100e-9)
    reach = 200e-9 if k < 1 else 15e-9
    for base in np.concatenate([rng.uniform(-reach, 14e-9, 400), there_and_back(-reach, 14e-9, 300)]):
        state = equilibrium(p, state, base)
        force, gradient = branch_force(p.tip, state.distance_m, state.contact, state.meniscus)
        assert math.isclose(k * deflection_m(p, state.distance_m, base), force, rel_tol=1e-9, abs_tol=1e-9 * 1e-9)
        assert gradient < k


def slow_walk(p, state, base_m, step_m=2e-13):
    """Follow the net force in tiny steps until it turns, knowing no intervals and no roots."""
    h, contact, meniscus = state
    direction = 0
    for _ in range(400_000):
        force = branch_force(p.tip, h, contact, meniscus)[0]
        net = force - p.stiffness_n_per_m * (h + base_m - REST_M)
        sign = 1 if net > 0 else -1
        if direction != 0 and sign != direction:
            return PlantState(h, contact, meniscus)
        direction = sign
        h += sign * step_m
        if not contact and h < p.tip.contact_onset_m:
            contact = True
        elif contact and h > p.tip.contact_end_m:
            contact = False
        if p.tip.has_meniscus and not meniscus and h < p.tip.meniscus_width_m:
            meniscus = True
        elif meniscus and h > p.tip.meniscus_break_m:
            meniscus = False
    raise AssertionError("the walk did not end")


@pytest.mark.check("walks slowly")
@pytest.mark.parametrize(("k", "soft"), [(40.0, False), (8.0, False), (2.0, False), (2.0, True)])
def test_agrees_with_a_slow_walk_along_the_net_force(k, soft):
    p = plant(k, modulus_pa=1.5e9 if soft else None)
    state = initial_state(p, 0.0)
    rng = np.random.default_rng(9)
    for base in np.concatenate([rng.uniform(4e-9, 11e-9, 12), [8.2e-9, 9.6e-9, 8.6e-9, 5.0e-9]]):
        expected = slow_walk(p, state, base)
        state = equilibrium(p, state, base)
        assert abs(state.distance_m - expected.distance_m) < 1e-12
        assert (state.contact, state.meniscus) == (expected.contact, expected.meniscus)


@pytest.mark.parametrize("reading", [CONSISTENT, AS_PRINTED])
@pytest.mark.parametrize("k", [0.1, 2.0, 40.0])
def test_the_outcome_does_not_depend_on_the_steps(k, reading):
    p = plant(k, reading=reading)
    start = initial_state(p, -150e-9)
    for first, second in ((12e-9, -140e-9), (9.5e-9, 6e-9), (8e-9, 5e-9), (13e-9, 9e-9)):
        ends = []
        for steps in (1, 7, 400):
            there, state = trace(p, np.linspace(-150e-9, first, steps + 1)[1:], start)
            back, state = trace(p, np.linspace(first, second, steps + 1)[1:], state)
            ends.append((there[-1], back[-1], state))
        for there, back, state in ends[1:]:
            assert math.isclose(there[0], ends[0][0][0], rel_tol=0, abs_tol=1e-16)
            assert math.isclose(back[0], ends[0][1][0], rel_tol=0, abs_tol=1e-16)
            assert state[1:] == ends[0][2][1:]


def test_a_small_step_away_from_folds_moves_the_tip_a_little():
    p = plant(40.0)
    rows, _ = trace(p, np.linspace(9.6e-9, 12e-9, 2401))
    moves = np.abs(np.diff(rows[:, 0]))
    assert moves.max() < 1.2e-12


def loop_area(p, low_m, high_m, steps=4000):
    bases = there_and_back(low_m, high_m, steps)
    rows, _ = trace(p, bases)
    return float(np.trapezoid(rows[:, 1] * 1e9, bases * 1e9))  # nN nm


def test_the_meniscus_makes_hysteresis_and_a_stiff_dry_cantilever_has_none():
    assert loop_area(plant(40.0), 0.0, 12e-9) > 1.0
    assert abs(loop_area(plant(40.0, meniscus=False), 0.0, 12e-9)) < 1e-9
    assert loop_area(plant(0.5, meniscus=False), -60e-9, 12e-9) > 1.0


def test_the_folding_contact_has_hysteresis_of_its_own():
    soft = plant(1e4, meniscus=False, modulus_pa=1.5e9)
    assert soft.tip.table.contact.transition > 0.938
    assert loop_area(soft, 9e-9, 11e-9) > 1e-2
    assert abs(loop_area(plant(1e4, meniscus=False), 9e-9, 11e-9)) < 1e-9


@pytest.mark.check("takes 1.0 s")
def test_the_meniscus_forms_and_breaks_where_it_should():
    p = plant(40.0)
    bases = there_and_back(0.0, 12e-9, 24001)
    rows, _ = trace(p, bases)
    changes = np.flatnonzero(np.diff(rows[:, 3]))
    assert len(changes) == 2
    formed, broken = changes
    assert 2.4e-9 <= rows[formed, 0] < 2.402e-9
    assert 3.998e-9 < rows[broken, 0] <= 4.0e-9
    assert rows[formed + 1, 1] < rows[formed, 1]  # pulls harder at once
    assert rows[broken + 1, 1] > rows[broken, 1]


def test_a_soft_cantilever_snaps_in_and_pulls_off():
    p = plant(0.1)
    rows, _ = trace(p, there_and_back(-200e-9, 12e-9, 4001))
    jumps = np.abs(np.diff(rows[:, 0]))
    snap_in, pull_off = np.argsort(jumps)[-2:][::-1]
    snap_in, pull_off = sorted((snap_in, pull_off))
    assert not rows[snap_in, 2] and rows[snap_in + 1, 2]
    assert rows[pull_off, 2] and not rows[pull_off + 1, 2]
    assert jumps[pull_off] > 100e-9
    assert round(rows[:, 1].min() * 1e9, 1) == -12.5


def test_far_away_there_is_no_force():
    for base in (-100e-9, -1e-6, -1e-4, -1.0):
        state = initial_state(plant(), base)
        assert math.isclose(state.distance_m, REST_M - base, rel_tol=1e-4)
        assert not state.contact and not state.meniscus


@pytest.mark.parametrize("k", [0.01, 40.0, 1e4])
def test_any_step_ends_in_a_finite_balance(k):
    p = plant(k)
    state = initial_state(p, 0.0)
    for base in (1e-6, -1e-6, 1e-3, -1.0, 1.0, 0.0, 5e-324, 9.4e-9):
        state = equilibrium(p, state, base)
        assert math.isfinite(state.distance_m)
        force = branch_force(p.tip, state.distance_m, state.contact, state.meniscus)[0]
        spring = k * deflection_m(p, state.distance_m, base)
        assert math.isclose(force, spring, rel_tol=1e-6, abs_tol=1e-18 + 1e-15 * k * abs(base))


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_a_base_that_is_no_number_is_refused(bad):
    p = plant()
    with pytest.raises(ValueError, match="must be finite"):
        equilibrium(p, initial_state(p, 0.0), bad)


def test_as_printed_the_tip_rests_at_the_inverted_step():
    # the approach force acts beyond 2 r1 only: there the tip is pushed back from both sides
    p = plant(8.0, reading=AS_PRINTED)
    state = initial_state(p, 0.0)
    held = []
    for base in np.linspace(0.0, 9e-9, 9001):
        state = equilibrium(p, state, base)
        if state.distance_m == p.tip.meniscus_width_m:
            force = p.stiffness_n_per_m * deflection_m(p, state.distance_m, base)
            held.append(force)
    inside = branch_force(p.tip, math.nextafter(p.tip.meniscus_width_m, 0), False, False)[0]
    outside = branch_force(p.tip, p.tip.meniscus_width_m, False, False)[0]
    assert len(held) > 100
    assert outside <= min(held) < max(held) <= inside


def test_as_printed_the_retract_law_follows_a_contact():
    p = plant(40.0, reading=AS_PRINTED)
    rows, _ = trace(p, np.linspace(0.0, 12e-9, 2001))
    approach_flags = rows[rows[:, 2] == 0][:, 3]
    assert not approach_flags.any()
    assert rows[-1, 2] and rows[-1, 3]
    back, _ = trace(p, np.linspace(12e-9, 0.0, 8001), PlantState(rows[-1, 0], True, True))
    free = np.flatnonzero(back[:, 2] == 0)
    broken = np.flatnonzero(back[:, 3] == 0)
    assert back[free[5], 3] == 1
    assert 3.99e-9 < back[broken[0] - 1, 0] <= 4e-9
    # resting at the switch between contact and the retract law counts as contact, and does not flutter
    assert np.count_nonzero(np.diff(back[:, 2])) == 1


def test_a_thin_water_film_bridges_only_in_contact():
    # 2 r1 below the hand-over distance: contact comes first, then the meniscus
    p = plant(40.0, meniscus_radius_m=0.11e-9)
    rows, _ = trace(p, there_and_back(5e-9, 12e-9, 7001))
    first = np.flatnonzero(rows[:, 2])[0]
    assert np.flatnonzero(rows[:, 3])[0] >= first
    assert not rows[-1, 2] and not rows[-1, 3]
    assert np.isfinite(rows).all()


def test_a_state_from_other_parameters_finds_its_branch():
    dry = plant(40.0, meniscus=False)
    state = equilibrium(dry, PlantState(1e-9, False, True), 5e-9)
    assert not state.meniscus
    assert not equilibrium(dry, PlantState(5e-9, True, True), 0.0).contact
    assert equilibrium(dry, PlantState(-1e-9, False, False), 12e-9).contact


def test_base_for_is_the_inverse_of_the_equilibrium():
    p = plant(40.0)
    state = initial_state(p, 0.0)
    for base in np.linspace(0, 13e-9, 50):
        state = equilibrium(p, state, base)
        assert math.isclose(base_for(p, *state), base, rel_tol=0, abs_tol=1e-17)


@pytest.mark.parametrize(
    ("k", "rest", "gain", "message"),
    [
        (0.0, 1e-8, 1.0, "k = 0.0 N/m"),
        (math.nan, 1e-8, 1.0, "k = nan N/m"),
        (40.0, -1e-8, 1.0, "L = -1e-08 m"),
        (40.0, 1e-8, math.inf, "gain = inf V/m"),
    ],
)
def test_impossible_cantilevers_are_named(k, rest, gain, message):
    with pytest.raises(ValueError, match=message):
        build_plant(plant().tip, k, rest, gain)
