"""Passivity control, a period at a time: what each port moves, charges and sends, and what an interruption leaves."""

import math

import pytest

from services.controller.law import NO_SIGNAL, HandSample, TipMeasurement
from services.controller.laws.passivity import (
    PASSIVITY,
    Account,
    MasterState,
    PassivityConfig,
    SlaveState,
    charged,
    credited,
    master_receive,
    master_resume,
    master_send,
    master_start,
    opened,
    opened_anew,
    paid_motion,
    paid_stretch,
    received_anew,
    retune,
    slave_receive,
    slave_send,
    slave_start,
)
from services.controller.laws.shared.virtual_mass import Mass, moved

T = 1e-3
PARAMS = PassivityConfig().to_params(T)
# a base that slides a tenth of the way in a period, and a clamp that is never in the way
SLOW = PARAMS._replace(relaxed=0.1, margin_n=1e3)
SCALE = PARAMS.mass.position_scale
FREE = TipMeasurement(0.0, 0.0, 5e-9, True, False, True)
HAND = HandSample(0.0, 0.0, 0.0, True)
ANSWER = NO_SIGNAL._replace(active=True, silence_s=0.0)


def exactly(value: float) -> object:
    return pytest.approx(value, rel=1e-9, abs=1e-21)


def slave(
    stretch_m: float = 0.0, *, remaining_j: float = 4e-3, limit_n: float = 0.0, base_m: float = 0.0
) -> SlaveState:
    return SlaveState(base_m, stretch_m, 0.0, limit_n, Account(0.0, 0.0, remaining_j, 0.0, 1e-3), True)


def test_the_constants_of_the_steps_follow_from_the_settings() -> None:
    config = PassivityConfig(
        coupling_stiffness_n_per_m=1000.0, coupling_damping_n_s_per_m=50.0, speed_limit_m_per_s=0.25,
        force_margin_n=0.5, clamp_release_s=2.0, start_energy_j=3e-3, energy_cap_j=2e-3,
    )  # fmt: skip
    params = config.to_params(T)
    assert params.coupling_n_per_m == 1000.0
    assert params.relaxed == exactly(1.0 - math.exp(-1000.0 / 50.0 * T))
    assert params.step_m == exactly(0.25e-3)
    assert params.margin_n == 0.5
    assert params.release == exactly(1.0 - math.exp(-T / 2.0))
    # no side begins with more than it may keep
    assert (params.start_j, params.cap_j) == (2e-3, 2e-3)
    shipped = PassivityConfig()
    assert shipped.coupling_stiffness_n_per_m / shipped.coupling_damping_n_s_per_m == 50.0
    assert (shipped.start_energy_j, shipped.energy_cap_j, shipped.force_margin_n) == (1e-3, 5e-3, 0.0)
    assert (shipped.speed_limit_m_per_s, shipped.clamp_release_s) == (0.05, 4.0)


def test_an_account_keeps_each_direction_by_itself() -> None:
    account = Account(1.0, 2.0, 3.0, 4.0, 5.0)
    assert charged(account, 0.5, 0.25) == (1.5, 2.0, 3.0, 4.25, 5.0)
    assert charged(account, -0.5, 0.25) == (1.0, 2.0, 2.5, 4.25, 5.0)
    assert credited(account, 2.5, 10.0) == (1.0, 2.5, 3.5, 4.0, 5.0)
    assert credited(account, 3.0, 3.25) == (1.0, 3.0, 3.25, 4.75, 5.0)
    assert received_anew(account, 0.5, True) == (1.0, 0.5, 3.0, 4.0, 5.0)
    assert received_anew(account, 0.5, False) == account
    assert opened(1e-3) == (0.0, 0.0, 1e-3, 0.0, 1e-3)


def test_a_port_that_is_opened_anew_is_granted_what_is_missing_and_loses_what_is_too_much() -> None:
    poor = opened_anew(Account(1.0, 2.0, 0.25e-3, 4.0, 5.0), 1e-3)
    assert (poor.remaining_j, poor.lost_j, poor.granted_j) == (1e-3, 4.0, exactly(5.00075))
    rich = opened_anew(Account(1.0, 2.0, 3e-3, 4.0, 5.0), 1e-3)
    assert (rich.remaining_j, rich.lost_j, rich.granted_j) == (1e-3, exactly(4.002), 5.0)
    assert (poor.in_j, poor.received_j) == (rich.in_j, rich.received_j) == (1.0, 2.0)


@pytest.mark.parametrize("remaining_j", [0.0, 4e-3])
def test_both_ports_begin_with_the_starting_energy_again_when_the_tip_was_retracted(remaining_j: float) -> None:
    account = Account(7e-3, 6e-3, remaining_j, 0.0, 1e-3)
    retracted = NO_SIGNAL._replace(active=False, in_contact=False, silence_s=0.0, energy_j=6e-3)
    master, _ = master_receive(PARAMS, MasterState(Mass(0.0, 0.0, 0.0, True), account), HAND, retracted, T)
    away = FREE._replace(following=False)
    base, _ = slave_receive(PARAMS, slave()._replace(account=account), ANSWER._replace(energy_j=6e-3), away, T)
    for after in (master.account, base.account):
        assert after.remaining_j == PARAMS.start_j
        assert after.granted_j - after.lost_j == exactly(1e-3 + PARAMS.start_j - remaining_j)
    # a tip that still touches, or one that nothing is heard of, leaves the account as it is
    for signal in (retracted._replace(in_contact=True), retracted._replace(silence_s=1.0)):
        master, _ = master_receive(PARAMS, MasterState(Mass(0.0, 0.0, 0.0, True), account), HAND, signal, T)
        assert master.account == account
    held = slave()._replace(account=account)
    signal = ANSWER._replace(active=False, energy_j=6e-3)
    for tip in (away._replace(in_contact=True), FREE):
        assert slave_receive(PARAMS, held, signal, tip, T)[0].account == account


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_the_coupling_is_stretched_no_faster_than_the_speed_limit(way: float) -> None:
    # 10 mm are due at once
    signal = ANSWER._replace(position_m=way * 10e-3 * SCALE, force_n=1.0)
    state, reference = slave_receive(SLOW, slave(), signal, FREE, T)
    assert state.stretch_m == exactly(way * 0.9 * PARAMS.step_m)
    assert reference == (exactly(way * 0.1 * PARAMS.step_m * SCALE), True)
    # within it the whole of what is due is made up
    near = ANSWER._replace(position_m=way * 0.5 * PARAMS.step_m * SCALE, force_n=1.0)
    state, _ = slave_receive(SLOW, slave(), near, FREE, T)
    assert state.stretch_m == exactly(way * 0.45 * PARAMS.step_m)


def test_the_clamp_lets_the_coupling_press_no_harder_than_the_hand_and_its_margin() -> None:
    params = PARAMS._replace(relaxed=0.0, margin_n=0.005)
    signal = ANSWER._replace(position_m=10e-3 * SCALE, force_n=0.01 / PARAMS.mass.force_scale)
    state, _ = slave_receive(params, slave(), signal, FREE, T)
    assert state.stretch_m == exactly(0.015 / PARAMS.coupling_n_per_m)
    assert state.limit_n == exactly(0.01)
    # a hand that presses less is followed by the share of a period, and one that pulls at once
    less = signal._replace(force_n=0.004 / PARAMS.mass.force_scale)
    state, _ = slave_receive(params, slave(limit_n=0.01), less, FREE, T)
    assert state.limit_n == exactly(0.01 - 0.006 * params.release)
    pulls = signal._replace(force_n=-0.004 / PARAMS.mass.force_scale)
    state, _ = slave_receive(params, slave(limit_n=0.01), pulls, FREE, T)
    assert (state.limit_n, state.stretch_m) == (0.0, exactly(0.005 / PARAMS.coupling_n_per_m))


def test_the_slave_charges_the_work_of_its_motion_and_counts_what_was_refused_as_dissipated() -> None:
    k, wanted = PARAMS.coupling_n_per_m, PARAMS.step_m
    params = SLOW._replace(relaxed=0.0)
    signal = ANSWER._replace(position_m=10e-3 * SCALE, force_n=1.0)
    begin = 1e-5
    whole = k * wanted * (begin + 0.5 * wanted)
    state, _ = slave_receive(params, slave(begin), signal, FREE, T)
    assert state.account == (0.0, 0.0, exactly(4e-3 - whole), 0.0, 1e-3)
    # a third of the energy for it: the coupling goes as far as that reaches, the rest is dissipated
    state, _ = slave_receive(params, slave(begin, remaining_j=whole / 3.0), signal, FREE, T)
    assert 0.5 * k * (state.stretch_m**2 - begin**2) == exactly(whole / 3.0)
    assert state.account.remaining_j == exactly(0.0)
    assert state.account.lost_j == exactly(2.0 / 3.0 * whole)
    # what the coupling gives back goes into the channel
    back = signal._replace(position_m=-10e-3 * SCALE)
    state, _ = slave_receive(params, slave(2.0 * wanted), back, FREE, T)
    assert state.account.in_j == exactly(0.5 * k * (4.0 - 1.0) * wanted**2)


def test_the_base_slides_to_where_the_coupling_balances_the_measured_force() -> None:
    k = PARAMS.coupling_n_per_m
    tip = FREE._replace(force_n=0.03 / PARAMS.mass.force_scale, in_contact=True)
    state, reference = slave_receive(
        SLOW, slave(1e-4, base_m=2e-9), ANSWER._replace(position_m=2e-9 + 1e-4 * SCALE), tip, T
    )
    slid = 0.1 * (k * 1e-4 - 0.03) / k
    assert state.stretch_m == exactly(1e-4 - slid)
    assert reference.position_m == exactly(2e-9 + SCALE * slid)
    assert state.position_m == reference.position_m
    assert state.coupled


def test_a_half_begins_with_the_stretch_of_the_force_that_the_tip_feels() -> None:
    tip = FREE._replace(base_position_m=7e-9, force_n=2e-9)
    begun = slave_start(PARAMS, tip)
    stretch = PARAMS.mass.force_scale * 2e-9 / PARAMS.coupling_n_per_m
    assert begun == (7e-9, exactly(stretch), exactly(stretch), 0.0, opened(PARAMS.start_j), False)
    # uncoupled it stays where it is with that stretch; over a tip that does not follow it goes with the master, without
    silent = NO_SIGNAL._replace(position_m=9e-9)
    state, reference = slave_receive(PARAMS, begun, silent, tip, T)
    assert (state.position_m, state.stretch_m, state.lead_m) == (7e-9, exactly(stretch), exactly(stretch))
    assert reference == (7e-9, True)
    state, reference = slave_receive(PARAMS, begun, silent, tip._replace(following=False), T)
    assert (state.position_m, state.stretch_m, state.lead_m, state.coupled) == (9e-9, 0.0, 0.0, False)
    assert reference == (9e-9, True)


def test_the_lead_of_a_half_that_was_taken_up_stays_between_coupling_and_reference() -> None:
    state = slave(1e-4)._replace(lead_m=1e-4)
    after, reference = slave_receive(SLOW._replace(relaxed=0.0), state, ANSWER, FREE, T)
    assert (after.stretch_m, after.lead_m, reference.position_m) == (exactly(1e-4), 1e-4, 0.0)


def pressed(remaining_j: float) -> MasterState:
    return MasterState(Mass(1e-3, 0.0, 0.0, True), Account(0.0, 0.0, remaining_j, 0.0, 1e-3))


def test_a_free_hand_moves_the_mass_and_charges_the_work_against_the_channel() -> None:
    force = 2.0 / PARAMS.mass.force_scale
    hand = HAND._replace(force_n=10.0)
    state, reference = master_receive(PARAMS, pressed(4e-3), hand, ANSWER._replace(force_n=force), T)
    free = moved(PARAMS.mass, Mass(1e-3, 0.0, 0.0, True), 8.0)
    assert state.mass == free
    way = free.position_m - 1e-3
    assert state.account == (exactly(2.0 * way), 0.0, 4e-3, 0.0, 1e-3)
    assert reference == (free.position_m, free.velocity_m_per_s, exactly(2.0), True)
    # two periods are two steps
    twice, _ = master_receive(PARAMS, pressed(4e-3), hand, ANSWER._replace(force_n=force), 2.0 * T)
    assert twice.mass == moved(PARAMS.mass, free, 8.0)


def test_a_motion_that_was_cut_is_slower_and_what_it_would_have_taken_is_dissipated() -> None:
    # the channel drives the hand back and has energy for a part of the way only
    force = 5.0 / PARAMS.mass.force_scale
    free = moved(PARAMS.mass, Mass(1e-3, 0.0, 0.0, True), -5.0)
    wanted = free.position_m - 1e-3
    left = 0.25 * 5.0 * -wanted
    state, _ = master_receive(PARAMS, pressed(left), HAND, ANSWER._replace(force_n=force), T)
    cut = 0.25 * wanted
    assert state.mass.position_m == pytest.approx(1e-3 + cut, rel=0.0, abs=1e-16)
    assert state.mass.velocity_m_per_s == pytest.approx(max(free.velocity_m_per_s, cut / T), rel=1e-6, abs=0.0)
    assert abs(state.mass.velocity_m_per_s) == pytest.approx(-cut / T, rel=1e-6, abs=0.0)
    assert state.account.remaining_j == pytest.approx(0.0, abs=1e-18)
    assert state.account.lost_j == pytest.approx(0.75 * 5.0 * -wanted, rel=1e-6, abs=0.0)
    assert state.account.in_j == 0.0


def test_a_cut_motion_keeps_the_speed_of_the_free_one_where_that_is_lower() -> None:
    # it comes back at speed and is braked within the period: at its end it is slower than in the mean
    hand = HAND._replace(force_n=60.0)
    force = 5.0 / PARAMS.mass.force_scale
    start = Mass(1e-3, -0.1, 0.0, True)
    free = moved(PARAMS.mass, start, 55.0)
    own = moved(PARAMS.mass, start, 60.0).position_m - 1e-3
    wanted = free.position_m - 1e-3
    assert wanted < own < 0.0
    assert abs(free.velocity_m_per_s) < abs(wanted) / T
    state, _ = master_receive(PARAMS, MasterState(start, Account(0.0, 0.0, 0.0, 0.0, 0.0)), hand,
                              ANSWER._replace(force_n=force), T)  # fmt: skip
    # what the hand does by itself costs nothing
    assert state.mass.position_m - 1e-3 == pytest.approx(own, rel=1e-9, abs=0.0)
    assert state.mass.velocity_m_per_s == pytest.approx(-abs(free.velocity_m_per_s), rel=1e-9, abs=0.0)
    assert state.account.remaining_j == 0.0
    assert state.account.lost_j == pytest.approx(-5.0 * wanted, rel=1e-9, abs=0.0)


def test_a_motion_of_the_hand_is_cut_to_the_longer_of_its_own_way_and_the_paid_one() -> None:
    assert paid_motion(-3.0, -2.5, 1.0, 2.0) == (-2.5, 0.0)
    assert paid_motion(-3.0, -1.5, 1.0, 2.0) == (-2.0, -2.0)
    # just as far by itself as the energy pays for: then it is paid
    assert paid_motion(-3.0, -2.0, 1.0, 2.0) == (-2.0, -2.0)
    assert paid_motion(3.0, 2.5, -1.0, 2.0) == (2.5, 0.0)
    # its own way is no longer than the whole
    assert paid_motion(-3.0, -4.0, 1.0, 2.0) == (-3.0, 0.0)
    assert paid_motion(3.0, -4.0, 1.0, 0.0) == (3.0, 3.0)


def test_a_stretch_that_gives_energy_back_is_never_cut() -> None:
    motion, work = paid_stretch(1e-4, -0.5e-4, 1000.0, 0.0)
    assert (motion, work) == (-0.5e-4, exactly(0.5 * 1000.0 * (1e-8 - 0.25e-8)))
    motion, work = paid_stretch(1e-4, 1e-4, 1000.0, 0.0)
    assert (motion, work) == (exactly(0.0), 0.0)


def test_an_uncoupled_master_leaves_the_hand_alone_and_names_the_force_only_while_the_tip_answers() -> None:
    hand = HandSample(2e-3, 0.0, 1.0, False)
    state = pressed(1e-3)
    after, reference = master_receive(PARAMS, state, hand, ANSWER._replace(force_n=2e-8), T)
    assert (after.mass.position_m, after.mass.velocity_m_per_s, after.mass.coupled) == (2e-3, 0.0, False)
    assert reference == (2e-3, 0.0, exactly(2.0), True)
    _, reference = master_receive(PARAMS, state, hand, NO_SIGNAL._replace(force_n=2e-8), T)
    assert reference == (2e-3, 0.0, 0.0, False)


def test_each_port_sends_its_place_its_force_and_the_energy_that_went_in() -> None:
    mass = Mass(2e-3, 0.05, 1e-9, True)
    account = Account(4e-4, 0.0, 1e-3, 0.0, 1e-3)
    state = MasterState(mass, account)
    hand = HAND._replace(force_n=3.0)
    assert master_send(PARAMS, state, hand, T)[0] == state
    sent = master_send(PARAMS, state, hand, T)[1]
    assert sent == (exactly(SCALE * 2e-3 + 1e-9), exactly(SCALE * 0.05), exactly(3e-8), 0.0, 4e-4, 0.0, False, False,
                    True, 0.0, 0.0)  # fmt: skip
    assert not master_send(PARAMS, state, hand._replace(following=False), T)[1].active
    assert not master_send(PARAMS, MasterState(mass._replace(coupled=False), account), hand, T)[1].active
    base = SlaveState(1e-9, 2e-4, 0.0, 0.0, account, True)
    tip = TipMeasurement(3e-9, 1e-9, 5e-9, True, False, True)
    expected = exactly(PARAMS.coupling_n_per_m * 2e-4 / PARAMS.mass.force_scale)
    assert slave_send(PARAMS, base, tip, T) == (
        base,
        (3e-9, 0.0, expected, 0.0, 4e-4, 5e-9, True, False, True, 0.0, 0.0),
    )
    touching = tip._replace(separation_valid=False, in_contact=True, following=False)
    assert slave_send(PARAMS, base, touching, T)[1][6:9] == (False, True, False)


def test_the_energy_account_of_each_half_has_the_grants_of_both() -> None:
    account = Account(4e-4, 2e-4, 3e-4, 5e-4, 1e-3)
    assert PASSIVITY.master_energy_account(PARAMS, MasterState(Mass(0.0, 0.0, 0.0, True), account)) == (
        3e-4,
        5e-4,
        2e-3,
    )
    assert PASSIVITY.slave_energy_account(PARAMS, slave()._replace(account=account)) == (3e-4, 5e-4, 2e-3)
    # it fills the energy of the wire's message, and its slave half goes on between signals
    assert (PASSIVITY.uses_energy, PASSIVITY.local_loop, PASSIVITY.uses_waves) == (True, True, False)


def test_a_half_that_is_taken_over_goes_on_in_the_motion_of_the_hand() -> None:
    hand = HandSample(2e-3, 0.03, 0.0, True)
    state = master_resume(PARAMS, hand, 8e-9)
    assert state.account == opened(PARAMS.start_j)
    assert (state.mass.position_m, state.mass.velocity_m_per_s) == (2e-3, 0.03)
    assert master_send(PARAMS, state, hand, T)[1].position_m == exactly(8e-9)
    assert master_start(PARAMS, hand).mass.velocity_m_per_s == 0.0
    kept = retune(PARAMS, PARAMS._replace(cap_j=1.0), pressed(4e-3)._replace(account=Account(1.0, 2.0, 4e-3, 3.0, 4.0)))
    assert kept.account == (1.0, 2.0, 4e-3, 3.0, 4.0)
