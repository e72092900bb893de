"""The law makes no energy whatever line, sample, hand and model are, and the hand is where the tip is."""

import math
import random

import pytest
from telenano_laws.adversary import drawn, judged
from telenano_laws.bounded_model import (
    BOUNDED_MODEL,
    BoundedModelConfig,
    Contact,
    ContactMoments,
    contact_force,
    goal_of,
    lag_terms,
    nothing_seen,
    potential,
    taught,
    updated,
)

from telenano.extend.laws import NO_SIGNAL, HandSample, PortSignal, TipMeasurement

PERIOD_S, POSITION_SCALE, FORCE_SCALE = 1e-3, 1.5e-6, 1e8
# 2 E_0 + E_a of the defaults
GRANTED_J = 2e-3
# the work of a step of the largest force on the largest way that a draw of this file makes
STEP_J = 2e-6


def seen_on_line(stiffness: float, zero_m: float, places: list[float]) -> ContactMoments:
    params, seen = BoundedModelConfig().to_params(PERIOD_S), nothing_seen()
    for place in places:
        seen = taught(params, seen, place, stiffness * (place - zero_m), True, PERIOD_S)
    return seen


def test_the_line_of_a_spring_is_found_and_a_tip_that_stands_changes_nothing() -> None:
    params = BoundedModelConfig().to_params(PERIOD_S)
    places = [1e-3 + 1e-5 * n for n in range(30)]
    goal = goal_of(params, seen_on_line(3000.0, 1e-3, places))
    assert goal.stiffness_n_per_m == pytest.approx(3000.0, rel=0.02)
    assert contact_force(goal, places[-1]) == pytest.approx(3000.0 * (places[-1] - 1e-3), rel=1e-9)
    stood = goal_of(params, seen_on_line(3000.0, 1e-3, places + [places[-1]] * 1000))
    # what was taken for a drift on the way in dies out
    assert stood.stiffness_n_per_m == pytest.approx(goal.stiffness_n_per_m, rel=0.05)
    longer = goal_of(params, seen_on_line(3000.0, 1e-3, places + [places[-1]] * 20_000))
    assert longer.stiffness_n_per_m == pytest.approx(goal.stiffness_n_per_m, rel=0.05)


@pytest.mark.parametrize("speed_m_per_s", [-5e-11, -1e-11, 1e-11, 5e-11])
def test_a_drift_is_told_from_a_slope(speed_m_per_s: float) -> None:
    """A hold of 8 s and a swing of 0.5 Hz on a spring that drifts: the slope stays, and the drift is known."""
    params, seen, drift = BoundedModelConfig().to_params(PERIOD_S), nothing_seen(), speed_m_per_s / POSITION_SCALE
    slopes, speeds = [], []
    for tick in range(16_000):
        time_s = tick * PERIOD_S
        force = min(time_s, 1.0) + (0.3 * math.sin(math.pi * (time_s - 8.0)) if time_s > 8.0 else 0.0)
        seen = taught(params, seen, drift * time_s + force / 3000.0, force, True, PERIOD_S)
        if time_s > 9.0:
            slopes.append(goal_of(params, seen).stiffness_n_per_m)
            speeds.append(seen.drift.speed)
    assert 0.75 * 3000.0 < min(slopes) <= max(slopes) < 1.25 * 3000.0
    assert sum(speeds) / len(speeds) == pytest.approx(drift, rel=0.1)


def test_before_the_tip_has_moved_the_slope_is_the_one_assumed() -> None:
    params = BoundedModelConfig(first_stiffness_n_per_m=500.0).to_params(PERIOD_S)
    assert goal_of(
        params, taught(params, nothing_seen(), 2e-3, 0.2, True, PERIOD_S)
    ).stiffness_n_per_m == pytest.approx(500.0)


@pytest.mark.parametrize("left_j", [0.0, 1e-6, 1e-4, 1.0])
def test_an_update_costs_what_it_says_and_no_more_than_is_left(left_j: float) -> None:
    params = BoundedModelConfig(update_s=1e-3, update_force_n_per_s=1e6).to_params(PERIOD_S)
    start, goal, y = Contact(1000.0, 2e-3, 0.0), Contact(4000.0, 1e-3, 0.5), 2.5e-3
    after, rise = updated(params, start, goal, y, 20.0, left_j)
    assert rise <= left_j
    assert potential(after, y) - potential(start, y) == pytest.approx(rise, abs=1e-18)


def test_the_well_of_a_pull_is_no_deeper_than_allowed() -> None:
    params = BoundedModelConfig(well_energy_j=1e-4).to_params(PERIOD_S)
    seen = seen_on_line(3000.0, 1e-3, [1e-3 - 1e-5 * n for n in range(60)])
    goal = goal_of(params, seen)
    assert potential(goal, goal.zero_m - goal.pull_n / goal.stiffness_n_per_m + 1e-9) >= -1.0001e-4
    assert seen.pull_n == pytest.approx(3000.0 * 59e-5)


def test_the_hand_is_held_back_by_as_much_as_the_tip_is_late() -> None:
    # the impedance of the hand over that of the tip, at 0.5 Hz and 100 ms of round trip, is nearly e^(s T)
    config = BoundedModelConfig(lag_damping=1.0, lag_inertia=0.5)
    params, stiffness, delay_s, omega = config.to_params(PERIOD_S), 3000.0, 0.05, math.pi
    mass, damper = lag_terms(params, stiffness, delay_s)
    hand = stiffness + 1j * omega * damper - omega * omega * mass
    tip = stiffness + 1j * omega * config.servo_damping_n_s_per_m
    late = complex(math.cos(omega * delay_s), math.sin(omega * delay_s))
    assert abs(hand / tip - late) < 5e-3 < 0.1 < abs(1.0 - late)


class Bench:
    """Both halves in plain Python over a line that is late, loses and repeats, on a spring or a wall."""

    def __init__(self, seed: int, config: BoundedModelConfig) -> None:
        self.rng, self.params = random.Random(seed), config.to_params(PERIOD_S)
        self.stiffness = math.exp(self.rng.uniform(math.log(1.0), math.log(170.0)))
        self.bilateral, self.wall_m = self.rng.random() < 0.4, self.rng.choice((0.0, self.rng.uniform(0.0, 2e-9)))
        self.most_late, self.lost = self.rng.choice((0, 20, 200)), self.rng.choice((0.0, 0.3))
        self.tip = self.measured(0.0)
        self.master = BOUNDED_MODEL.master_start(self.params, HandSample(0.0, 0.0, 0.0, True))
        self.slave = BOUNDED_MODEL.slave_start(self.params, self.tip)
        self.forth: list[tuple[int, PortSignal, int]] = []
        self.back: list[tuple[int, PortSignal, int]] = []
        self.heard, self.answer = (-1, NO_SIGNAL), (-1, NO_SIGNAL)
        self.reference, self.energy_j, self.least_j = 0.0, 0.0, 0.0

    def measured(self, base_m: float) -> TipMeasurement:
        force = self.stiffness * (base_m - self.wall_m)
        force = force if self.bilateral else max(force, 0.0)
        return TipMeasurement(base_m, force, 0.0, True, force != 0.0, True, 0.0)

    def crossed(self, line: list[tuple[int, PortSignal, int]], tick: int, signal: PortSignal) -> None:
        if self.rng.random() >= self.lost:
            line.append((tick + self.rng.randint(self.most_late // 2, self.most_late), signal, tick))

    def newest(
        self, line: list[tuple[int, PortSignal, int]], tick: int, last: tuple[int, PortSignal]
    ) -> tuple[tuple[int, PortSignal], PortSignal]:
        due = [(sent, signal) for at, signal, sent in line if at <= tick]
        line[:] = [row for row in line if row[0] > tick]
        came = max(due, key=lambda row: row[0], default=last)
        new = came if came[0] > last[0] else last
        silence = 0.0 if new[0] > last[0] else 1e-3 * (tick - last[0]) if last[0] >= 0 else 1e9
        return new, new[1]._replace(silence_s=silence, round_trip_s=1e-3 * max(tick - new[0], 0))

    def step(self, tick: int, hand_n: float) -> None:
        law, hand = BOUNDED_MODEL, HandSample(self.reference, 0.0, hand_n, True)
        self.master, signal = law.master_send(self.params, self.master, hand, PERIOD_S)
        self.crossed(self.forth, tick, signal)
        self.heard, signal = self.newest(self.forth, tick, self.heard)
        self.slave, wanted = law.slave_receive(self.params, self.slave, signal, self.tip, PERIOD_S)
        after = self.measured(wanted.position_m)
        way = (after.base_position_m - self.tip.base_position_m) / POSITION_SCALE
        self.energy_j -= 0.5 * FORCE_SCALE * (after.force_n + self.tip.force_n) * way
        self.tip = after
        self.slave, answer = law.slave_send(self.params, self.slave, self.tip, PERIOD_S)
        self.crossed(self.back, tick, answer)
        self.answer, answer = self.newest(self.back, tick, self.answer)
        self.master, reference = law.master_receive(self.params, self.master, hand, answer, PERIOD_S)
        self.energy_j += hand_n * (reference.position_m - self.reference)
        self.reference = reference.position_m
        self.least_j = min(self.least_j, self.energy_j)


# Draws 15 and 39 notice a tip whose way is not cut to its store.
@pytest.mark.parametrize("seed", [*range(8), 15, 39])
def test_no_more_energy_leaves_the_ports_than_was_granted(seed: int) -> None:
    rng = random.Random(1000 + seed)
    # every other draw is granted nothing, and its model is wrong from the beginning
    nothing = {"start_energy_j": 0.0, "well_energy_j": 0.0} if seed % 2 else {}
    config = BoundedModelConfig(
        first_stiffness_n_per_m=10.0 ** rng.uniform(1.0, 5.0), memory_m=10.0 ** rng.uniform(-11.0, -9.0), **nothing
    )
    bench, each = Bench(seed, config), rng.choice((50, 150, 400))
    arm_n_per_m = rng.choice((0.0, 10.0 ** rng.uniform(1.5, 3.5)))
    force, aim_m = 0.0, 0.0
    for tick in range(2000):
        if tick % each == 0:
            force, aim_m = rng.choice((0.0, rng.uniform(-1.0, 3.0))), rng.uniform(-1e-3, 3e-3)
        arm_n = arm_n_per_m * (aim_m - bench.reference)
        bench.step(tick, min(max(arm_n, -5.0), 5.0) if arm_n_per_m > 0.0 else force)
    assert bench.least_j >= -(0.0 if nothing else GRANTED_J) - STEP_J
    assert abs(bench.reference) > 0.0


def test_the_tip_goes_nowhere_where_nothing_was_granted_and_nobody_has_paid() -> None:
    bench = Bench(0, BoundedModelConfig(start_energy_j=0.0, well_energy_j=0.0))
    bench.most_late, bench.lost, bench.bilateral, bench.wall_m = 0, 0.0, True, 0.0
    for tick in range(300):
        bench.step(tick, 1.0 if tick < 150 else 0.0)
    assert bench.least_j >= -STEP_J


@pytest.mark.parametrize("hand_n", [-0.7, 0.7])
def test_a_hand_at_the_end_of_its_travel_pays_for_no_way_that_its_device_did_not_make(hand_n: float) -> None:
    """Draw 206: the reference runs ahead of a device that is stuck, and comes back when the device is off for once."""
    config = BoundedModelConfig()
    params, law = config.to_params(PERIOD_S), BOUNDED_MODEL
    state = law.master_start(params, HandSample(0.0, 0.0, 0.0, True))
    # The tip asks for all that there is.
    answer = NO_SIGNAL._replace(active=True, silence_s=0.0, energy_j=1.0)
    reference, energy_j = 0.0, 0.0
    for tick in range(600):
        hand = HandSample(0.0, 0.0, hand_n, tick < 599)
        state, wanted = law.master_receive(params, state, hand, answer, PERIOD_S)
        energy_j += hand_n * (wanted.position_m - reference)
        reference = wanted.position_m
        if tick == 598:
            assert abs(reference) > 1.9e-3
    assert reference == 0.0
    assert energy_j - state.store.sent_j >= -config.start_energy_j - STEP_J


def test_a_draw_follows_from_its_number() -> None:
    assert drawn(7) == drawn(7) != drawn(8)


@pytest.mark.check("compiles the law with spring and contact")
@pytest.mark.drawn(0.5, "packages/telenano-laws/telenano_laws/")
@pytest.mark.parametrize("number", [5, 17, 43, 47, 51])
def test_the_worst_draws_stay_within_what_was_granted(number: int) -> None:
    found = judged(number)
    assert -GRANTED_J <= found.least_j < 0.0
    assert found.least_at_device_j >= -GRANTED_J


class Ends:
    """Both halves of the law with a device that has ends of travel, on a wall that recedes, over 20 ms each way."""

    late, stiffness, travel_m = 20, 20.0, 4e-3

    def __init__(self, recedes_m_per_s: float) -> None:
        self.params = BoundedModelConfig().to_params(PERIOD_S)
        self.recedes_m_per_s, self.place_m, self.reference_m = recedes_m_per_s, 0.0, 0.0
        self.tip = TipMeasurement(0.0, 0.0, 0.0, True, False, True, 0.0)
        self.master = BOUNDED_MODEL.master_start(self.params, HandSample(0.0, 0.0, 0.0, True))
        self.slave = BOUNDED_MODEL.slave_start(self.params, self.tip)
        self.forth: list[tuple[int, PortSignal]] = []
        self.back: list[tuple[int, int, PortSignal]] = []
        self.heard, self.answer = (-(10**6), NO_SIGNAL), (-(10**6), 0, NO_SIGNAL)
        self.law_j = self.device_j = self.least_law_j = self.least_device_j = 0.0

    def step(self, tick: int, hand_n: float, silent: str) -> None:
        law, hand = BOUNDED_MODEL, HandSample(self.place_m, 0.0, hand_n, True)
        self.master, signal = law.master_send(self.params, self.master, hand, PERIOD_S)
        if "forward" not in silent:
            self.forth.append((tick + self.late, signal))
        if self.forth and self.forth[0][0] <= tick:
            self.heard = (tick, self.forth.pop(0)[1])
        signal = self.heard[1]._replace(silence_s=1e-3 * (tick - self.heard[0]))
        self.slave, wanted = law.slave_receive(self.params, self.slave, signal, self.tip, PERIOD_S)
        force = max(self.stiffness * (wanted.position_m - self.recedes_m_per_s * 1e-3 * tick), 0.0)
        way_m = (wanted.position_m - self.tip.base_position_m) / POSITION_SCALE
        got_j = 0.5 * FORCE_SCALE * (force + self.tip.force_n) * way_m
        self.tip = TipMeasurement(wanted.position_m, force, 0.0, True, force != 0.0, True, 0.0)
        self.slave, answer = law.slave_send(self.params, self.slave, self.tip, PERIOD_S)
        if "backward" not in silent:
            self.back.append((tick + self.late, tick, answer))
        if self.back and self.back[0][0] <= tick:
            self.answer = (tick, *self.back.pop(0)[1:])
        came, measured, answer = self.answer
        answer = answer._replace(silence_s=1e-3 * (tick - came), round_trip_s=1e-3 * (tick - measured))
        self.master, reference = law.master_receive(self.params, self.master, hand, answer, PERIOD_S)
        # a servo of 30 Hz between two ends
        share = 1.0 - math.exp(-2.0 * math.pi * 30.0 * PERIOD_S) if reference.active else 0.0
        place_m = self.place_m + share * (reference.position_m - self.place_m)
        place_m = min(max(place_m, -self.travel_m), self.travel_m)
        self.law_j += hand_n * (reference.position_m - self.reference_m) - got_j
        self.device_j += hand_n * (place_m - self.place_m) - got_j
        self.reference_m, self.place_m = reference.position_m, place_m
        self.least_law_j = min(self.least_law_j, self.law_j)
        self.least_device_j = min(self.least_device_j, self.device_j)


@pytest.mark.parametrize("silent", ["forward backward", "backward"])
def test_a_silence_at_the_end_of_travel_makes_no_energy(silent: str) -> None:
    """The lead of the reference is undone when the hand is let go, 0.6 s of silence in each 1.5 s, and has to be paid.

    Before that was booked the ports had made 4 mJ in 20 s, and 50 in 240 s.
    """
    ends = Ends(0.5e-9)
    for tick in range(20_000):
        ends.step(tick, 1.0, silent if tick % 1500 < 600 else "")
    assert ends.least_law_j >= -GRANTED_J
    assert ends.least_device_j >= -GRANTED_J


@pytest.mark.parametrize("pushes", [(0.3, 3.0), (3.0, 0.3)])
def test_a_hand_at_the_end_of_travel_that_changes_its_force_pays_for_no_way_of_the_reference(
    pushes: tuple[float, float],
) -> None:
    """A reference that goes ahead of a stuck device under one force and back under another is no work at the device."""
    ends = Ends(0.5e-9)
    for tick in range(15_000):
        cycle = tick % 1500
        ends.step(tick, pushes[0] if 600 < cycle < 1450 else pushes[1], "forward backward" if cycle < 600 else "")
    assert ends.least_device_j >= -GRANTED_J


def test_other_scales_keep_force_and_energy_of_the_contact_that_is_rendered() -> None:
    ends = Ends(0.0)
    for tick in range(3000):
        ends.step(tick, 1.0, "")
    config = BoundedModelConfig(position_scale=1e-6, mass_kg=2.0)
    old, new, before = ends.params, config.to_params(PERIOD_S), ends.master
    after = BOUNDED_MODEL.retune(old, new, before)
    y_before = (before.mass.tip_offset_m + 1.5e-6 * before.mass.position_m) / 1.5e-6
    y_after = (after.mass.tip_offset_m + 1e-6 * after.mass.position_m) / 1e-6
    force = contact_force(before.contact, y_before)
    assert force == pytest.approx(1.0, rel=0.01)
    assert contact_force(after.contact, y_after) == pytest.approx(force, rel=1e-9)
    rise = potential(after.contact, y_after) - potential(before.contact, y_before)
    assert rise > 0.0
    assert after.store.left_j == pytest.approx(before.store.left_j - rise, rel=1e-12)
    # the mass becomes another one where its momentum can be kept
    assert after.mass_kg == before.mass_kg
    slave = BOUNDED_MODEL.slave_retune(old, new, ends.slave)
    assert slave.last_m * 1e-6 == pytest.approx(ends.slave.last_m * 1.5e-6, rel=1e-12)
