"""Passivity control, a period at a time: what each port moves, charges and sends, and what an interruption leaves."""

import math

import pytest

from telenano.extend.laws import NO_SIGNAL, HandSample, TipMeasurement
from telenano.extend.virtual_mass import NOTHING_HEARD, HandPort, Mass, moved, paid_stretch
from telenano.laws.passivity import (
    Account,
    MasterState,
    SlaveState,
    charged,
    credited,
    master_receive,
    master_resume,
    master_send,
    master_start,
    opened,
    paid_motion,
    recount_received,
    reopen,
    retune,
    shared_out,
    slave_receive,
    slave_retune,
    slave_send,
    slave_start,
    taken,
)
from telenano.sections.own_laws import PASSIVITY, PassivityConfig

T = 1e-3
SHIPPED = PassivityConfig().to_params(T)
# what a store sends to the other side, and the damper that fills it, have tests of their own
PARAMS = SHIPPED._replace(shared=0.0, refill_n_s_per_m=0.0)
# a base that slides a tenth of the way in a period, and a clamp that is never in the way
SLOW = PARAMS._replace(relaxed=0.1, margin_n=1e3)
SCALE = PARAMS.mass.position_scale
FREE = TipMeasurement(0.0, 0.0, 5e-9, True, False, True, 0.0)
HAND = HandSample(0.0, 0.0, 0.0, True)
ANSWER = NO_SIGNAL._replace(active=True, silence_s=0.0)


def exactly(value: float) -> object:
    return pytest.approx(value, rel=1e-9, abs=1e-21)


def slave(
    stretch_m: float = 0.0, *, remaining_j: float = 4e-3, limit_n: float = 0.0, base_m: float = 0.0
) -> SlaveState:
    account = Account(0.0, 0.0, remaining_j, 0.0, 1e-3)
    return SlaveState(base_m, stretch_m, 0.0, limit_n, base_m, 0.0, account, True)


def master(mass: Mass, account: Account) -> MasterState:
    """Return a half whose hand has worked enough at its device to pay for all that it has put in."""
    return MasterState(mass, account, 0.0, HandPort(0.0, 1e-3, account.in_j, 0.0))


def test_the_constants_of_the_steps_follow_from_the_settings() -> None:
    config = PassivityConfig(
        coupling_stiffness_n_per_m=1000.0, coupling_damping_n_s_per_m=50.0, speed_limit_m_per_s=0.25,
        force_margin_n=0.5, clamp_release_s=2.0, start_energy_j=3e-3, energy_cap_j=2e-3,
        refill_damping_n_s_per_m=250.0, exchange_s=0.5,
    )  # fmt: skip
    params = config.to_params(T)
    assert params.coupling_n_per_m == 1000.0
    assert params.relaxed == exactly(1.0 - math.exp(-1000.0 / 50.0 * T))
    assert params.step_m == exactly(0.25e-3)
    assert params.margin_n == 0.5
    assert params.release == exactly(1.0 - math.exp(-T / 2.0))
    # no side begins with more than it may keep
    assert params.let_go == exactly(1.0 - math.exp(-T / 0.2))
    assert (params.start_j, params.cap_j, params.level_j) == (2e-3, 2e-3, 2e-3)
    assert params.refill_n_s_per_m == 250.0
    assert params.shared == exactly(1.0 - math.exp(-T / 0.5))
    # a store that begins empty has a level all the same, and a clamp that follows faster does so for any hand
    odd = PassivityConfig(start_energy_j=0.0, clamp_release_s=0.1).to_params(T)
    assert (odd.start_j, odd.level_j, odd.let_go) == (0.0, 1e-9, odd.release)
    shipped = PassivityConfig()
    assert shipped.coupling_stiffness_n_per_m / shipped.coupling_damping_n_s_per_m == 25.0
    assert (shipped.start_energy_j, shipped.energy_cap_j, shipped.force_margin_n) == (1e-3, 5e-3, 0.0)
    assert (shipped.speed_limit_m_per_s, shipped.clamp_release_s) == (0.05, 4.0)
    assert (shipped.refill_damping_n_s_per_m, shipped.exchange_s, shipped.silence_limit_s) == (460.0, 0.15, 0.5)


def test_an_account_keeps_each_direction_by_itself() -> None:
    account = Account(1.0, 2.0, 3.0, 4.0, 5.0)
    assert charged(account, 0.5, 0.25) == (1.5, 2.0, 3.0, 4.25, 5.0)
    assert charged(account, -0.5, 0.25) == (1.0, 2.0, 2.5, 4.25, 5.0)
    assert credited(account, 2.5, 10.0) == (1.0, 2.5, 3.5, 4.0, 5.0)
    assert credited(account, 3.0, 3.25) == (1.0, 3.0, 3.25, 4.75, 5.0)
    assert recount_received(account, 0.5, True) == (1.0, 0.5, 3.0, 4.0, 5.0)
    assert recount_received(account, 0.5, False) == account
    assert opened(1e-3) == (0.0, NOTHING_HEARD, 1e-3, 0.0, 1e-3)
    # the first signal is where it begins to count
    assert credited(opened(1e-3), 2.5, 10.0) == (0.0, 2.5, 1e-3, 0.0, 1e-3)


def test_a_port_that_is_opened_anew_is_granted_what_is_missing_and_loses_what_is_too_much() -> None:
    poor = reopen(Account(1.0, 2.0, 0.25e-3, 4.0, 5.0), 1e-3, 0.5)
    assert (poor.remaining_j, poor.lost_j, poor.granted_j) == (1e-3, 4.0, exactly(5.00075))
    rich = reopen(Account(1.0, 2.0, 3e-3, 4.0, 5.0), 1e-3, 1.0)
    assert (rich.remaining_j, rich.lost_j, rich.granted_j) == (1e-3, exactly(4.002), 5.0)
    assert (poor.in_j, poor.received_j) == (0.5, 2.0)
    assert (rich.in_j, rich.received_j) == (1.0, 2.0)


@pytest.mark.parametrize("remaining_j", [0.0, 4e-3])
def test_both_ports_begin_with_the_starting_energy_again_when_the_tip_was_retracted(remaining_j: float) -> None:
    account = Account(7e-3, 6e-3, remaining_j, 0.0, 1e-3)
    retracted = NO_SIGNAL._replace(active=False, in_contact=False, silence_s=0.0, energy_j=6e-3)
    hand, _ = master_receive(PARAMS, master(Mass(0.0, 0.0, 0.0, True), account), HAND, retracted, T)
    away = FREE._replace(following=False)
    base, _ = slave_receive(PARAMS, slave()._replace(account=account), ANSWER._replace(energy_j=6e-3), away, T)
    for after in (hand.account, base.account):
        assert after.remaining_j == PARAMS.start_j
        assert after.granted_j - after.lost_j == exactly(1e-3 + PARAMS.start_j - remaining_j)
    # what a hand has left unpaid of what was sent is granted, and nothing of it is owed after the arming
    owes = master(Mass(0.0, 0.0, 0.0, True), account)._replace(port=HandPort(0.0, -1e-3, account.in_j, 0.0))
    again, _ = master_receive(PARAMS, owes, HAND, retracted, T)
    assert (again.port.credit_j, again.port.granted_j) == (0.0, exactly(1e-3))
    # a tip that still touches, or one that nothing is heard of, leaves the account as it is
    for signal in (retracted._replace(in_contact=True), retracted._replace(silence_s=1.0)):
        hand, _ = master_receive(PARAMS, master(Mass(0.0, 0.0, 0.0, True), account), HAND, signal, T)
        assert hand.account == account
    held = slave()._replace(account=account)
    signal = ANSWER._replace(active=False, energy_j=6e-3)
    for tip in (away._replace(in_contact=True), FREE):
        assert slave_receive(PARAMS, held, signal, tip, T)[0].account == account
    # up to the limit of silence a signal counts
    last = signal._replace(silence_s=PARAMS.mass.silence_limit_s, energy_j=5e-3)
    assert slave_receive(PARAMS, held, last, FREE, T)[0].account.received_j == 5e-3
    hand, _ = master_receive(PARAMS, master(Mass(0.0, 0.0, 0.0, True), account), HAND, last, T)
    assert hand.account.received_j == 5e-3


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_the_coupling_is_stretched_no_faster_than_the_speed_limit(way: float) -> None:
    # 10 mm are due at once
    signal = ANSWER._replace(position_m=way * 10e-3 * SCALE, force_n=1.0)
    state, reference = slave_receive(SLOW, slave(), signal, FREE, T)
    assert state.stretch_m == exactly(way * PARAMS.step_m)
    assert reference == (exactly(way * 0.1 * PARAMS.step_m * SCALE), True)
    # within it the whole of what is due is made up
    near = ANSWER._replace(position_m=way * 0.5 * PARAMS.step_m * SCALE, force_n=1.0)
    state, _ = slave_receive(SLOW, slave(), near, FREE, T)
    assert state.stretch_m == exactly(way * 0.5 * PARAMS.step_m)


def test_the_clamp_lets_the_coupling_press_no_harder_than_the_hand_and_its_margin() -> None:
    params = PARAMS._replace(relaxed=0.0, margin_n=0.005)
    signal = ANSWER._replace(position_m=10e-3 * SCALE, force_n=0.01 / PARAMS.mass.force_scale)
    state, _ = slave_receive(params, slave(), signal, FREE, T)
    assert state.stretch_m == exactly(0.015 / PARAMS.coupling_n_per_m)
    assert state.limit_n == exactly(0.01)
    # a hand that presses less is followed by the share of a period, and one that no longer presses by a greater one
    less = signal._replace(force_n=0.004 / PARAMS.mass.force_scale)
    state, _ = slave_receive(params, slave(limit_n=0.01), less, FREE, T)
    assert state.limit_n == exactly(0.01 - 0.006 * params.release)
    pulls = signal._replace(force_n=-0.004 / PARAMS.mass.force_scale)
    state, _ = slave_receive(params, slave(limit_n=0.01), pulls, FREE, T)
    assert state.limit_n == exactly(0.01 * (1.0 - params.let_go))
    assert state.stretch_m == exactly((0.005 + state.limit_n) / PARAMS.coupling_n_per_m)
    assert params.let_go == exactly(1.0 - math.exp(-T / 0.2))


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
    tip = FREE._replace(base_position_m=2e-9, force_n=0.03 / PARAMS.mass.force_scale, in_contact=True)
    before = slave(1e-4, base_m=2e-9)._replace(last_n=0.03)
    state, reference = slave_receive(SLOW, before, ANSWER._replace(position_m=2e-9 + 1e-4 * SCALE), tip, T)
    slid = 0.1 * (k * 1e-4 - 0.03) / k
    # the stretch is that of where the base was measured, until the base has gone there
    assert (state.stretch_m, state.last_m, state.last_n) == (exactly(1e-4), 2e-9, exactly(0.03))
    assert reference.position_m == exactly(2e-9 + SCALE * slid)
    assert state.position_m == reference.position_m
    assert state.coupled
    there = tip._replace(base_position_m=reference.position_m)
    after, _ = slave_receive(SLOW, state, ANSWER._replace(position_m=2e-9 + 1e-4 * SCALE), there, T)
    assert after.stretch_m == exactly(1e-4 - slid)
    assert after.account.in_j == exactly(0.0)


def test_what_the_coupling_gives_and_the_sample_does_not_get_is_kept_and_what_is_missing_is_charged() -> None:
    k = PARAMS.coupling_n_per_m
    still = ANSWER._replace(position_m=0.0)
    params = PARAMS._replace(step_m=0.0)
    for force_n, last_n in ((0.02, 0.0), (0.3, 0.0), (0.02, 0.05)):
        before = slave(1e-4)._replace(last_n=last_n)
        tip = FREE._replace(base_position_m=0.4e-4 * SCALE, force_n=force_n / PARAMS.mass.force_scale)
        state, _ = slave_receive(params, before, still, tip, T)
        gave = 0.5 * k * (1e-4**2 - 0.6e-4**2)
        got = 0.5 * (force_n + last_n) * 0.4e-4
        assert state.account.remaining_j == exactly(4e-3 + gave - got)
        assert (gave > got) == (force_n < 0.1)
        assert state.stretch_m == exactly(0.6e-4)


@pytest.mark.parametrize("messages", [2, 30, 1000])
def test_messages_of_a_burst_that_the_base_has_not_followed_move_it_no_further_than_one(messages: int) -> None:
    signal = ANSWER._replace(position_m=1e-3 * SCALE, force_n=1.0 / PARAMS.mass.force_scale)
    tip = FREE._replace(force_n=0.4 / PARAMS.mass.force_scale, in_contact=True)
    state = slave(1.0 / PARAMS.coupling_n_per_m)._replace(last_n=0.4)
    one, _ = slave_receive(PARAMS, state, signal, tip, T)
    for _ in range(messages):
        state, reference = slave_receive(PARAMS, state, signal, tip, T)
    # and half a step of a converter of 12 bits, which takes a reference further before the base moves at all
    assert reference.position_m <= 6e-11 + one.position_m * (1.0 + 1e-9)


def test_a_half_that_has_overdrawn_its_store_presses_no_further_and_gives_way_by_small_steps() -> None:
    params = PARAMS._replace(step_m=0.0)
    pushed = FREE._replace(force_n=0.1 / PARAMS.mass.force_scale)
    for stretch_m, share in ((1e-4, 0.0), (1e-5, 0.25)):
        rich = slave_receive(params, slave(stretch_m)._replace(last_n=0.1), ANSWER, pushed, T)[0]
        poor = slave_receive(params, slave(stretch_m, remaining_j=-1e-6)._replace(last_n=0.1), ANSWER, pushed, T)[0]
        assert (rich.position_m < 0.0) == (share > 0.0)
        assert poor.position_m == exactly(share * rich.position_m)
        # a store that is empty is not overdrawn
        empty = slave_receive(params, slave(stretch_m, remaining_j=0.0)._replace(last_n=0.1), ANSWER, pushed, T)[0]
        assert empty.position_m == rich.position_m
    # a tip that feels nothing is not pressed
    free, poor = (slave_receive(params, slave(1e-4, remaining_j=e), ANSWER, FREE, T)[0] for e in (0.0, -1e-6))
    assert 0.0 < poor.position_m == exactly(0.25 * free.position_m)


def test_each_side_sends_a_share_of_its_store_and_no_energy_is_made_of_it() -> None:
    account = Account(1.0, 2.0, 3e-3, 4.0, 5.0)
    assert shared_out(account, 0.1) == (exactly(1.0003), 2.0, exactly(2.7e-3), 4.0, 5.0)
    assert shared_out(account._replace(remaining_j=-1e-3), 0.1) == account._replace(remaining_j=-1e-3)
    for share in (SHIPPED.shared, 1.0):
        sent = shared_out(account, share)
        assert sent.in_j + sent.remaining_j == exactly(account.in_j + account.remaining_j)
    hand, _ = master_receive(SHIPPED, pressed(1e-3), HAND, ANSWER, T)
    assert hand.account.in_j == exactly(SHIPPED.shared * 1e-3)
    base, _ = slave_receive(SHIPPED, slave(), ANSWER, FREE, T)
    assert base.account.in_j == exactly(SHIPPED.shared * 4e-3)


@pytest.mark.parametrize(
    ("remaining_j", "share"), [(1e-3, 0.0), (2e-3, 0.0), (0.75e-3, 0.25), (0.0, 1.0), (-1e-3, 1.0)]
)
def test_the_damper_of_the_hand_fills_a_store_that_is_low_with_what_it_takes(remaining_j: float, share: float) -> None:
    params = SHIPPED._replace(shared=0.0)
    hand = HAND._replace(force_n=3.0)
    state, _ = master_receive(params, pressed(remaining_j), hand, ANSWER, T)
    way = state.mass.position_m - 1e-3
    damper = share * 460.0
    assert state.account.remaining_j == pytest.approx(remaining_j + damper * way**2 / T, rel=1e-9, abs=1e-18)
    # the force of the damper over the way is the energy that the mass is missing
    resisted = moved(params.mass, Mass(1e-3, 0.0, 0.0, True), 3.0 - damper * way / T)
    assert resisted.position_m == pytest.approx(state.mass.position_m, rel=0.0, abs=1e-17)


def test_what_a_damper_took_is_kept_up_to_the_cap_and_what_it_gave_is_paid() -> None:
    account = Account(1.0, 2.0, 3e-3, 4.0, 5.0)
    assert taken(account, 1e-3, 1.0) == account._replace(remaining_j=4e-3)
    full = taken(account, 1e-3, 3.25e-3)
    assert (full.remaining_j, full.lost_j) == (3.25e-3, exactly(4.00075))
    # a store above the cap keeps what it has
    assert taken(account, 1e-3, 2e-3).remaining_j == 3e-3
    assert taken(account, -4e-3, 2e-3) == account._replace(remaining_j=exactly(-1e-3), lost_j=exactly(4.0))


def test_a_device_that_is_off_for_a_moment_stands_and_the_coupling_goes_on() -> None:
    off = HandSample(0.9e-3, 0.0, 1.0, False)
    answer = ANSWER._replace(force_n=2.0 / PARAMS.mass.force_scale, energy_j=1e-3)
    state, reference = master_receive(PARAMS, pressed(4e-3), off, answer, T)
    # the reference was 0.1 mm ahead of the device: that way back is paid with the force of the channel
    assert state.account.remaining_j == exactly(4e-3 + 1e-3 - 2.0 * 0.1e-3)
    assert (state.account.lost_j, state.account.granted_j) == (0.0, 1e-3)
    # of the way to where it stands nothing is work of the hand
    idle = pressed(4e-3)._replace(port=HandPort(0.0, 0.0, 0.0, 0.0))
    assert master_receive(PARAMS, idle, off, answer, T)[0].port.credit_j == exactly(2.0 * 0.1e-3)
    assert (state.mass, state.stood_s) == ((0.9e-3, 0.0, 0.0, True), T)
    assert reference == (0.9e-3, 0.0, exactly(2.0), True)
    assert master_send(PARAMS, state, off, T)[1].active
    # what the store lacks for it is granted
    poor, _ = master_receive(PARAMS, pressed(0.0), off, answer._replace(energy_j=0.5e-4), T)
    assert (poor.account.remaining_j, poor.account.granted_j) == (exactly(0.0), exactly(1e-3 + 1.5e-4))
    # after the limit of silence the hand is let go, and a hand that follows begins to count anew
    for stood_s, coupled in ((0.499, True), (0.5, False)):
        assert master_receive(PARAMS, state._replace(stood_s=stood_s), off, answer, T)[0].mass.coupled is coupled
    back, _ = master_receive(PARAMS, state, off._replace(following=True), answer, T)
    assert (back.stood_s, back.mass.coupled) == (0.0, True)


def test_a_base_is_coupled_when_it_has_arrived_and_its_way_there_is_none_of_the_couplings() -> None:
    # the instrument was armed at -100 nm and goes to 0, and a gap of the link hides half of that way
    away = FREE._replace(base_position_m=-100e-9)
    begun, _ = slave_receive(PARAMS, slave_start(PARAMS, FREE), ANSWER._replace(active=False), away, T)
    on_its_way, reference = slave_receive(PARAMS, begun, ANSWER, away._replace(base_position_m=-50e-9), T)
    assert (on_its_way.coupled, reference.position_m) == (False, 0.0)
    there, _ = slave_receive(PARAMS, on_its_way, ANSWER, FREE, T)
    assert there.coupled
    assert there.stretch_m == 0.0
    assert there.account.remaining_j == PARAMS.start_j


def test_what_a_take_up_puts_into_the_coupling_is_granted() -> None:
    k, force = PARAMS.coupling_n_per_m, 6.0
    tip = FREE._replace(force_n=force / PARAMS.mass.force_scale, in_contact=True)
    signal = ANSWER._replace(force_n=force / PARAMS.mass.force_scale)
    begun = slave_start(PARAMS, tip)
    state, _ = slave_receive(PARAMS, begun, signal, tip, T)
    assert state.account.granted_j == exactly(1e-3 + 0.5 * force**2 / k)
    again, _ = slave_receive(PARAMS, state, signal, tip, T)
    assert again.account.granted_j == state.account.granted_j
    hand, _ = master_receive(PARAMS, master_start(PARAMS, HAND), HAND, signal, T)
    assert hand.account.granted_j == exactly(1e-3 + 0.5 * force**2 / k)
    hand, _ = master_receive(PARAMS, hand, HAND, signal, T)
    assert hand.account.granted_j == exactly(1e-3 + 0.5 * force**2 / k)


def test_a_half_begins_with_the_stretch_of_the_force_that_the_tip_feels() -> None:
    tip = FREE._replace(base_position_m=7e-9, force_n=2e-9)
    begun = slave_start(PARAMS, tip)
    stretch = PARAMS.mass.force_scale * 2e-9 / PARAMS.coupling_n_per_m
    assert begun == (
        7e-9, exactly(stretch), exactly(stretch), 0.0, 7e-9, exactly(0.2), opened(PARAMS.start_j), False
    )  # fmt: skip
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
    return master(Mass(1e-3, 0.0, 0.0, True), Account(0.0, 0.0, remaining_j, 0.0, 1e-3))


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


def test_a_store_that_owes_cuts_no_motion_into_the_channel() -> None:
    hand, answer = HAND._replace(force_n=10.0), ANSWER._replace(force_n=2.0 / PARAMS.mass.force_scale)
    free = moved(PARAMS.mass, Mass(1e-3, 0.0, 0.0, True), 8.0)
    for owes in (pressed(-1e-3), pressed(0.0)._replace(port=HandPort(0.0, -1e-3, 0.0, 0.0))):
        assert master_receive(PARAMS, owes, hand, answer, T)[0].mass == free


def test_what_the_reference_puts_in_while_the_device_is_stuck_is_neither_sent_nor_shared() -> None:
    force, start = 2.0 / PARAMS.mass.force_scale, Account(0.0, 0.0, 4e-3, 0.0, 1e-3)
    stuck = HAND._replace(force_n=10.0)
    state = MasterState(Mass(0.0, 0.0, 0.0, True), start, 0.0, HandPort(0.0, 0.0, 0.0, 0.0))
    for _ in range(200):
        state, reference = master_receive(SHIPPED, state, stuck, ANSWER._replace(force_n=force), T)
    assert state.account.in_j > 1e-3
    assert master_send(SHIPPED, state, stuck, T)[1].energy_j == 0.0
    # the reference stops where a device that follows cannot be any more, and what it undoes there it takes back
    assert (reference.position_m, reference.velocity_m_per_s) == (exactly(2e-3), 0.0)
    # a device that comes after all pays for it
    came, _ = master_receive(SHIPPED, state, stuck._replace(position_m=2e-3), ANSWER._replace(force_n=force), T)
    assert master_send(SHIPPED, came, stuck, T)[1].energy_j == came.account.in_j > 1e-3


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
    state, _ = master_receive(PARAMS, master(start, Account(0.0, 0.0, 0.0, 0.0, 0.0)), hand,
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
    state = pressed(1e-3)._replace(stood_s=1.0)
    after, reference = master_receive(PARAMS, state, hand, ANSWER._replace(force_n=2e-8), T)
    assert (after.mass.position_m, after.mass.velocity_m_per_s, after.mass.coupled) == (2e-3, 0.0, False)
    assert reference == (2e-3, 0.0, exactly(2.0), True)
    _, reference = master_receive(PARAMS, state, hand, NO_SIGNAL._replace(force_n=2e-8), T)
    assert reference == (2e-3, 0.0, 0.0, False)


def test_each_port_sends_its_place_its_force_and_the_energy_that_went_in() -> None:
    mass = Mass(2e-3, 0.05, 1e-9, True)
    account = Account(4e-4, 0.0, 1e-3, 0.0, 1e-3)
    state = master(mass, account)
    hand = HAND._replace(force_n=3.0)
    assert master_send(PARAMS, state, hand, T)[0] == state
    sent = master_send(PARAMS, state, hand, T)[1]
    assert sent == (exactly(SCALE * 2e-3 + 1e-9), exactly(SCALE * 0.05), exactly(3e-8), 0.0, 4e-4, 0.0, False, False,
                    True, 0.0, 0.0)  # fmt: skip
    assert not master_send(PARAMS, master(mass._replace(coupled=False), account), hand, T)[1].active
    base = SlaveState(1e-9, 2e-4, 0.0, 0.0, 1e-9, 0.0, account, True)
    tip = TipMeasurement(3e-9, 1e-9, 5e-9, True, False, True, 0.0)
    expected = exactly(PARAMS.coupling_n_per_m * 2e-4 / PARAMS.mass.force_scale)
    assert slave_send(PARAMS, base, tip, T) == (
        base,
        (3e-9, 0.0, expected, 0.0, 4e-4, 5e-9, True, False, True, 0.0, 0.0),
    )
    touching = tip._replace(separation_valid=False, in_contact=True, following=False)
    assert slave_send(PARAMS, base, touching, T)[1][6:9] == (False, True, False)


def test_the_energy_account_of_each_half_has_the_grants_of_both() -> None:
    account = Account(4e-4, 2e-4, 3e-4, 5e-4, 1e-3)
    half = master(Mass(0.0, 0.0, 0.0, True), account)
    assert PASSIVITY.master_energy_account(PARAMS, half) == (3e-4, 5e-4, 2e-3)
    half = half._replace(port=half.port._replace(granted_j=7e-3))
    assert PASSIVITY.master_energy_account(PARAMS, half).granted_j == exactly(9e-3)
    assert PASSIVITY.slave_energy_account(PARAMS, slave()._replace(account=account)) == (3e-4, 5e-4, 2e-3)
    # it promises passivity, fills the energy of the wire's message, and its slave half goes on between signals
    assert (PASSIVITY.passive, PASSIVITY.uses_energy, PASSIVITY.local_loop) == (True, True, True)
    assert not PASSIVITY.uses_waves


def test_a_half_that_is_taken_over_goes_on_in_the_motion_of_the_hand() -> None:
    hand = HandSample(2e-3, 0.03, 0.0, True)
    state = master_resume(PARAMS, hand, 8e-9)
    assert state.account == opened(PARAMS.start_j)
    assert (state.mass.position_m, state.mass.velocity_m_per_s) == (2e-3, 0.03)
    assert master_send(PARAMS, state, hand, T)[1].position_m == exactly(8e-9)
    assert master_start(PARAMS, hand).mass.velocity_m_per_s == 0.0
    kept = retune(PARAMS, PARAMS._replace(cap_j=1.0), pressed(4e-3)._replace(account=Account(1.0, 2.0, 4e-3, 3.0, 4.0)))
    assert kept.account == (1.0, 2.0, 4e-3, 3.0, 4.0)


@pytest.mark.parametrize(("share", "grows"), [(0.99, False), (1.0, None), (1.01, True)])
@pytest.mark.parametrize("settings", [{}, {"coupling_stiffness_n_per_m": 700.0, "position_scale": 3e-6}])
def test_a_sample_at_the_limit_of_stiffness_gets_from_the_base_all_that_the_coupling_gives(
    settings: dict[str, float], share: float, grows: bool | None
) -> None:
    config = PassivityConfig(**settings)
    sample_n_per_m = share * config.stiffness_limit_n_per_m(T)
    # a reference that stands, and a base that swings about its rest: x is its place at the hand's scale
    coupling, relaxed = config.coupling_stiffness_n_per_m, config.to_params(T).relaxed
    there = sample_n_per_m * config.force_scale * config.position_scale
    place = swing = 1e-4
    for _ in range(100):
        place += relaxed * (-coupling * place - there * place) / coupling
        swing = max(swing, abs(place)) if grows is None else abs(place)
    assert swing == pytest.approx(1e-4, rel=1e-9, abs=0.0) if grows is None else (swing > 1e-4) is grows


def test_the_limit_of_stiffness_of_the_shipped_law_is_800_n_per_m() -> None:
    assert PassivityConfig().stiffness_limit_n_per_m(T) == pytest.approx(800.0, rel=0.02)


def test_the_damper_brakes_a_hand_that_comes_back_by_itself_over_an_empty_store() -> None:
    # hand and channel both drive back, 3 N and 5 N, and nothing is there to pay for the work of the channel
    params = SHIPPED._replace(shared=0.0)
    state = master(Mass(1e-3, 0.0, 0.0, True), Account(0.0, 0.0, 0.0, 0.0, 0.0))
    hand = HAND._replace(force_n=-3.0, position_m=1e-3)
    after, _ = master_receive(params, state, hand, ANSWER._replace(force_n=5.0 / params.mass.force_scale), T)
    way = after.mass.position_m - 1e-3
    # the damper is full, and pulls with its value times the mean speed of the whole motion under 8 N
    whole = moved(params.mass, state.mass, -8.0).position_m - 1e-3
    braked = whole / (1.0 + params.refill_n_s_per_m * params.mass.gamma_x_m_per_n / T)
    pull_n = params.refill_n_s_per_m * -braked / T
    assert pull_n > 0.1
    assert way == exactly(moved(params.mass, state.mass, -3.0 + pull_n).position_m - 1e-3)
    assert after.account.remaining_j == 0.0


# --- a coupling whose settings change ---


def tuned(remaining_j: float, **changes: float) -> SlaveState:
    """Return a half with 2 N in a coupling of 1 000 N/m, 2 mJ, after a change of the settings."""
    old = PARAMS._replace(coupling_n_per_m=1000.0)
    scales = {name: changes.pop(name) for name in ("position_scale", "force_scale") if name in changes}
    new = old._replace(mass=old.mass._replace(**{n: getattr(old.mass, n) * f for n, f in scales.items()}), **changes)
    state = slave(2e-3, remaining_j=remaining_j, limit_n=4.0)._replace(lead_m=5e-3, last_n=1.5)
    return slave_retune(old, new, state)


def test_a_softer_coupling_is_stretched_further_for_the_same_force_and_its_energy_is_paid() -> None:
    after = tuned(5e-3, coupling_n_per_m=500.0)
    # 2 N stretch it by 4 mm, with 4 mJ instead of 2 mJ
    assert after.stretch_m == exactly(4e-3)
    assert (after.account.remaining_j, after.account.granted_j) == (exactly(3e-3), exactly(1e-3))
    assert (after.account.in_j, after.account.lost_j) == (0.0, 0.0)


@pytest.mark.parametrize(("remaining_j", "paid_j"), [(0.5e-3, 0.5e-3), (0.0, 0.0), (-1e-3, 0.0)])
def test_what_the_store_lacks_for_a_softer_coupling_is_granted(remaining_j: float, paid_j: float) -> None:
    after = tuned(remaining_j, coupling_n_per_m=500.0)
    assert after.account.remaining_j == exactly(remaining_j - paid_j)
    assert after.account.granted_j == exactly(1e-3 + 2e-3 - paid_j)
    assert (after.account.in_j, after.account.lost_j) == (0.0, 0.0)


def test_what_a_stiffer_coupling_holds_less_is_dissipated() -> None:
    after = tuned(4e-3, coupling_n_per_m=2000.0)
    # 2 N stretch it by 1 mm, with 1 mJ instead of 2 mJ
    assert after.stretch_m == exactly(1e-3)
    assert after.account == (0.0, 0.0, 4e-3, exactly(1e-3), 1e-3)


def test_a_coupling_that_does_not_change_keeps_its_account() -> None:
    assert tuned(4e-3).account == slave().account
    # but for what is above the new cap
    assert tuned(4e-3, cap_j=1e-3).account.remaining_j == 1e-3


def test_other_scales_keep_the_force_and_the_place_at_the_tip() -> None:
    after = tuned(1.0, force_scale=2.0, cap_j=1.0)
    # the same force at the tip is twice that at the hand
    assert (after.stretch_m, after.limit_n, after.last_n) == (exactly(4e-3), exactly(8.0), exactly(3.0))
    after = tuned(4e-3, position_scale=3.0)
    # the 3 mm between coupling and reference are a third at the hand, the stretch has the same force
    assert (after.stretch_m, after.lead_m) == (exactly(2e-3), exactly(1e-3 + 2e-3))
    assert (after.position_m, after.last_m, after.coupled) == (0.0, 0.0, True)
