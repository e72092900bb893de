"""The virtual coupling: its critical stiffness against theory, its energy, and the rules that take the force away."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from coupling_theory import critical_stiffness
from telenano_devices.impedance.coupled import arm_step
from telenano_devices.impedance.coupling import (
    ZERO,
    CouplingReading,
    CouplingReference,
    CouplingSettings,
    CouplingState,
    Gate,
    Vector,
    coupling_at_start,
    coupling_step,
    passive_stiffness_n_per_m,
    stable_stiffness_n_per_m,
)

T = 1e-3
# mass [kg] and damping [N s/m] that stand for makes of devices
TOUCH, INVERSE3, OMEGA, HEAVY = (0.045, 0.05), (0.20, 0.20), (0.25, 0.50), (0.35, 2.0)
# device, rate [Hz], B [N s/m], delay [sample times], critical K [N/m], hands off and with the reference clamped
CASES = [
    (TOUCH, 1000, 0.0, 0.0, 100.0),
    (TOUCH, 1000, 1.0, 0.0, 2054.0),
    (TOUCH, 1000, 1.0, 0.5, 1027.0),
    (TOUCH, 1000, 1.0, 1.0, 682.9),
    (TOUCH, 4000, 0.025, 1.0, 200.0),
    (TOUCH, 4000, 1.0, 1.0, 2783.0),
    (INVERSE3, 1000, 2.0, 0.0, 4357.0),
    (INVERSE3, 1000, 2.0, 1.0, 1451.0),
    (INVERSE3, 4000, 2.0, 0.5, 8778.0),
    (OMEGA, 1000, 0.25, 1.0, 499.7),
    (OMEGA, 1000, 2.0, 0.5, 2481.0),
    (OMEGA, 4000, 2.0, 1.0, 6653.0),
    (HEAVY, 1000, 1.0, 1.0, 1997.0),
    (HEAVY, 4000, 1.0, 0.0, 23990.0),
    # delays of several samples, as of a service between
    (INVERSE3, 1000, 3.0, 5.0, None),
    (OMEGA, 4000, 4.0, 2.25, None),
]


def growth(device: tuple[float, float], rate_hz: float, k: float, b: float, delay: float) -> float:
    """Return by what the swing of an arm under the coupling has grown, from the middle to the end of its motion."""
    period_s = 1.0 / rate_hz
    settings = CouplingSettings((0.0, 0.0, k), (0.0, 0.0, b), 1e6, 1e12, frozen_s=0.0, rest_s=0.0)
    state, reference = coupling_at_start(), CouplingReference(ZERO, ZERO, ZERO, False, 0.0, 0)
    x, v, late = 1e-4, 0.0, [0.0] * (math.floor(delay + 1e-9) + 1)
    part = (delay - math.floor(delay + 1e-9)) * period_s
    places: list[float] = []
    # some thirty swings
    count = round(30 * 2.0 * math.pi * math.sqrt(device[0] / k) / period_s)
    for index in range(count):
        reference = reference._replace(engaged=index > 2)
        force, state = coupling_step(
            state, settings, reference, CouplingReading((0.0, 0.0, x), 0.0, True, 0.0), period_s
        )
        late.append(force[2])
        if part:
            x, v = arm_step(*device, x, v, late[0], part)
        x, v = arm_step(*device, x, v, late[1], period_s - part)
        late.pop(0)
        places.append(abs(x))
    assert state.gate == Gate.ACTIVE
    third = count // 3
    return max(places[-third:]) / max(places[third : 2 * third])


@pytest.mark.parametrize(("device", "rate_hz", "b", "delay", "published"), CASES)
def test_motion_dies_out_below_the_critical_stiffness_of_theory_and_grows_above(
    device: tuple[float, float], rate_hz: float, b: float, delay: float, published: float | None
) -> None:
    critical = critical_stiffness(device, rate_hz, b, delay)
    if published is not None:
        assert critical == pytest.approx(published, rel=1e-3, abs=0.0)
    assert growth(device, rate_hz, 0.97 * critical, b, delay) < 1.0
    assert growth(device, rate_hz, 1.03 * critical, b, delay) > 1.0


@pytest.mark.parametrize(("device", "rate_hz", "b", "delay", "published"), CASES)
def test_stable_bound_is_the_critical_stiffness_from_above(
    device: tuple[float, float], rate_hz: float, b: float, delay: float, published: float | None
) -> None:
    bound = stable_stiffness_n_per_m(device[1], b, 1.0 / rate_hz, delay / rate_hz)
    critical = critical_stiffness(device, rate_hz, b, delay)
    # The eigenvalues lie below it by a fraction of about B T / m and the periods of delay, far inside the margin of 4.
    assert critical < 1.001 * bound < critical * (1.05 + 2.0 * b * (0.5 + delay) / (rate_hz * device[0]))


@pytest.mark.parametrize(
    ("device", "rate_hz", "b", "passive"),
    [(TOUCH, 1000, 0.0, 100.0), (TOUCH, 1000, 0.025, 50.0), (OMEGA, 4000, 0.0, 4000.0), (HEAVY, 1000, 1.0, 2000.0)],
)
def test_passive_bound_has_the_published_values(
    device: tuple[float, float], rate_hz: float, b: float, passive: float
) -> None:
    assert passive_stiffness_n_per_m(device[1], b, 1.0 / rate_hz, 0.0) == pytest.approx(passive, rel=1e-9, abs=0.0)
    assert passive_stiffness_n_per_m(device[1], device[1] + b, 1.0 / rate_hz, 0.0) == 0.0


def energy_of_swings(k: float) -> float:
    """Return what an ideal coupling has taken in after a hand with no damping has swung, at a device of b = 0.5."""
    settings = CouplingSettings((0.0, 0.0, k), (0.0, 0.0, 0.0), 1e6, 1e12, frozen_s=0.0, rest_s=0.0)
    state, reference = coupling_at_start(), CouplingReference(ZERO, ZERO, ZERO, False, 0.0, 0)
    x, v = 1e-3, 0.0
    for index in range(2000):
        reading = CouplingReading((0.0, 0.0, x), 0.0, True, 0.0)
        force, state = coupling_step(state, settings, reference._replace(engaged=index > 2), reading, T)
        x, v = arm_step(0.25, 0.0, x, v, force[2], T)
    return state.coupling_energy_j


def test_energy_of_the_coupling_goes_below_zero_where_its_samples_make_energy() -> None:
    """A sampled spring gives K T / 2 more than it takes, and here no damping of the device pays for it."""
    assert energy_of_swings(500.0) < 0.0


def test_energy_of_spring_and_damper_is_what_they_hold_and_have_taken() -> None:
    settings = CouplingSettings((0.0, 0.0, 400.0), (0.0, 0.0, 3.0), 1e6, 1e12, rest_s=0.0)
    held = Held(settings)
    held.engage()
    speed, way = 0.01, 0.0
    for _ in range(500):
        way += speed * T
        held.step((0.0, 0.0, -way))
    expected = 0.5 * 400.0 * way * way + 3.0 * speed * way
    assert held.state.coupling_energy_j == pytest.approx(expected, rel=0.01, abs=0.0)
    # the reference stands, so all of it came from the hand
    assert held.state.hand_energy_j == pytest.approx(held.state.coupling_energy_j, rel=1e-9, abs=0.0)


class Held:
    """A coupling with a hand that a test puts where it likes."""

    def __init__(self, settings: CouplingSettings | None = None) -> None:
        default = CouplingSettings((0.0, 0.0, 500.0), (0.0, 0.0, 2.0), 8.0, 800.0)
        self.settings = default if settings is None else settings
        self.state: CouplingState = coupling_at_start()
        self.reference = CouplingReference(ZERO, ZERO, ZERO, False, 0.0, 0)
        self.reading = CouplingReading(ZERO, 0.0, True, 0.0)
        self.force: Vector = ZERO

    def step(self, place: Vector | None = None, count: int = 1, dt: float = T) -> int:
        if place is not None:
            self.reading = self.reading._replace(position_m=place)
        for _ in range(count):
            self.force, self.state = coupling_step(self.state, self.settings, self.reference, self.reading, dt)
        return self.state.gate

    def engage(self) -> None:
        """Come to rest, and be engaged there."""
        self.step(count=round(self.settings.rest_s / T) + 2)
        assert self.state.gate == Gate.READY
        self.reference = self.reference._replace(engaged=True)
        assert self.step() == Gate.ACTIVE

    def press(self, depth_m: float, speed_m_per_s: float = 0.05) -> None:
        """Push the hand towards the sample from where the reference is."""
        count = round(depth_m / speed_m_per_s / T)
        for index in range(count):
            self.step((0.0, 0.0, -depth_m * (index + 1) / count))


@pytest.fixture
def held() -> Held:
    """Give a coupling that a hand at rest is engaged with."""
    engaged = Held()
    engaged.engage()
    return engaged


def test_no_force_before_the_hand_has_been_at_rest() -> None:
    held = Held()
    held.reference = held.reference._replace(engaged=True)
    for index in range(400):
        assert held.step((0.01 * math.sin(0.05 * index), 0.0, 0.0)) == Gate.REST and held.force == ZERO
    # Now it rests, and the node has to let go once: its reference is not where the hand is.
    held.step(count=250)
    assert held.state.gate == Gate.RELEASED and held.force == ZERO
    held.reference = held.reference._replace(engaged=False)
    assert held.step() == Gate.READY
    held.reference = held.reference._replace(engaged=True)
    assert held.step() == Gate.ACTIVE


def test_force_at_rest_is_the_stiffness_times_the_offset_and_pushes_the_hand_back(held: Held) -> None:
    held.press(0.004)
    held.step(count=50)
    assert held.force == pytest.approx((0.0, 0.0, 2.0), rel=1e-12, abs=0.0)


def test_force_keeps_its_clamp_and_its_slew(held: Held) -> None:
    held.reference = held.reference._replace(position_m=(0.0, 0.0, 0.1))
    sizes = [0.0]
    for _ in range(30):
        held.step()
        sizes.append(held.force[2])
        assert held.state.limited
    assert max(np.diff(sizes)) == pytest.approx(0.8, rel=1e-9) and sizes[-1] == pytest.approx(8.0, rel=1e-12)
    assert max(sizes) <= 8.0 * (1.0 + 1e-12)


def test_clamp_keeps_the_direction_of_the_force(held: Held) -> None:
    held.reference = held.reference._replace(force_n=(30.0, 0.0, 40.0))
    held.step(count=30)
    assert held.force == pytest.approx((4.8, 0.0, 6.4), rel=1e-9)


SILENCES: dict[str, tuple[Callable[[Held], None], int]] = {
    "the node": (lambda held: _set(held, age_s=0.0501), Gate.SILENT),
    "the device": (lambda held: _read(held, age_s=0.0501), Gate.DEVICE_SILENT),
    "an age that is not a number": (lambda held: _read(held, age_s=math.nan), Gate.DEVICE_SILENT),
    "a reference that is not a number": (lambda held: _set(held, position_m=(0.0, math.nan, 0.0)), Gate.REFERENCE),
}


def _set(held: Held, **changes: object) -> None:
    held.reference = held.reference._replace(**changes)


def _read(held: Held, **changes: object) -> None:
    held.reading = held.reading._replace(**changes)


@pytest.mark.parametrize("name", SILENCES)
def test_silence_takes_the_force_at_once_and_the_hand_has_to_rest_anew(held: Held, name: str) -> None:
    make, gate = SILENCES[name]
    held.press(0.004)
    good = held.reference, held.reading
    _set(held, age_s=0.0499)
    assert held.step() == Gate.ACTIVE and held.force[2] > 1.0
    make(held)
    assert held.step() == gate and held.force == ZERO
    held.reference, held.reading = good
    assert held.step() == Gate.REST
    held.step(count=250)
    # the node was engaged all along: it would begin with the offset of before
    assert held.state.gate == Gate.RELEASED and held.force == ZERO
    assert Gate(gate).text.startswith("the device gives no force")


def test_law_that_lets_go_takes_the_force_and_begins_again_from_zero(held: Held) -> None:
    held.press(0.004)
    _set(held, engaged=False)
    assert held.step() == Gate.READY and held.force == ZERO
    # guards begin where the hand is
    _set(held, engaged=True, position_m=(0.0, 0.0, -0.004))
    assert held.step() == Gate.ACTIVE and held.force == pytest.approx(ZERO, abs=1e-12)


def test_deadman_button_that_is_let_go_or_asleep_takes_the_force() -> None:
    held = Held(CouplingSettings((0.0, 0.0, 500.0), (0.0, 0.0, 2.0), 8.0, 800.0, needs_deadman=True))
    held.engage()
    held.press(0.004)
    # a grip speaks at some 50 Hz, and one word may be lost
    _read(held, deadman_age_s=0.045)
    assert held.step() == Gate.ACTIVE and held.force[2] > 1.0
    _read(held, deadman_age_s=0.11)
    assert held.step() == Gate.DEADMAN and held.force == ZERO
    _read(held, deadman_age_s=0.0, deadman=False)
    assert held.step() == Gate.DEADMAN and held.force == ZERO
    _read(held, deadman=True)
    assert held.step() == Gate.RELEASED and held.force == ZERO
    _set(held, engaged=False)
    assert held.step() == Gate.READY


def jump(held: Held) -> None:
    held.step((0.0, 0.01, -0.004))


def no_number(held: Held) -> None:
    held.step((0.0, 0.0, math.nan))


def frozen(held: Held) -> None:
    """The place stays while the reference moves on."""
    for index in range(150):
        _set(held, position_m=(0.0, 0.0, 1e-4 * index))
        held.step()


def wrong_sign(held: Held) -> None:
    """The hand is thrown towards the sample by what should push it back."""
    speed = 0.0
    for _ in range(200):
        speed += held.force[2] / 0.2 * T
        held.step((0.0, 0.0, held.reading.position_m[2] - speed * T))


@pytest.mark.parametrize(
    ("fault", "gate"),
    [(jump, Gate.JUMP), (no_number, Gate.NOT_A_NUMBER), (frozen, Gate.FROZEN), (wrong_sign, Gate.RUNAWAY)],
)
def test_reading_that_cannot_be_believed_is_refused_until_armed(
    held: Held, fault: Callable[[Held], None], gate: int
) -> None:
    held.press(0.004)
    before = held.state.position_m
    fault(held)
    assert held.state.gate == gate and held.force == ZERO
    assert all(map(math.isfinite, held.state.position_m))
    if gate != Gate.RUNAWAY:
        assert held.state.position_m == before
    # it stays refused when the readings are good again, and when the law lets go
    _set(held, engaged=False)
    held.step((0.0, 0.0, -0.004), count=500)
    assert held.state.gate == gate and "until armed" in Gate(gate).text
    _set(held, arm_count=1)
    assert held.step() == Gate.REST
    held.step(count=210)
    assert held.state.gate == Gate.READY


def test_fast_hand_and_a_resting_one_are_not_refused(held: Held) -> None:
    _set(held, engaged=False)
    place = 0.0
    for index in range(2000):
        place += 1.5 * math.sin(0.02 * index) * T
        held.step((place, 0.0, 0.0))
        assert held.state.gate == Gate.READY
    # at rest under a constant force: the encoder says the same count for seconds
    _set(held, engaged=True, position_m=(place, 0.0, 0.0))
    held.step(count=3000)
    assert held.state.gate == Gate.ACTIVE


def test_late_step_of_the_servo_is_no_jump(held: Held) -> None:
    _set(held, engaged=False)
    held.step((0.03, 0.0, 0.0), dt=0.02)
    assert held.state.gate == Gate.READY


def test_time_of_a_step_must_be_positive() -> None:
    with pytest.raises(ValueError, match="dt of the coupling"):
        Held().step(dt=0.0)
