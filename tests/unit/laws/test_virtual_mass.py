"""The virtual mass: its exact step, and its rules of coupling."""

import math

import pytest

from telenano.extend.laws import NO_SIGNAL, HandSample, TipMeasurement
from telenano.extend.virtual_mass import (
    ARRIVED_M,
    FARTHEST_M,
    FASTEST_M_PER_S,
    FOLLOWED_M,
    LONGEST_LEAD_M,
    HandPort,
    Mass,
    MassConfig,
    at_rest,
    begun_again,
    bounded,
    followed,
    has_arrived,
    is_coupled,
    is_retracted,
    kept_near,
    let_go,
    moved,
    paid_stretch,
    periods_in,
    placed,
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
    port = put_in(worked(HandPort(0.0, 0.0, 0.0, 0.0), hand, True), 1e-3, 1e-3)
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


# --- bounds, and where a base goes on ---


@pytest.mark.parametrize("value", [0.0, -0.0, 1.5, -1.5, 2.0, -2.0])
def test_a_value_within_its_bounds_keeps_its_bits(value: float) -> None:
    assert math.copysign(1.0, bounded(value, 2.0)) == math.copysign(1.0, value)
    assert bounded(value, 2.0) == value


@pytest.mark.parametrize(("value", "kept"), [(2.5, 2.0), (-2.5, -2.0), (math.inf, 2.0), (-math.inf, -2.0)])
def test_a_value_beyond_its_bounds_is_set_to_the_nearer_one(value: float, kept: float) -> None:
    assert bounded(value, 2.0) == kept


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_an_unstable_loop_stays_finite_at_a_million_metres_and_a_billion_a_second(sign: float) -> None:
    mass = at_rest(0.0)
    for _ in range(3):
        mass = moved(PARAMS, mass, sign * 1e300)
        assert (mass.position_m, mass.velocity_m_per_s) == (sign * 1e6, sign * 1e9)
    assert (FARTHEST_M, FASTEST_M_PER_S) == (1e6, 1e9)


def base_at(position_m: float, outstanding_m: float = 0.0) -> TipMeasurement:
    return TipMeasurement(position_m, 0.0, 5e-9, True, False, True, outstanding_m)


def test_a_base_has_arrived_within_a_millimetre_at_the_scale_of_the_hand() -> None:
    for off_m, arrived in ((0.0, True), (1.5e-9, True), (1.51e-9, False), (1e-6, False)):
        for sign in (1.0, -1.0):
            assert has_arrived(PARAMS, 1e-8, base_at(1e-8 + sign * off_m * (1.0 - 1e-9))) is arrived
    # what it was asked for and has not done yet is no lead
    assert has_arrived(PARAMS, 1e-8, base_at(-1e-6, 1.01e-6))
    # at a fine scale two steps of a converter count
    fine = PARAMS._replace(position_scale=1e-9)
    assert has_arrived(fine, 0.0, base_at(2.0 * FOLLOWED_M))
    assert not has_arrived(fine, 0.0, base_at(2.01 * FOLLOWED_M))
    assert (ARRIVED_M, FOLLOWED_M) == (1e-3, 6e-11)


@pytest.mark.parametrize(
    ("reference_m", "base_m", "outstanding_m", "on_m"),
    [
        # one that follows goes on from its reference
        (1e-8, 1e-8, 0.0, 1e-8),
        (1e-8, 1e-8 - 5e-11, 0.0, 1e-8),
        # one that was held goes on from where it is, but for a step of its converter
        (1e-8, 9e-9, 0.0, 9e-9 + 6e-11),
        (1e-8, 1.1e-8, 0.0, 1.1e-8 - 6e-11),
        # what a late instrument still does is no lead
        (1e-8, 9e-9, 1e-9, 1e-8),
        (1e-8, 8e-9, 1e-9, 9e-9 + 6e-11),
        # one that is somewhere else was sent there by something else, and comes
        (1e-8, -1e-6, 0.0, 1e-8),
    ],
)
def test_a_base_goes_on_from_where_it_will_be(
    reference_m: float, base_m: float, outstanding_m: float, on_m: float
) -> None:
    assert followed(PARAMS, reference_m, base_at(base_m, outstanding_m)) == pytest.approx(on_m, rel=1e-12, abs=0.0)


def test_a_tip_is_retracted_while_it_says_so() -> None:
    lately = NO_SIGNAL._replace(silence_s=0.05)
    assert is_retracted(PARAMS, lately)
    assert not is_retracted(PARAMS, lately._replace(silence_s=0.0501))
    assert not is_retracted(PARAMS, lately._replace(active=True))
    assert not is_retracted(PARAMS, lately._replace(in_contact=True))


# --- the settings and the port ---


def test_the_shipped_mass_has_the_impedance_and_the_scales_of_the_documentation() -> None:
    config = MassConfig()
    assert (config.mass_kg, config.damping_n_s_per_m) == (0.5, 100.0)
    assert (config.position_scale, config.force_scale, config.silence_limit_s) == (1.5e-6, 1e8, 0.05)
    # a damper of the law is added to that of the mass: the speed under 3 N is 3 N / (100 + 200) N s/m
    mass, params = at_rest(0.0), config.mass_params(PERIOD_S, 200.0)
    for _ in range(100):
        mass = moved(params, mass, 3.0)
    assert mass.velocity_m_per_s == pytest.approx(0.01, rel=1e-9, abs=0.0)
    assert config.mass_params(PERIOD_S) == config.mass_params(PERIOD_S, 0.0)


def test_a_mass_that_begins_is_at_rest_and_uncoupled() -> None:
    assert at_rest(3e-3) == Mass(3e-3, 0.0, 0.0, False)
    assert not resumed(PARAMS, HandSample(5e-3, 0.01, 1.0, True), 0.0).coupled
    assert moved(PARAMS, at_rest(3e-3), 0.0).coupled
    assert placed(Mass(1.0, 2.0, 3e-9, True), 4.0, 5.0) == Mass(4.0, 5.0, 3e-9, True)


@pytest.mark.parametrize("most_periods", [1, 2, 5])
@pytest.mark.parametrize(("share", "growth"), [(0.9, 0.8), (1.0, 1.0), (1.1, 1.2)])
def test_a_sample_at_the_limit_of_a_damper_is_swung_about_without_end(
    most_periods: int, share: float, growth: float
) -> None:
    config = MassConfig(position_scale=2e-6)
    stiffness = share * config.limit_of_damper(80.0, PERIOD_S, most_periods)
    # the base goes against the force of the beginning of a step through the damper, over the longest step
    at_hand = stiffness * config.force_scale * config.position_scale
    place, swings = 1e-3, []
    for _ in range(4):
        place -= most_periods * PERIOD_S * at_hand * place / 80.0
        swings.append(place)
    assert swings == pytest.approx([1e-3 * (-growth) ** n for n in range(1, 5)], rel=1e-9)
    assert config.limit_of_damper(80.0, PERIOD_S) == config.limit_of_damper(80.0, PERIOD_S, 1)


def test_work_that_the_channel_does_not_use_is_kept_up_to_a_millijoule() -> None:
    # the hand has worked 3 mJ and the channel has got 0.5 mJ of it
    port = put_in(HandPort(0.0, 3e-3, 0.0, 0.0), 0.5e-3, 0.5e-3)
    assert (port.credit_j, port.sent_j) == (1e-3, 0.5e-3)
    port = put_in(HandPort(0.0, 0.75e-3, 2e-4, 1e-4), 0.5e-3, 1e-4)
    # what was sent before is not taken back, and what was granted stays
    assert port == (0.0, pytest.approx(0.25e-3, rel=1e-12), 2e-4, 1e-4)


def test_work_without_a_law_is_no_work_and_changes_nothing_but_the_place() -> None:
    port = HandPort(1e-3, 2e-4, 3e-4, 4e-4)
    moved_hand = HandSample(2e-3, 0.0, 5.0, True)
    assert worked(port, moved_hand, False) == HandPort(2e-3, 2e-4, 3e-4, 4e-4)
    assert worked(port, moved_hand, True) == (2e-3, pytest.approx(2e-4 + 5e-3, rel=1e-12), 3e-4, 4e-4)


# --- a stretch that is paid ---


@pytest.mark.parametrize(
    ("stretch_m", "motion_m", "remaining_j"),
    [(0.0, 2e-3, 1e-3), (1e-3, 1e-3, 5e-4), (-1e-3, -2e-3, 2e-3), (0.0, -2e-3, 0.5e-3)],
)
def test_a_stretch_that_costs_too_much_goes_as_far_as_the_energy_left(
    stretch_m: float, motion_m: float, remaining_j: float
) -> None:
    # on a spring of 1 000 N/m
    cut, work_j = paid_stretch(stretch_m, motion_m, 1000.0, remaining_j)
    stored_j = [0.5 * 1000.0 * place**2 for place in (stretch_m, stretch_m + cut, stretch_m + motion_m)]
    assert stored_j[2] - stored_j[0] > remaining_j
    assert stored_j[1] - stored_j[0] == pytest.approx(remaining_j, rel=1e-9, abs=0.0)
    assert work_j == -remaining_j
    assert 0.0 < cut / motion_m < 1.0


def test_a_stretch_that_costs_what_is_left_is_not_cut() -> None:
    # 1 mm from rest on 1 000 N/m is half a millijoule
    cost_j = 0.5 * 1000.0 * 1e-3 * 1e-3
    assert paid_stretch(0.0, 1e-3, 1000.0, cost_j) == (1e-3, -cost_j)
    assert paid_stretch(0.0, 1e-3, 1000.0, 1.0) == (1e-3, -cost_j)


@pytest.mark.parametrize("remaining_j", [0.0, -1e-3])
def test_a_store_that_is_empty_or_overdrawn_stretches_nothing(remaining_j: float) -> None:
    cut, work_j = paid_stretch(1e-3, 1e-3, 1000.0, remaining_j)
    assert cut == pytest.approx(0.0, abs=1e-18)
    assert work_j == -remaining_j
