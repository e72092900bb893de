"""The lateral path: how a hand moves the tip across the sample, what it feels, and what energy it can get there."""

import math
import random
from itertools import pairwise
from typing import Any

import pytest

from telenano.laws.lateral import (
    LOST,
    MET,
    LateralFar,
    LateralHand,
    LateralMasterState,
    hand_moves,
    lateral_at_rest,
    lateral_master_step,
    lateral_slave_at_rest,
    lateral_slave_step,
)
from telenano.sections.lateral_section import LateralConfig

DT = 1e-3
HERE = LateralFar(0.0, 0.0, 0.0, 0.0, known=True)


def config(**keys: Any) -> Any:
    return LateralConfig.model_validate({"mode": "rate", **keys}).to_params()


def at(x_m: float, y_m: float = 0.0, z_m: float = 0.0, following: bool = True) -> LateralHand:
    return LateralHand(x_m, y_m, z_m, 0.0, 0.0, 0.0, following)


def run(params: Any, hands: list[LateralHand], far: LateralFar = HERE, state: Any = None) -> LateralMasterState:
    state = lateral_at_rest() if state is None else state
    for hand in hands:
        state = lateral_master_step(params, state, hand, far, DT)
    return state


@pytest.mark.parametrize(("x_mm", "nm_per_s"), [(0.9, 0.0), (2.0, 30.0), (-6.0, -150.0), (30.0, 300.0)])
def test_by_rate_the_displacement_of_the_hand_is_the_velocity_of_the_tip(x_mm: float, nm_per_s: float) -> None:
    state = run(config(), [at(0.0), *[at(x_mm * 1e-3)] * 1000])
    assert state.travel.x_m == pytest.approx(nm_per_s * 1e-9, rel=1e-9, abs=0.0)
    assert state.travel.y_m == 0.0


def test_by_position_the_tip_goes_the_way_of_the_hand_and_the_clutch_lets_it_go_back() -> None:
    params, free = config(mode="position"), config(mode="position", clutch="released")
    out = [at(1e-5 * n) for n in range(1001)]
    state = run(params, out)
    assert state.travel.x_m == pytest.approx(5e-7, rel=1e-9)
    state = run(free, out[::-1], state=state)
    assert state.travel.x_m == pytest.approx(5e-7, rel=1e-9)
    state = run(params, out, state=state)
    assert state.travel.x_m == pytest.approx(1e-6, rel=1e-9)


def test_a_hand_that_takes_hold_beside_the_middle_moves_nothing() -> None:
    state = run(config(), [at(8e-3)] * 500)
    assert (state.travel.x_m, state.force_n) == (0.0, (0.0, 0.0, 0.0))
    released = run(config(clutch="released"), [at(2e-3), *[at(9e-3)] * 100])
    taken = run(config(), [at(9e-3)] * 100, state=released)
    assert taken.travel.x_m == 0.0


@pytest.mark.parametrize("mode", ["rate", "position"])
def test_in_a_silence_and_without_the_hand_nothing_moves_and_nothing_is_felt(mode: str) -> None:
    params, pushed = config(mode=mode, centring_n_per_m=0.0), LateralFar(-1e-8, 0.0, 0.0, 0.0, known=True)
    moving = [at(4e-6 * n) for n in range(2000)]
    state = run(params, moving, pushed)
    assert state.force_n[0] < -0.5
    silent = run(params, [at(8e-3 + 4e-6 * n) for n in range(1000)], pushed._replace(known=False), state)
    assert silent.travel.x_m == state.travel.x_m
    assert silent.force_n[0] == 0.0
    off = run(params, [at(9e-3, following=False)] * 10, pushed, state)
    assert (off.travel.x_m, off.force_n) == (state.travel.x_m, (0.0, 0.0, 0.0))


def test_the_force_is_scaled_clamped_and_its_rate_is_limited() -> None:
    params = config(force_rate_n_per_s=20.0, max_force_n=1.5)
    first = run(params, [at(0.0), *[at(5e-3)] * 200])
    forces = []
    for _ in range(400):
        first = run(params, [at(5e-3)], LateralFar(-5e-8, 0.0, 0.0, 0.0, known=True), first)
        forces.append(first.felt.x_n)
    steps = [abs(b - a) for a, b in pairwise(forces)]
    assert max(steps) <= 20e-3 * (1.0 + 1e-9)
    assert forces[-1] == pytest.approx(-1.5)
    assert math.hypot(*first.force_n[:2]) <= 1.5 * (1.0 + 1e-9)


def test_the_spring_brings_a_hand_back_that_a_particle_has_pushed() -> None:
    """The hand is pulled aside slowly, given way by what it feels, and let go: the tip has to stand then."""
    params, far, state = config(), LateralFar(-1.075e-8, 0.0, 0.0, 0.0, known=True), lateral_at_rest()
    x, v, most = 0.0, 0.0, 0.0
    for n in range(3000):
        # a person of 200 N/m and 40 N s/m, who lets go after 2.5 s of a stylus of 0.1 kg and 1.5 N s/m
        own, b = (200.0 * (0.01 - x), 40.0) if n < 2500 else (0.0, 1.5)
        v = (v + DT * (own + state.force_n[0]) / 0.1) / (1.0 + DT * b / 0.1)
        x += DT * v
        hand = LateralHand(x, 0.0, 0.0, v, 0.0, 0.0, True)
        state = lateral_master_step(params, state, hand, far if 200 < n < 2700 else HERE, DT)
        most = max(most, -state.force_n[0])
        if n == 2500:
            let_go = state.travel.x_m
    assert most > 0.8
    assert abs(x) < 1e-3 and abs(state.travel.x_m - let_go) < 3e-8
    assert run(params, [hand] * 1000, state=state).travel.x_m == state.travel.x_m


def test_a_particle_is_felt_as_it_is_met_and_as_it_is_lost() -> None:
    params, news, pulses = config(), [], []
    state, place = run(params, [at(0.0)]), 0.0
    for n in range(3000):
        place += 3e-10
        force = -1.07e-8 if 500 < n < 2000 else -1e-10
        far = LateralFar(force + 2e-10 * math.sin(n), 0.0, place, 0.0, known=True)
        state = run(params, [at(8e-3)], far, state)
        if state.news:
            news.append((state.news, n))
        if state.felt.pulse_s:
            pulses.append(n)
    assert [kind for kind, _ in news] == [MET, LOST]
    assert 501 <= news[0][1] <= 505
    # 17 nm at 0.3 nm a step
    assert 2050 <= news[1][1] <= 2065
    assert 30 <= len(pulses) <= 42


@pytest.mark.parametrize("mode", ["rate", "position"])
def test_the_guide_draws_the_hand_to_the_line_and_the_disc_pushes_it_out(mode: str) -> None:
    line = {"enabled": True, "x0_m": 0.0, "y0_m": 1e-7, "x1_m": 1e-6, "y1_m": 1e-7}
    guided = run(config(mode=mode, guide=line), [at(0.0)] * 2)
    assert guided.force_n[1] > 0.05
    assert abs(guided.force_n[0]) < 1e-12
    over = run(config(mode=mode, guide={**line, "y0_m": -1e-7, "y1_m": -1e-7}), [at(0.0)] * 2)
    assert over.force_n[1] < -0.05
    disc = {"enabled": True, "x_m": 2e-7, "y_m": 0.0, "radius_m": 3e-7}
    inside = run(config(mode=mode, disc=disc), [at(0.0)] * 2)
    assert inside.force_n[0] < -0.05
    outside = run(config(mode=mode, disc={**disc, "x_m": -4e-7}), [at(0.0)] * 2)
    assert outside.force_n[:2] == (0.0, 0.0)


def test_by_rate_the_tip_does_not_go_deeper_into_a_disc() -> None:
    params = config(disc={"enabled": True, "x_m": 4e-7, "y_m": 0.0, "radius_m": 3e-7})
    state = run(params, [at(0.0), *[at(9e-3, 1e-3)] * 3000])
    x, y = state.travel.x_m - 4e-7, state.travel.y_m
    assert math.hypot(x, y) > 2.995e-7
    assert y > 1e-8


def hostile(seed: int, ticks: int, **keys: Any) -> tuple[float, float]:
    """Let a hand do what it likes under fixtures that move and forces that come late; return the least energies."""
    random_ = random.Random(seed)
    x, y, z, v = 0.0, 0.0, 0.0, [0.0, 0.0, 0.0]
    state, least, least_z, across, along = lateral_at_rest(), 0.0, 0.0, 0.0, 0.0
    push = [0.0, 0.0, 0.0]
    line = {"enabled": True}
    params = config(guide=line, disc={"enabled": True}, depth={"enabled": True}, **keys)
    late: list[LateralFar] = [HERE] * 200
    for n in range(ticks):
        if n % 40 == 0:
            push = [random_.uniform(-2.8, 2.8) for _ in range(3)]
        if n % 300 == 0:
            line = {"enabled": random_.random() < 0.8, "y0_m": random_.uniform(-1e-6, 1e-6), "y1_m": 1e-7}
            other = random_.choice(["rate", "position"]) if "mode" not in keys else keys["mode"]
            clutch = random_.choice(["engaged", "engaged", "released"])
            params = config(**{**keys, "mode": other}, clutch=clutch, guide=line, disc={"enabled": True},
                            depth={"enabled": random_.random() < 0.7})  # fmt: skip
        before = x, y, z
        for i, shown in enumerate(state.force_n):
            # a hand of 0.3 kg: up to 20 m/s^2 with the 2 N that it is shown
            v[i] = 0.99 * v[i] + (push[i] + shown) / 0.3 * DT
        x, y, z = x + v[0] * DT, y + v[1] * DT, z + v[2] * DT
        ways = [b - a for a, b in zip(before, (x, y, z), strict=True)]
        across -= state.force_n[0] * ways[0] + state.force_n[1] * ways[1]
        along -= state.force_n[2] * ways[2]
        late.append(
            LateralFar(
                random_.choice([0.0, 3e-8, -3e-8]), random_.uniform(-3e-8, 3e-8), x * 5e-5, y * 5e-5, n % 997 > 90
            )
        )
        state = lateral_master_step(params, state, LateralHand(x, y, z, *v, following=n % 1501 > 20), late.pop(0), DT)
        least, least_z = min(least, across), min(least_z, along)
    assert state.store.entered_j == pytest.approx(across, rel=1e-9)
    return least, least_z


@pytest.mark.parametrize("seed", range(6))
def test_no_port_gives_out_more_than_is_granted_whatever_hand_delay_and_fixtures_do(seed: int) -> None:
    least, least_z = hostile(seed, 6000)
    assert least >= -1e-3 * (1.0 + 1e-9)
    assert least_z >= -1e-3 * (1.0 + 1e-9)


def test_without_the_store_the_same_hand_would_get_energy() -> None:
    assert min(hostile(seed, 6000, granted_j=1.0, store_j=1.0)[0] for seed in range(6)) < -1e-3


def slave(moves: list[float], *, place: float = 0.0, goes_on: Any = lambda n: True, dt: float = DT) -> list[Any]:
    """Send references to a slave's half whose stage goes where it is asked; return its states."""
    params, state, states = config(), lateral_slave_at_rest(), []
    for n, x in enumerate(moves):
        state = lateral_slave_step(params, state, (x, 0.0), (place, 0.0), goes_on(n), dt)
        place = state.x_m if hand_moves(state) else place
        states.append(state)
    return states


def test_the_stage_goes_the_ways_of_the_hand_from_where_it_is() -> None:
    states = slave([5e-7 + 3e-10 * max(n - 10, 0) for n in range(1000)], place=2e-6)
    assert not any(hand_moves(state) for state in states[:10])
    assert states[-1].x_m == pytest.approx(2e-6 + 3e-10 * 989, rel=1e-9)


def test_what_came_after_a_silence_is_no_way_and_lost_signals_lose_none() -> None:
    ways = [3e-10 * n for n in range(1000)]
    # a silence of half a second
    silent = slave(ways[:300] + ways[800:], goes_on=lambda n: n != 300)
    assert silent[-1].x_m == pytest.approx(3e-10 * (299 + 198), rel=1e-3)
    # one of 100 ms that the law bridges brings no more than 20 ms of way
    params, state = config(), silent[299]
    state = lateral_slave_step(params, state, (ways[400], 0.0), (state.x_m, 0.0), True, 0.1)
    assert state.x_m - silent[299].x_m <= 1.5 * 300e-9 * 0.02 * (1.0 + 1e-9)
    # every other signal is lost
    lost = slave(ways[::2], dt=2e-3)
    assert lost[-1].x_m == pytest.approx(ways[998], rel=1e-3)


def test_the_reference_does_not_run_away_from_a_stage_that_cannot_follow() -> None:
    params, state = config(), lateral_slave_at_rest()
    for n in range(3000):
        state = lateral_slave_step(params, state, (3e-10 * n, 0.0), (0.0, 0.0), True, DT)
    assert state.x_m <= 0.1 * 300e-9 + 1e-9 + 1e-12


def test_the_stage_is_given_back_when_the_hand_rests() -> None:
    states = slave([3e-10 * min(n, 500) for n in range(1000)])
    assert hand_moves(states[600]) and not hand_moves(states[750])
