"""The virtual mass: its exact step, and its rules of coupling."""

import math

import pytest

from telenano.laws.law import NO_SIGNAL, HandSample
from telenano.laws.shared.virtual_mass import (
    LONGEST_LEAD_M,
    HandPort,
    Mass,
    MassConfig,
    at_rest,
    begun_again,
    is_coupled,
    kept_near,
    let_go,
    moved,
    periods_in,
    port_at,
    put_in,
    rescaled,
    resumed,
    tip_reference,
    unpaid_j,
    worked,
)

PERIOD_S = 1e-3
PARAMS = MassConfig().mass_params(PERIOD_S)


def test_motion_under_a_held_force_is_the_closed_form() -> None:
    mass, force, tau = at_rest(0.0), 0.7, 0.5 / 100.0
    for _ in range(40):
        mass = moved(PARAMS, mass, force)
    t = 40 * PERIOD_S
    x = force / 100.0 * (t - tau * (1.0 - math.exp(-t / tau)))
    assert mass.position_m == pytest.approx(x, rel=1e-12, abs=0.0)
    assert mass.velocity_m_per_s == pytest.approx(force / 100.0 * (1.0 - math.exp(-t / tau)), rel=1e-12, abs=0.0)


@pytest.mark.parametrize("period_s", [1e-4, 1e-3, 1e-2, 0.1])
def test_step_does_not_depend_on_how_time_is_cut(period_s: float) -> None:
    whole = moved(MassConfig().mass_params(period_s), Mass(1e-3, 2e-2, 0.0, True), 0.3)
    half_params = MassConfig().mass_params(0.5 * period_s)
    halves = moved(half_params, moved(half_params, Mass(1e-3, 2e-2, 0.0, True), 0.3), 0.3)
    assert whole.position_m == pytest.approx(halves.position_m, rel=1e-12, abs=0.0)
    assert whole.velocity_m_per_s == pytest.approx(halves.velocity_m_per_s, rel=1e-11, abs=0.0)


def test_damper_of_the_line_adds_to_that_of_the_mass() -> None:
    assert MassConfig().mass_params(PERIOD_S, 50.0) == MassConfig(damping_n_s_per_m=150.0).mass_params(PERIOD_S)


def test_let_go_moves_the_mass_and_not_the_tip() -> None:
    mass = Mass(7e-3, 0.02, 3e-10, True)
    free = let_go(PARAMS, mass, HandSample(5e-3, 0.0, 1.0, True), NO_SIGNAL)
    assert (free.position_m, free.velocity_m_per_s, free.coupled) == (5e-3, 0.0, False)
    assert tip_reference(PARAMS, free) == pytest.approx(tip_reference(PARAMS, mass), rel=1e-14, abs=0.0)


def test_over_a_retracted_tip_hand_and_tip_are_on_the_line_through_zero() -> None:
    mass, hand = Mass(7e-3, 0.02, 3e-10, True), HandSample(5e-3, 0.0, 1.0, True)
    retracted = NO_SIGNAL._replace(silence_s=0.0)
    assert let_go(PARAMS, mass, hand, retracted) == Mass(5e-3, 0.0, 0.0, False)
    # a tip that still touches, or that nobody hears, may be on the sample
    for other in (retracted._replace(in_contact=True), retracted._replace(active=True), NO_SIGNAL):
        assert let_go(PARAMS, mass, hand, other).tip_offset_m == pytest.approx(3.3e-9, rel=1e-12, abs=0.0)


def test_resumed_keeps_motion_and_tip() -> None:
    mass = resumed(PARAMS, HandSample(5e-3, 0.01, 1.0, True), 1.23e-8)
    assert (mass.position_m, mass.velocity_m_per_s) == (5e-3, 0.01)
    assert tip_reference(PARAMS, mass) == pytest.approx(1.23e-8, rel=1e-14, abs=0.0)


def test_rescaled_keeps_the_tip() -> None:
    mass, other = Mass(7e-3, 0.02, 3e-10, True), MassConfig(position_scale=1e-7).mass_params(PERIOD_S)
    after = tip_reference(other, rescaled(PARAMS, other, mass))
    assert after == pytest.approx(tip_reference(PARAMS, mass), rel=1e-13, abs=0.0)


@pytest.mark.parametrize(
    ("active", "silence_s", "coupled"), [(True, 0.05, True), (True, 0.0501, False), (False, 0.0, False)]
)
def test_coupling_needs_a_tip_that_follows_and_sends(active: bool, silence_s: float, coupled: bool) -> None:
    assert is_coupled(PARAMS, NO_SIGNAL._replace(active=active, silence_s=silence_s)) is coupled


@pytest.mark.parametrize(("dt", "count"), [(0.0, 1), (1e-3, 1), (1.4e-3, 1), (1.6e-3, 2), (0.05, 50)])
def test_whole_periods_in_a_time(dt: float, count: int) -> None:
    assert periods_in(dt, PERIOD_S) == count


def test_energy_of_the_channel_is_sent_when_the_hand_has_worked_for_it_at_its_device() -> None:
    hand = HandSample(0.0, 0.0, 2.0, True)
    # the reference goes 1 mm against 1 N and the device stands
    port = put_in(worked(port_at(0.0), hand, True), 1e-3, 1e-3)
    assert (port.sent_j, unpaid_j(port)) == (0.0, 1e-3)
    # the device comes a quarter of the way under 2 N, and all of it later
    port = put_in(worked(port, hand._replace(position_m=2.5e-4), True), 0.0, 1e-3)
    assert port.sent_j == pytest.approx(5e-4, rel=1e-12)
    port = put_in(worked(port, hand._replace(position_m=1e-3), True), 0.0, 1e-3)
    assert (port.sent_j, unpaid_j(port)) == (1e-3, 0.0)
    # a device that was moved by no law has not worked
    assert worked(port, hand._replace(position_m=0.1), False).credit_j == port.credit_j


def test_what_is_left_over_of_the_work_of_a_hand_is_forgotten_and_what_is_owed_is_not() -> None:
    assert begun_again(HandPort(0.0, 5e-4, 1e-3, 0.0), 1e-3, False).credit_j == 0.0
    # what was never sent need not be paid
    assert begun_again(HandPort(0.0, -2e-4, 1e-3, 0.0), 1.25e-3, False).credit_j == 0.0
    owed = HandPort(0.0, -5e-4, 1e-3, 0.0)
    assert begun_again(owed, 1.2e-3, False).credit_j == pytest.approx(-3e-4, rel=1e-12)
    assert begun_again(owed, 1.2e-3, True) == (0.0, 0.0, 1e-3, pytest.approx(3e-4, rel=1e-12))


def test_a_reference_stops_where_its_device_cannot_be_following_and_never_jumps_back() -> None:
    before, after = Mass(1.9e-3, 0.5, 0.0, True), Mass(2.4e-3, 0.5, 0.0, True)
    assert kept_near(before, after, 0.5e-3) == after
    assert kept_near(before, after, 0.0) == Mass(LONGEST_LEAD_M, 0.0, 0.0, True)
    assert kept_near(before, after, -1e-3).position_m == pytest.approx(before.position_m, rel=1e-12)
    assert kept_near(before, Mass(1.5e-3, -0.4, 0.0, True), -1e-3).velocity_m_per_s == -0.4
