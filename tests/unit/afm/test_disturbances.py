"""Disturbances: off they change no bit, on each has the size and the spectrum that it is configured with."""

import math
import os
import subprocess
import sys
from typing import Any

import numpy as np
import pytest
from scipy import signal

from services.afm_node.node import AfmNode
from telenano.afm.disturbances import BOLTZMANN_J_PER_K, noise_start, noise_step
from telenano.afm.disturbed import (
    converted_v,
    converter_params,
    converter_step_v,
    piezo_at_rest,
    piezo_params,
    piezo_step,
    read_out,
)
from telenano.afm.sim import SimulatedInstrument, simulated_afm
from telenano.devices.afm.instrument import driver_of
from telenano.numerics.normal_numbers import normal_number
from telenano.sections.afm_section import AfmConfig
from telenano.settings.afm_disturbances import DisturbanceConfig
from telenano.wire.errors import RefusedError
from telenano.wire.node_state import pack, restore

DT = 1e-3
VOLTS_PER_M = 6.25e6
CONFIG = AfmConfig.model_validate({"cantilever": {"stiffness_n_per_m": 1.0}})


def only(name: str, **keys: Any) -> DisturbanceConfig:
    return DisturbanceConfig.model_validate({name: {"enabled": True, **keys}, "seed": 4})


def displacements(config: DisturbanceConfig, bases: np.ndarray) -> np.ndarray:
    piezo = piezo_params(config.hysteresis, config.creep, config.stage)
    state, drawn, found = piezo_at_rest(0.0), noise_start(), []
    for base in bases.tolist():
        state, x = piezo_step(piezo, state, base, DT)
        drawn, noise = noise_step(config, drawn, 1.0, DT)
        found.append(x + noise.drift_m + noise.vibration_m)
    return np.array(found)


def readings(config: DisturbanceConfig, zeta_m: float, count: int, stiffness: float = 1.0) -> np.ndarray:
    converter, state, found = converter_params(config.readout, VOLTS_PER_M), noise_start(), []
    for _ in range(count):
        state, noise = noise_step(config, state, stiffness, DT)
        found.append(read_out(converter, noise, zeta_m))
    return np.array(found)


def instrument(disturbances: DisturbanceConfig) -> SimulatedInstrument:
    return simulated_afm(CONFIG.to_params(), disturbances=disturbances)


def test_switched_off_they_change_no_bit() -> None:
    plain, wrapped = simulated_afm(CONFIG.to_params()), instrument(DisturbanceConfig())
    plain.open()
    wrapped.open()
    for i in range(300):
        wrapped.elapse(DT)
        base = -5e-9 + i * 1e-10
        assert wrapped.exchange(base) == plain.exchange(base)


def test_what_lags_behind_is_at_rest_where_it_is_switched_on() -> None:
    wrapped = instrument(DisturbanceConfig())
    wrapped.open()
    for _ in range(100):
        wrapped.elapse(DT)
        wrapped.exchange(-50e-9)
    before = wrapped.exchange(-50e-9)
    names = ("creep", "hysteresis", "drift")
    wrapped.configure(DisturbanceConfig.model_validate({name: {"enabled": True} for name in names}))
    wrapped.elapse(DT)
    # a millisecond of drift, 50 fm, and no more
    assert abs(wrapped.exchange(-50e-9).distance_m - before.distance_m) < 1e-13


@pytest.mark.parametrize("name", ["creep", "hysteresis", "stage"])
def test_what_is_switched_on_beside_another_begins_at_rest_where_the_base_is(name: str) -> None:
    wrapped = instrument(DisturbanceConfig.model_validate({"drift": {"enabled": True, "speed_m_per_s": 0.0}}))
    wrapped.open()
    for base_m in (-100e-9, -50e-9, -50e-9):
        wrapped.elapse(DT)
        before = wrapped.exchange(base_m)
    drift = {"enabled": True, "speed_m_per_s": 0.0}
    wrapped.configure(DisturbanceConfig.model_validate({"drift": drift, name: {"enabled": True}}))
    wrapped.elapse(DT)
    assert wrapped.exchange(-50e-9).distance_m == pytest.approx(before.distance_m, rel=0.0, abs=1e-18)


def test_vibration_has_its_rms_and_stays_in_its_band() -> None:
    found = displacements(only("vibration", rms_m=0.2e-9, low_hz=5.0, high_hz=100.0), np.zeros(20_000))
    assert found.std() == pytest.approx(0.2e-9, rel=0.05, abs=0.0)
    power = np.abs(np.fft.rfft(found * np.hanning(len(found)))) ** 2
    frequencies = np.fft.rfftfreq(len(found), DT)
    inside = (frequencies > 4.5) & (frequencies < 101.0)
    assert power[inside].sum() > 0.999 * power.sum()
    # as much in the lower decade of the band as its share of the logarithm
    low = (frequencies > 4.5) & (frequencies < math.sqrt(500.0))
    assert power[low].sum() / power.sum() == pytest.approx(0.5, abs=0.12)


def test_hysteresis_is_a_loop_of_its_share_that_closes_and_forgets_small_steps() -> None:
    config = only("hysteresis", share=0.1, range_m=100e-9)
    there = np.linspace(-50e-9, 50e-9, 500)
    found = displacements(config, np.concatenate([there, there[::-1], there, there[::-1]]))
    up, down = found[1000:1500], found[1500:][::-1]
    middle = 250
    # over the whole range the two ways differ by the share of it
    assert down[middle] - up[middle] == pytest.approx(10e-9, rel=0.02, abs=0.0)
    assert np.allclose(found[1500:], found[500:1000], rtol=0, atol=1e-15)
    # a small motion is within all plays: one line
    motion = 0.2e-9 * np.sin(np.linspace(0.0, 4 * math.pi, 400))
    small = displacements(config, motion)
    assert np.ptp(small - np.polyval(np.polyfit(motion, small, 1), motion)) < 1e-15


@pytest.mark.parametrize("amplitude_m", [5e-9, 20e-9, 50e-9])
def test_the_area_of_a_loop_is_that_of_its_play_operators(amplitude_m: float) -> None:
    config = only("hysteresis", share=0.05, range_m=100e-9)
    there = np.linspace(-amplitude_m, amplitude_m, 4001)
    motion = np.concatenate([there, there[::-1], there, there[::-1]])
    found = displacements(config, motion)[len(motion) // 2 :]
    x = motion[len(motion) // 2 :]
    # by Green's theorem, over the second round
    area = abs(0.5 * np.sum(x * np.roll(found, -1) - np.roll(x, -1) * found))
    # a play of r under a motion of amplitude A goes round a parallelogram, 2 r wide and 2 (A - r) high
    piezo = piezo_params(config.hysteresis, config.creep)
    radii = piezo.play_radii_m[piezo.play_radii_m < amplitude_m]
    assert area == pytest.approx(piezo.play_weight * np.sum(4.0 * radii * (amplitude_m - radii)), rel=2e-3, abs=0.0)


@pytest.mark.parametrize(("resonance_hz", "damping"), [(200.0, 0.7071), (200.0, 0.02), (45.0, 0.3)])
def test_the_stage_is_the_second_order_lag_that_it_is_configured_as(resonance_hz: float, damping: float) -> None:
    w = 2.0 * math.pi * resonance_hz
    rng = np.random.Generator(np.random.PCG64(3))
    bases = np.concatenate([np.full(40, 1e-9), rng.normal(0.0, 1e-9, 400)])
    found = displacements(only("stage", resonance_hz=resonance_hz, damping=damping), bases)
    # SciPy's own discretisation of the same equation of motion
    matrices = ([[0.0, 1.0], [-w * w, -2.0 * damping * w]], [[0.0], [w * w]], [[1.0, 0.0]], [[0.0]])
    a, b, c, *_ = signal.cont2discrete(tuple(map(np.array, matrices)), DT, method="zoh")
    state, expected = np.zeros((2, 1)), []
    for base in bases.tolist():
        state = a @ state + b * base
        expected.append(float((c @ state)[0, 0]))
    assert found == pytest.approx(np.array(expected), rel=1e-9, abs=1e-20)


def test_the_bandwidth_of_the_stage_is_three_decibels_down_at_its_resonance() -> None:
    time_s = DT * np.arange(4000)
    for frequency_hz, gain in ((2.0, 1.0), (200.0, math.sqrt(0.5))):
        # steps of a millisecond are a hold, whose own gain and lead are taken off
        moved = displacements(only("stage"), np.sin(2.0 * math.pi * frequency_hz * time_s))[2000:]
        tone = np.exp(-2j * math.pi * frequency_hz * time_s[2000:])
        hold = np.sinc(frequency_hz * DT)
        assert abs(2.0 * np.mean(moved * tone)) / hold == pytest.approx(gain, rel=0.06)


def test_a_stage_without_a_lag_is_where_it_is_sent() -> None:
    bases = 1e-9 * np.sin(np.arange(200) / 5.0)
    fast = displacements(only("stage", resonance_hz=1e5), bases)
    assert fast == pytest.approx(bases, rel=0.0, abs=1e-15)


@pytest.mark.check("takes 0.6 s")
def test_creep_goes_on_after_a_step_by_its_share_a_decade() -> None:
    found = displacements(only("creep", share_per_decade=0.02), np.full(110_000, 10e-9))
    at = [found[round(t / DT) - 1] for t in (0.1, 1.0, 10.0, 100.0)]
    assert np.diff(at) == pytest.approx(np.full(3, 0.2e-9), rel=0.1, abs=0.0)


def test_drift_is_steady() -> None:
    found = displacements(only("drift", speed_m_per_s=1e-9), np.zeros(1000))
    assert np.diff(found) == pytest.approx(np.full(999, 1e-12), rel=1e-9, abs=0.0)


@pytest.mark.parametrize("stiffness", [0.1, 40.0])
def test_thermal_noise_is_equipartition(stiffness: float) -> None:
    found = readings(only("thermal", temperature_k=300.0), 0.0, 20_000, stiffness)
    assert stiffness * np.mean(found**2) == pytest.approx(BOLTZMANN_J_PER_K * 300.0, rel=0.03, abs=0.0)
    # white: as much power in each quarter of the band
    power = np.abs(np.fft.rfft(found)[1:]) ** 2
    quarters = [part.mean() / power.mean() for part in np.array_split(power, 4)]
    assert quarters == pytest.approx([1.0] * 4, abs=0.08)


@pytest.mark.check("takes 1.2 s")
def test_flicker_falls_with_the_frequency_and_has_its_rms() -> None:
    config = only("readout", white_v=0.0, flicker_v=1e-3, converter_bits=32)
    volts = readings(config, 0.0, 100_000) * VOLTS_PER_M
    assert volts.std() == pytest.approx(1e-3, rel=0.15, abs=0.0)
    power = np.abs(np.fft.rfft(volts)[1:]) ** 2
    frequencies = np.fft.rfftfreq(len(volts), DT)[1:]
    bands = [(0.5, 1.0), (5.0, 10.0), (50.0, 100.0)]
    levels = [power[(frequencies > low) & (frequencies < high)].mean() for low, high in bands]
    slopes = np.diff(np.log10(levels))
    # a decade of frequency, a decade of power
    assert slopes == pytest.approx([-1.0, -1.0], abs=0.15)


@pytest.mark.check("takes 2.2 s")
def test_the_read_out_has_the_density_that_its_keys_say() -> None:
    """White noise of rms s has 2 s^2 / rate; the 1/f noise is the sum of its first-order parts."""
    white_v, flicker_v, rate_hz = 4.5e-5, 6.5e-5, 1.0 / DT
    config = only("readout", white_v=white_v, flicker_v=flicker_v, converter_bits=32, converter_range_v=1.0)
    volts = readings(config, 0.0, 400_000) * VOLTS_PER_M
    frequencies, density = signal.welch(volts, rate_hz, nperseg=20_000)
    corners = 0.1 * 2.0 ** np.arange(12)

    def stated(frequency_hz: np.ndarray) -> np.ndarray:
        # a sampled first-order noise is the continuous one with all that folds back on it
        kept = np.exp(-2.0 * math.pi * corners * DT)[:, np.newaxis]
        turned = np.cos(2.0 * math.pi * frequency_hz * DT)
        parts = 2.0 * DT * (1.0 - kept**2) / (1.0 - 2.0 * kept * turned + kept**2)
        return 2.0 * white_v**2 / rate_hz + flicker_v**2 / 12.0 * parts.sum(axis=0)

    for low, high in ((0.3, 1.0), (1.0, 4.0), (4.0, 20.0), (20.0, 100.0), (100.0, 450.0)):
        band = (frequencies >= low) & (frequencies < high)
        assert density[band].mean() == pytest.approx(stated(frequencies[band]).mean(), rel=0.12, abs=0.0), low


def test_a_converter_adds_the_noise_of_its_rounding() -> None:
    step_v = 2.0 / 2**16
    kinds = {
        bits: only("readout", white_v=step_v, flicker_v=0.0, converter_bits=bits, converter_range_v=1.0)
        for bits in (16, 32)
    }
    rounded, fine = (readings(kinds[bits], 1e-9, 30_000) * VOLTS_PER_M for bits in (16, 32))
    # W. R. Bennett, Bell Syst. Tech. J. 27 (1948) 446: a step of q adds q^2 / 12, where the noise covers a step
    assert np.var(rounded - fine) == pytest.approx(step_v**2 / 12.0, rel=0.03, abs=0.0)


def test_a_spring_is_read_by_the_cantilever() -> None:
    config = AfmConfig.model_validate(
        {
            "environment": "spring",
            "spring": {"stiffness_n_per_m": 20.0},
            "disturbances": {"thermal": {"enabled": True, "temperature_k": 300.0}, "seed": 4},
        }
    )
    driver = driver_of(config)
    driver.open()
    found = []
    for _ in range(20_000):
        driver.elapse(DT)
        found.append(driver.exchange(1e-9).force_n)
    # k <zeta^2> = k_B T, so that the force has the variance k k_B T
    assert np.mean(found) == pytest.approx(20e-9, rel=2e-3, abs=0.0)
    assert np.var(found) == pytest.approx(40.0 * BOLTZMANN_J_PER_K * 300.0, rel=0.03, abs=0.0)


def test_the_converter_rounds_and_ends() -> None:
    config = only("readout", white_v=0.0, flicker_v=0.0, converter_bits=8, converter_range_v=1.0)
    step = 2.0 / 256
    (value,) = set(readings(config, 33e-9, 5) * VOLTS_PER_M)
    assert value == pytest.approx(round(33e-9 * VOLTS_PER_M / step) * step, rel=1e-12)
    assert converted_v(5.0, converter_step_v(8, 1.0), 1.0) == 1.0 - step
    assert converted_v(-5.0, converter_step_v(8, 1.0), 1.0) == -1.0


def test_a_seed_decides_everything_and_a_place_is_all_there_is_to_remember() -> None:
    row = [normal_number(7, i) for i in range(3000)]
    assert np.std(row) == pytest.approx(1.0, rel=0.05)
    assert [normal_number(7, i) for i in (2999, 5, 1500)] == [row[2999], row[5], row[1500]]
    assert normal_number(8, 0) != row[0]


def test_they_are_switched_on_while_the_node_runs_and_a_restored_node_goes_on_alike(bench_of: Any) -> None:
    def made() -> tuple[Any, AfmNode]:
        bench = bench_of("afm_node@slave")
        return bench, AfmNode(bench.context, CONFIG, instrument(DisturbanceConfig()))

    def switch(bench: Any, node: AfmNode, **parameters: Any) -> str:
        fields = {"id": "a", "command": "set", "target": "afm_node", "parameters": parameters}
        return node.on_control(bench.make("session/control", "console@master", **fields))

    def steps(bench: Any, node: AfmNode, count: int) -> list[float]:
        for _ in range(count):
            bench.clock.advance_ns(1_000_000)
            node.on_deadline(bench.clock.monotonic_ns())
        return [state.deflection_m for state in bench.take("afm/state")]

    bench, node = made()
    still = steps(bench, node, 10)
    assert len(set(still)) == 1
    text = switch(bench, node, **{"disturbances.thermal.enabled": True, "disturbances.vibration.enabled": True})
    assert "disturbances.thermal.enabled = True" in text
    assert len(set(steps(bench, node, 50))) == 50
    state = pack(node)
    assert state
    other_bench, other = made()
    restore(other, state)
    other_bench.clock.advance_ns(bench.clock.monotonic_ns() - other_bench.clock.monotonic_ns())
    assert steps(other_bench, other, 50) == steps(bench, node, 50)
    switch(bench, node, **{"disturbances.thermal.enabled": False, "disturbances.vibration.enabled": False})
    assert set(steps(bench, node, 10)) == set(still)
    with pytest.raises(RefusedError, match=r"afm_node.disturbances.drift.speed: unknown key"):
        switch(bench, node, **{"disturbances.drift.speed": 1.0})
    bare = bench_of("afm_node@slave")
    spring = AfmNode(bare.context, CONFIG, SimulatedInstrument(CONFIG.to_spring_params()))
    with pytest.raises(RefusedError, match="has no cantilever that they could act on"):
        switch(bare, spring, **{"disturbances.drift.enabled": True})


VIBRATION = """
import hashlib
from telenano.afm.disturbances import noise_start, noise_step
from telenano.settings.afm_disturbances import DisturbanceConfig
config = DisturbanceConfig.model_validate({"vibration": {"enabled": True}})
state, digest = noise_start(), hashlib.sha256()
for _ in range(2000):
    state, noise = noise_step(config, state, 1.0, 1e-3)
    digest.update(noise.vibration_m.hex().encode())
print(digest.hexdigest())
"""


@pytest.mark.check("takes 0.9 s")
def test_the_vibration_has_the_same_bits_whatever_instructions_numpy_takes() -> None:
    other = {"NPY_DISABLE_CPU_FEATURES": "X86_V3 X86_V4 AVX512_ICL AVX512_SPR"}
    found = {
        subprocess.run(
            [sys.executable, "-c", VIBRATION], env={**os.environ, **more}, capture_output=True, text=True, check=True
        ).stdout
        for more in ({}, other)
    }
    assert len(found) == 1


@pytest.mark.parametrize("name", [name for name in DisturbanceConfig.model_fields if name != "seed"])
def test_any_disturbance_counts(name: str) -> None:
    assert not DisturbanceConfig().any_enabled
    assert DisturbanceConfig.model_validate({name: {"enabled": True}}).any_enabled
