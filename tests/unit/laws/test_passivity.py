"""Passivity control: no port gives out more than the other has put in, and what the cuts cost."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from telenano.extend.laws import NO_SIGNAL, HandSample, TipMeasurement
from telenano.extend.virtual_mass import paid_stretch
from telenano.laws.passivity import (
    Account,
    charged,
    credited,
    master_receive,
    master_send,
    master_start,
    paid_motion,
    retune,
    slave_receive,
    slave_send,
    slave_start,
)
from telenano.sections.own_laws import PassivityConfig

T = 1e-3
PARAMS = PassivityConfig().to_params(T)
# what a store sends to the other side has a test of its own
KEPT = PARAMS._replace(shared=0.0)
LOST = -1

forces = st.floats(-50.0, 50.0)
ways = st.floats(-1e-3, 1e-3)
energies = st.floats(0.0, 5e-3)


@given(ways, ways, forces, energies)
def test_motion_of_the_hand_is_never_more_than_paid(motion: float, own: float, force: float, left: float) -> None:
    cut, work = paid_motion(motion, own, force, left)
    assert work >= -left
    assert cut * motion >= 0.0
    assert abs(cut) <= abs(motion)
    # either the channel pays for the way, or the hand goes it by itself
    assert work == pytest.approx(force * cut, rel=1e-9, abs=1e-15) or (work == 0.0 and abs(cut) <= abs(own))


def test_motion_at_the_bound_passes_and_a_millionth_past_it_is_cut() -> None:
    force, left = 2.0, 1e-3
    bound = left / force
    assert paid_motion(-bound, 1.0, force, left) == (-bound, -left)
    cut, work = paid_motion(-bound * (1.0 + 1e-6), 1.0, force, left)
    assert cut == pytest.approx(-bound, rel=1e-14, abs=0.0)
    assert work == -left


def test_operator_who_pulls_back_himself_is_not_held() -> None:
    assert paid_motion(-3e-5, -1e-5, 2.0, 0.0) == (-1e-5, 0.0)
    assert paid_motion(-3e-5, 1e-5, 2.0, 0.0) == (0.0, 0.0)


@given(ways, ways, st.floats(1.0, 1e4), energies)
def test_end_of_the_coupling_goes_no_further_than_paid(stretch: float, motion: float, k: float, left: float) -> None:
    cut, work = paid_stretch(stretch, motion, k, left)
    assert work >= -left
    assert -work == pytest.approx(0.5 * k * ((stretch + cut) ** 2 - stretch**2), rel=1e-6, abs=1e-12)
    # pressing or pulling harder is what is cut, and it is cut on the way there
    assert cut == motion or abs(stretch + cut) <= abs(stretch + motion) * (1.0 + 1e-12)


def test_cut_stretch_holds_exactly_the_energy_left() -> None:
    cut, work = paid_stretch(0.0, 1e-3, 1500.0, 3e-4)
    assert cut == pytest.approx(math.sqrt(2.0 * 3e-4 / 1500.0), rel=1e-12, abs=0.0)
    assert work == -3e-4


def test_account_takes_growing_counters_only_and_caps_its_store() -> None:
    account = credited(Account(0.0, 0.0, 1e-3, 0.0, 1e-3), 3e-3, 1.0)
    assert account.remaining_j == pytest.approx(4e-3, rel=1e-14, abs=0.0)
    assert credited(account, 2e-3, 1.0) == account
    assert credited(account, 3e-3, 1.0) == account
    capped = credited(account, 9e-3, 5e-3)
    assert (capped.remaining_j, capped.received_j) == (5e-3, 9e-3)
    assert capped.lost_j == pytest.approx(5e-3, rel=1e-12, abs=0.0)
    assert charged(capped, 2e-3, 0.0)[:3] == (2e-3, 9e-3, 5e-3)
    assert charged(capped, -2e-3, 1e-4).remaining_j == pytest.approx(3e-3, rel=1e-14, abs=0.0)


def test_silence_credits_nothing_that_was_received_before() -> None:
    tip = TipMeasurement(0.0, 0.0, 0.0, False, True, True, 0.0)
    hand = HandSample(0.0, 0.0, 0.0, True)
    received = NO_SIGNAL._replace(active=True, silence_s=0.0, energy_j=3e-3)
    first = received._replace(energy_j=0.0)
    slave, _ = slave_receive(KEPT, slave_start(KEPT, tip), first, tip, T)
    slave, _ = slave_receive(KEPT, slave, received, tip, T)
    master, _ = master_receive(KEPT, master_start(KEPT, hand), hand, first, T)
    master, _ = master_receive(KEPT, master, hand, received, T)
    before = slave.account, master.account
    assert before[0].remaining_j == before[1].remaining_j == pytest.approx(4e-3, rel=1e-12, abs=0.0)
    # nothing is received for a while, and then the same counter again
    for signal in (NO_SIGNAL, received):
        slave, _ = slave_receive(KEPT, slave, signal, tip, T)
        master, _ = master_receive(KEPT, master, hand, signal, T)
        assert (slave.account, master.account) == before
    # a half that begins anew counts from its own zero
    anew = NO_SIGNAL._replace(active=False, in_contact=True, silence_s=0.0, energy_j=1e-4)
    slave, _ = slave_receive(KEPT, slave, anew, tip, T)
    slave, _ = slave_receive(KEPT, slave, received._replace(energy_j=3e-4), tip, T)
    assert slave.account.remaining_j == pytest.approx(4e-3 + 2e-4, rel=1e-12, abs=0.0)


@given(
    st.lists(st.tuples(st.floats(-20.0, 20.0), st.floats(-2e-8, 2e-8), st.integers(0, 8)), min_size=5, max_size=60),
    st.integers(0, 9),
)
def test_channel_is_passive_whatever_hand_tip_and_link_do(ticks: list[tuple[float, float, int]], delay: int) -> None:
    tip = TipMeasurement(0.0, 0.0, 0.0, False, True, True, 0.0)
    hand = HandSample(0.0, 0.0, 0.0, True)
    master, slave = master_start(PARAMS, hand), slave_start(PARAMS, tip)
    sent: list[Any] = []
    replies = [NO_SIGNAL._replace(active=True)]
    for n, (force, tip_force, lost) in enumerate(ticks):
        hand = HandSample(master.mass.position_m, 0.0, force, True)
        master, signal = master_send(PARAMS, master, hand, T)
        sent.append(signal)
        # some signals are lost, and an old one may come again
        received = sent[max(0, n - delay - lost)]
        slave, wanted = slave_receive(PARAMS, slave, received._replace(silence_s=0.0), tip, T)
        tip = TipMeasurement(wanted.position_m, tip_force, 0.0, False, True, True, 0.0)
        slave, reply = slave_send(PARAMS, slave, tip, T)
        replies.append(reply)
        answer = replies[max(0, len(replies) - 1 - delay - lost)]
        master, _ = master_receive(PARAMS, master, hand, answer._replace(silence_s=0.0), T)
        for port, other in ((master.account, slave.account), (slave.account, master.account)):
            out = port.received_j + PARAMS.start_j - port.remaining_j
            assert port.remaining_j >= 0.0
            assert port.received_j <= other.in_j * (1.0 + 1e-12)
            assert out <= other.in_j + PARAMS.start_j + 1e-15


@pytest.mark.parametrize("stiffness", [10.0, 20.0, 38.0])
@pytest.mark.parametrize("delay", [0, 20, 50, 100, 250])
def test_spring_is_held_at_any_delay(run_loop: Any, stiffness: float, delay: int) -> None:
    run = run_loop("passivity", lambda n: 1.0, lambda x: stiffness * x, 6000, lambda n: delay, lambda n: delay)
    held = 1e8 * run.force_n[-500:]
    assert np.ptp(held) < 0.01
    assert held.mean() == pytest.approx(1.0, rel=0.03, abs=0.0)
    assert (run.entered_j - run.left_j >= -2.0 * PARAMS.start_j).all()


def test_contact_is_given_up_when_the_hand_lets_go_though_the_channel_is_out_of_energy(run_loop: Any) -> None:
    run = run_loop(
        "passivity",
        lambda n: 1.0 if n < 4000 else 0.0,
        lambda x: 20.0 * x,
        7000,
        lambda n: 250,
        lambda n: 250,
        start_energy_j=0.0005,
    )
    assert 1e8 * run.force_n[3999] > 0.9
    assert abs(1e8 * run.force_n[-1]) <= 0.0101


def test_lost_link_stops_the_tip(run_loop: Any) -> None:
    run = run_loop("passivity", lambda n: 1.0, lambda x: 20.0 * x, 3000, lambda n: LOST if n > 1000 else 0, lambda n: 0)
    # 50 ms of silence: until then the coupling goes on against the measured force
    assert run.base_m[-1] == run.base_m[1052]
    assert run.base_m[-1] == pytest.approx(run.base_m[1000], rel=1e-3, abs=0.0)
    assert not run.masters[-1].mass.coupled


@pytest.mark.check("takes 1.1 s")
def test_hand_that_presses_now_more_now_less_does_not_walk_away(run_loop: Any) -> None:
    def swing(n: int) -> float:
        return min(1.0, n / 500) + 0.3 * math.sin(2.0 * math.pi * 0.5e-3 * n) * (n > 500)

    run = run_loop("passivity", swing, lambda x: 10.0 * max(x, 0.0), 10_000)
    assert abs(run.reference_m[-1] - run.reference_m[5999]) / 2.0 < 1e-6
    # over a delay, and over two hundred cycles: test_endless.py
    # a clamp that gives way at once makes the hand feel its own force, and it stays ahead
    at_once = run_loop("passivity", swing, lambda x: 10.0 * max(x, 0.0), 10_000, clamp_release_s=1e-6)
    assert at_once.reference_m[-1] - run.reference_m[-1] > 3e-4


@pytest.mark.parametrize("stiffness", [80.0, 200.0])
@pytest.mark.parametrize(("delay", "jitter", "loss"), [(30, 8, 0.5), (100, 25, 0.2), (250, 125, 0.2)])
def test_stiff_samples_are_held_over_gaps_and_jitter(
    run_loop: Any, stiffness: float, delay: int, jitter: int, loss: float
) -> None:
    # a slave half that acts on messages only, and assumes 20 N/m in between, diverges here from 80 N/m on
    random = np.random.default_rng(7)
    ways = [
        [LOST if random.random() < loss else round(delay + jitter * (2.0 * random.random() - 1.0)) for _ in range(5000)]
        for _ in range(2)
    ]
    run = run_loop(
        "passivity",
        lambda n: min(1.0, n / 400),
        lambda x: stiffness * x,
        5000,
        lambda n: ways[0][n],
        lambda n: ways[1][n],
    )
    assert (run.entered_j - run.left_j).min() > -1e-6
    assert 1e8 * run.force_n[-1000:] == pytest.approx(1.0, rel=0.01, abs=0.0)
    assert 1e8 * run.force_n.max() < 1.05


def test_retune_keeps_the_tip_and_the_cap() -> None:
    state = master_start(PARAMS, HandSample(5e-3, 0.0, 0.0, True))
    other = PassivityConfig(energy_cap_j=1e-4, position_scale=3e-6).to_params(T)
    after = retune(PARAMS, other, state)
    assert after.account.remaining_j == 1e-4
    assert 3e-6 * 5e-3 + after.mass.tip_offset_m == pytest.approx(7.5e-9, rel=1e-13, abs=0.0)
