"""Disturbances of the master: off they change no bit, on each has its size and its spectrum."""

from typing import Any

import numpy as np
import pytest

from services.haptic_node.node import HapticNode
from telenano.extend.hands import DeviceReading
from telenano.hand.config import HapticConfig
from telenano.hand.disturbances import DisturbedHaptic, HandDisturbanceConfig, HandDisturbanceState, disturbed
from telenano.hand.sim import SimulatedHaptic
from telenano.wire.errors import RefusedError

DT = 1e-3
CONFIG = HapticConfig()


def read(config: HandDisturbanceConfig, positions: np.ndarray) -> tuple[np.ndarray, ...]:
    state = HandDisturbanceState(float(positions[0]), 0.0, 0.0, 0)
    rows = []
    for position in positions.tolist():
        sample = DeviceReading(position, 0.0, 1.0, False, 0.0, 0.0, False, False, False)
        state, found = disturbed(config, state, sample, DT)
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
        ({"limits.max_force_n": 1.0}, "haptic_node.limits: unknown key, known is disturbances"),
        ({}, "set needs parameters"),
    ):
        with pytest.raises(RefusedError, match=what):
            switch(**parameters)
