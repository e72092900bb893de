"""Disturbances of the master: off they change no bit, on each has its size and its spectrum."""

import math
from typing import Any

import numpy as np
import pytest
from scipy import signal

from services.haptic_node.node import HapticNode
from telenano.extend.hands import MODE_OFF, DeviceReading, DriveCommand
from telenano.hand import step
from telenano.hand.disturbances import DisturbedHaptic, HandDisturbanceState, disturbed, wander_n
from telenano.hand.sim import SimulatedHaptic
from telenano.sections.hand_section import HapticConfig
from telenano.settings.config import validate
from telenano.settings.hand_disturbances import HandDisturbanceConfig
from telenano.wire.errors import RefusedError

DT = 1e-3
CONFIG = HapticConfig()


def read(config: HandDisturbanceConfig, positions: np.ndarray) -> tuple[np.ndarray, ...]:
    state = HandDisturbanceState(float(positions[0]), 0.0, 0.0, 0)
    rows = []
    for index, position in enumerate(positions.tolist()):
        sample = DeviceReading(position, 0.0, 1.0, False, 0.0, 0.0, False, False, False)
        state, found = disturbed(config, state, sample, index * DT, DT)
        rows.append((found.position_m, found.velocity_m_per_s, found.operator_force_n))
    return tuple(np.array(rows).T)


def only(name: str, **keys: Any) -> HandDisturbanceConfig:
    return HandDisturbanceConfig.model_validate({name: {"enabled": True, **keys}})


def test_switched_off_they_change_no_bit() -> None:
    plain = SimulatedHaptic(CONFIG.to_plant_params(), 0.0)
    wrapped = DisturbedHaptic(CONFIG.to_plant_params(), 0.0, HandDisturbanceConfig())
    for device in (plain, wrapped):
        device.open()
    assert [wrapped.read(1.0 + i * DT, DT) for i in range(50)] == [plain.read(1.0 + i * DT, DT) for i in range(50)]


def test_an_encoder_has_steps_and_its_velocity_is_their_difference() -> None:
    positions = np.linspace(0.0, 1e-4, 301)
    found, velocity, _ = read(only("encoder", resolution_m=1e-6), positions)
    assert np.allclose(found / 1e-6, np.round(found / 1e-6), rtol=0, atol=1e-9)
    assert np.abs(found - positions).max() <= 0.5e-6 * (1 + 1e-9)
    assert velocity[1:] == pytest.approx(np.diff(found) / DT, rel=1e-12, abs=1e-15)


def test_the_noise_of_the_sensor_is_white() -> None:
    _, _, force = read(only("force_noise", rms_n=0.02), np.zeros(10_000))
    assert force.std() == pytest.approx(0.02, rel=0.03)
    power = np.abs(np.fft.rfft(force - force.mean())[1:]) ** 2
    assert [part.mean() / power.mean() for part in np.array_split(power, 4)] == pytest.approx([1.0] * 4, abs=0.1)


def test_tremor_is_a_narrow_band_around_its_frequency() -> None:
    _, _, force = read(only("tremor", rms_n=0.1, frequency_hz=9.0), np.zeros(60_000))
    assert force.std() == pytest.approx(0.1, rel=0.15)
    power = np.abs(np.fft.rfft(force - force.mean())) ** 2
    frequencies = np.fft.rfftfreq(len(force), DT)
    assert abs(frequencies[np.argmax(power)] - 9.0) < 1.0
    assert power[(frequencies > 6.0) & (frequencies < 12.0)].sum() > 0.8 * power.sum()


@pytest.mark.check("takes 8 s")
@pytest.mark.drawn(0.0, "telenano/hand/")
def test_the_wander_falls_with_the_frequency_and_begins_with_the_session() -> None:
    def seeded(seed: int) -> HandDisturbanceConfig:
        return HandDisturbanceConfig.model_validate({"wander": {"enabled": True, "rms_n": 0.1}, "seed": seed})

    forces = [read(seeded(seed), np.zeros(80_000))[2] - 1.0 for seed in range(6)]
    assert np.mean([np.var(force) for force in forces]) == pytest.approx(0.01, rel=0.1)
    found_hz, density = signal.periodogram(np.array(forces), 1.0 / DT, "hann")
    # 48 sines evenly over the logarithm of 0.05 to 13 Hz: rms^2 / (f ln(13 / 0.05)) is their density
    for low, high in ((0.1, 0.4), (0.4, 1.6), (1.6, 6.4)):
        band = (found_hz >= low) & (found_hz < high)
        power = density.mean(axis=0)[band].sum() * found_hz[1]
        assert power == pytest.approx(0.01 * math.log(high / low) / math.log(13.0 / 0.05), rel=0.15), low
    assert density.mean(axis=0)[found_hz > 14.0].sum() * found_hz[1] < 1e-4 * 0.01
    config = only("wander", rms_n=0.1)
    assert wander_n(config, -DT) == 0.0 != wander_n(config, 0.0)


OPERATORS: dict[str, dict[str, Any]] = {
    "force_profile": {"kind": "force_profile", "points": [{"time_s": 0.0, "force_n": 1.0}]},
    "impedance": {"kind": "impedance", "arm": "soft", "path": [{"time_s": 0.0, "position_m": 0.001}]},
    "reacting": {"kind": "reacting", "points": [{"time_s": 0.0, "force_n": 1.0}]},
}


@pytest.mark.parametrize("driver", ["simulated", "simulated_impedance"])
@pytest.mark.parametrize("name", OPERATORS)
def test_each_scripted_hand_trembles_alike_on_a_rig_and_in_a_study(name: str, driver: str) -> None:
    trembling = {"tremor": {"enabled": True}, "wander": {"enabled": True}, "encoder": {"enabled": True}, "seed": 5}
    section = {"operator": OPERATORS[name], "driver": driver}
    steady = validate(HapticConfig, section, "steady", "haptic_node")
    shaking = validate(HapticConfig, {**section, "disturbances": trembling}, "shaking", "haptic_node")
    hand = shaking.to_simulated_hand()
    device = DisturbedHaptic(hand.params, 0.0, shaking.disturbances, hand.capabilities)
    device.open()
    params = shaking.to_params(300, DT).plant
    state, still = step.initial_plant(params, 0.0), step.initial_plant(steady.to_simulated_params(), 0.0)
    apart = []
    for index in range(300):
        command = DriveCommand(MODE_OFF, 0.0, 0.0)
        # the same bits on a rig and in a study
        state, found = step.plant_step(params, state, command, index * DT, DT)
        assert device.read(index * DT, DT) == found
        still, own = step.plant_step(steady.to_simulated_params(), still, command, index * DT, DT)
        apart.append(found.operator_force_n - own.operator_force_n)
    # what the script says and the trembling add up
    assert apart == pytest.approx(params.forces_n + params.wander_n, rel=1e-6, abs=1e-12)
    assert np.std(apart) > 0.01


def test_they_are_switched_while_the_node_runs(bench_of: Any) -> None:
    bench = bench_of("haptic_node@master")
    device = DisturbedHaptic(CONFIG.to_plant_params(), 0.0, HandDisturbanceConfig())
    node = HapticNode(bench.context, CONFIG, device)

    def forces(count: int) -> set[float]:
        for _ in range(count):
            bench.clock.advance_ns(max(0, node.deadline_ns() - bench.clock.monotonic_ns()))
            node.on_deadline(bench.clock.monotonic_ns())
        return {state.operator_force_n[2] for state in bench.take("haptic/state")}

    def switch(**parameters: Any) -> str:
        fields = {"id": "a", "command": "set", "target": "haptic_node", "parameters": parameters}
        return node.on_control(bench.make("session/control", "console@master", **fields))

    assert forces(5) == {0.0}
    assert switch(**{"disturbances.tremor.enabled": True}) == "set disturbances.tremor.enabled = True"
    assert len(forces(20)) == 20
    switch(**{"disturbances.tremor.enabled": False})
    assert forces(5) == {0.0}
    for parameters, what in (
        ({"disturbances.tremor.size": 1.0}, "haptic_node.disturbances.tremor.size: unknown key"),
        ({"limits.max_force_n": 1.0}, "haptic_node.limits: unknown key; keys here begin with disturbances"),
        ({}, "set needs parameters"),
    ):
        with pytest.raises(RefusedError, match=what):
            switch(**parameters)
