"""The dynamic cantilever against what is known of an oscillator: resonance, Q, energy, noise, and its static limit."""

import math

import numpy as np
import pytest
from instrument_theory import drive_work_j

from telenano.afm.cantilever import equilibrium, initial_state
from telenano.afm.contact.force_grid import build_force_grid, grid_force
from telenano.afm.contact.tip_sample import branch_force
from telenano.afm.dynamic import NO_NOISE, DynamicState, advance, free_amplitude_m, steady_state
from telenano.afm.dynamic_plant import BOLTZMANN_J_PER_K, KICKS_PER_PERIOD, NORMALS_PER_PERIOD, Damping, build_dynamic
from telenano.numerics.compiler import compiled, compiled_form
from telenano.sections.afm_section import AfmConfig

CONFIG = AfmConfig()
PLANT = CONFIG.to_params().plant
REST_M = CONFIG.rest_distance_m
FAR_M = -1e-6


def amplitude_and_phase(reading):
    return math.hypot(reading.in_phase_m, reading.quadrature_m), math.atan2(reading.quadrature_m, reading.in_phase_m)


def tapping(dynamic, gap_m, amplitude_m, periods=1500):
    """State and reading of 32 periods of steady tapping, with the amplitude of the base."""
    drive_m = amplitude_m / free_amplitude_m(dynamic, 1.0)
    n, base = dynamic.drive.shape[0], REST_M - gap_m
    state, _ = advance(dynamic, steady_state(dynamic, base, drive_m), base, 0.0, drive_m, periods * n, NO_NOISE)
    state, reading = advance(dynamic, state, base, 0.0, drive_m, 32 * n, NO_NOISE)
    return state, reading, drive_m


@pytest.mark.check("takes 2.1 s")
@pytest.mark.drawn(0.5, "telenano/afm/")
@pytest.mark.parametrize("detuning", [0.98, 1.0, 1.003])
def test_free_amplitude_and_phase_are_those_of_the_resonance_curve(detuning):
    dynamic = CONFIG.to_dynamic(drive_hz=detuning * 150e3)
    drive_m = 1e-10
    state = DynamicState(0.0, 0.0, FAR_M, 0.0, 0.0, False, False, 0)
    state, _ = advance(dynamic, state, FAR_M, 0.0, drive_m, 1200 * 96, NO_NOISE)
    _, reading = advance(dynamic, state, FAR_M, 0.0, drive_m, 50 * 96, NO_NOISE)
    # zeta'' + (w0/Q) zeta' + w0^2 zeta = x_d'' at w = r w0
    expected = -(detuning**2) / complex(1.0 - detuning**2, detuning / 100.0) * drive_m
    amplitude, phase = amplitude_and_phase(reading)
    assert amplitude == pytest.approx(abs(expected), rel=1e-4, abs=0)
    assert phase == pytest.approx(-math.atan2(expected.imag, expected.real), rel=0, abs=1e-3)


@pytest.mark.check("takes 4 s")
def test_ring_down_gives_q():
    dynamic = CONFIG.to_dynamic()
    state = DynamicState(10e-9, 0.0, FAR_M, 0.0, 0.0, False, False, 0)
    first = advance(dynamic, state, FAR_M, 0.0, 0.0, 96, NO_NOISE)
    later, _ = advance(dynamic, first[0], FAR_M, 0.0, 0.0, 96 * 99, NO_NOISE)
    last = advance(dynamic, later, FAR_M, 0.0, 0.0, 96, NO_NOISE)[1]
    ratio = amplitude_and_phase(last)[0] / amplitude_and_phase(first[1])[0]
    # a hundred periods lie between the two: e^(-pi n / Q)
    assert -math.pi * 100 / math.log(ratio) == pytest.approx(100.0, rel=1e-3, abs=0)


def test_the_grid_has_the_force_of_the_model():
    grid, passages = build_force_grid(PLANT.tip, 25e-9)
    # the corner of the meniscus at a0 lies inside a cell
    assert grid.error_n < 5e-12
    for b, low, high in (
        (0, 2.4e-9, 40e-9),
        (1, passages.onset_m, 4e-9),
        (2, -2e-9, passages.end_m),
        (3, -2e-9, 0.2e-9),
    ):
        for h in np.linspace(low, high, 97).tolist():
            expected = branch_force(PLANT.tip, h, b >= 2, b % 2 == 1)[0]
            found = grid_force(grid.cubics, grid.start_m, grid.cells_per_m, grid.attraction_n_m2, h, b)
            assert found == pytest.approx(expected, rel=1e-3, abs=1e-13)


@pytest.mark.parametrize("gap_m", [14e-9, 17e-9])
def test_the_energy_of_a_cycle_balances(gap_m):
    dynamic = CONFIG.to_dynamic(steps_per_period=192)
    _, reading, drive_m = tapping(dynamic, gap_m, 20e-9)
    assert reading.contact_share > 0.1
    given = drive_work_j(dynamic, drive_m, reading.in_phase_m, reading.quadrature_m)
    # what the medium takes from the motion at the drive's frequency, and the sample from the tip
    amplitude = amplitude_and_phase(reading)[0]
    medium = math.pi * dynamic.damping_kg_per_s * 2.0 * math.pi * 150e3 * amplitude**2
    assert given - medium == pytest.approx(reading.dissipated_j / 32.0, rel=0.1, abs=0)
    # the meniscus forms at 2 r1 and breaks at delta_b: its pull over that way is lost in each cycle
    width, breaks, a0 = 2.4e-9, 4e-9, PLANT.tip.contact_distance_m
    lost = PLANT.tip.capillary_force_n * width * math.log((1.0 + (breaks - a0) / width) / (1.0 + (width - a0) / width))
    assert reading.dissipated_j / 32.0 == pytest.approx(lost, rel=0.02, abs=0)


@pytest.mark.parametrize("gap_m", [14e-9, 17e-9])
def test_fewer_steps_away_from_the_sample_change_nothing(gap_m):
    found = [amplitude_and_phase(tapping(CONFIG.to_dynamic(steps_per_period=n), gap_m, 20e-9)[1]) for n in (96, 384)]
    assert found[0] == pytest.approx(found[1], rel=1e-4, abs=0)


def config_of(radius_m, stiffness, resonance_hz, quality, *, meniscus=False, viscosity_pa_s=0.0):
    return AfmConfig.model_validate(
        {
            "meniscus": meniscus,
            "cantilever": {"stiffness_n_per_m": stiffness, "resonance_hz": resonance_hz, "quality": quality},
            "tip_sample": {"tip_radius_m": radius_m, "sample_viscosity_pa_s": viscosity_pa_s},
        }
    )


@pytest.mark.check("takes 2.0 s")
@pytest.mark.drawn(0.3, "telenano/afm/")
@pytest.mark.parametrize(
    ("config", "amplitude_m"),
    [
        (config_of(7e-9, 2.7, 71e3, 60.0), 14e-9),
        (config_of(18e-9, 23.0, 281e3, 220.0), 9e-9),
        (config_of(12e-9, 5.0, 60e3, 40.0, viscosity_pa_s=20.0), 20e-9),
        (config_of(9e-9, 30.0, 170e3, 120.0, meniscus=True, viscosity_pa_s=20.0), 12e-9),
        (config_of(10e-9, 40.0, 150e3, 100.0), 20e-9),
        (config_of(10e-9, 40.0, 150e3, 100.0, meniscus=True), 20e-9),
        (config_of(10e-9, 1.0, 150e3, 100.0), 20e-9),
    ],
)
def test_tapping_is_converged_in_amplitude_phase_and_energy(config, amplitude_m):
    # a period of as many even steps as the shortest there are is what the divided steps converge to
    models = [config.to_dynamic(steps_per_period=n) for n in (96, 4096)]
    drive_m = amplitude_m / free_amplitude_m(models[0], 1.0)
    for share in (0.42, 0.61, 0.77, 0.92):
        base_m, found = config.rest_distance_m - share * amplitude_m, []
        for model in models:
            n, periods = model.drive.shape[0], round(10.0 * config.cantilever.quality)
            state, _ = advance(model, steady_state(model, base_m, drive_m), base_m, 0.0, drive_m, periods * n, NO_NOISE)
            _, reading = advance(model, state, base_m, 0.0, drive_m, 32 * n, NO_NOISE)
            found.append((*amplitude_and_phase(reading), reading.dissipated_j / 32.0))
        (amplitude, phase, energy_j), (exact_amplitude, exact_phase, exact_j) = found
        assert abs(amplitude - exact_amplitude) < 1e-3 * amplitude_m
        assert abs(math.degrees(phase - exact_phase)) < 0.1
        assert abs(energy_j - exact_j) < 0.1 * 1.602176634e-19


def test_liquid_and_sample_take_energy_inside_only():
    damping = Damping(0.1, 0.8e-9, 10.0, 1e-9)
    dry = build_dynamic(PLANT, 150e3, 100.0, 150e3, damping._replace(liquid_viscosity_pa_s=0, sample_viscosity_pa_s=0))
    wet = build_dynamic(PLANT, 150e3, 100.0, 150e3, damping)
    assert tapping(wet, 17e-9, 20e-9)[1].dissipated_j > 1.1 * tapping(dry, 17e-9, 20e-9)[1].dissipated_j
    assert tapping(wet, 30e-9, 20e-9)[1] == tapping(dry, 30e-9, 20e-9)[1]


def test_thermal_noise_has_the_energy_of_its_temperature():
    dynamic = build_dynamic(PLANT, 150e3, 30.0, 150e3, Damping(0, 1e-9, 0, 1e-9), 16, 300.0)
    random = np.random.Generator(np.random.PCG64(1))
    state, squares = DynamicState(0.0, 0.0, FAR_M, 0.0, 0.0, False, False, 0), []
    for _ in range(6000):
        state, _ = advance(dynamic, state, FAR_M, 0.0, 0.0, 16 * 5, random.standard_normal(5 * NORMALS_PER_PERIOD))
        squares.append((state.deflection_m**2, state.velocity_m_per_s**2))
    potential, kinetic = np.mean(squares[100:], axis=0) * (dynamic.stiffness_n_per_m, dynamic.mass_kg)
    # 6000 samples, each five periods after the last: one relaxation of the energy at Q = 30
    assert potential == pytest.approx(BOLTZMANN_J_PER_K * 300.0, rel=0.1, abs=0)
    assert kinetic == pytest.approx(BOLTZMANN_J_PER_K * 300.0, rel=0.1, abs=0)


@compiled
def thermal_motion(dynamic, state, normals, out):
    """Fill `out` with the deflection [m] after each impulse of the noise, two normals each."""
    for i in range(out.shape[0]):
        steps = dynamic.drive.shape[0] // KICKS_PER_PERIOD
        state, _ = advance(dynamic, state, state.base_m, 0.0, 0.0, steps, normals[2 * i : 2 * i + 2])
        out[i] = state.deflection_m


@pytest.mark.check("takes 1.1 s")
@pytest.mark.parametrize(("quality", "steps"), [(2.0, 16), (30.0, 96)])
def test_thermal_noise_has_the_density_of_a_damped_spring_from_zero_to_three_times_the_resonance(quality, steps):
    dynamic = build_dynamic(PLANT, 150e3, quality, 150e3, Damping(0, 1e-9, 0, 1e-9), steps, 300.0)
    random, length, pieces = np.random.Generator(np.random.PCG64(2)), 1 << 12, 200
    state, zeta = DynamicState(0.0, 0.0, FAR_M, 0.0, 0.0, False, False, 0), np.empty(length * (pieces + 1))
    compiled_form(thermal_motion)(dynamic, state, random.standard_normal(2 * len(zeta)), zeta)
    window, parts = np.hanning(length), zeta[length:].reshape(pieces, length)
    spectra = np.fft.rfft((parts - parts.mean(axis=1, keepdims=True)) * window, axis=1)
    found = np.mean(np.abs(spectra) ** 2, axis=0)
    rate_hz = 8 * 150e3
    density = 2.0 * found / (rate_hz * float((window**2).sum()))
    frequencies = np.fft.rfftfreq(length, 1.0 / rate_hz)
    # of the samples of a motion that goes on beyond half their rate: the density folds back (Callen and Welton 1951)
    b, mass, expected = math.pi * 150e3 / quality, dynamic.mass_kg, np.zeros_like(frequencies)
    for fold in range(-40, 41):
        w = 2.0 * math.pi * (frequencies + fold * rate_hz)
        response = 1.0 / ((2.0 * math.pi * 150e3) ** 2 - w**2 + 2j * b * w) / mass
        expected += np.abs(response) ** 2 * 8.0 * b * mass * BOLTZMANN_J_PER_K * 300.0
    for low, high in ((0.02, 0.1), (0.1, 0.3), (0.3, 0.8), (0.9, 1.1), (1.2, 1.5), (1.5, 2.0), (2.0, 3.0), (3.0, 4.0)):
        band = (frequencies > low * 150e3) & (frequencies < high * 150e3)
        # each line is a mean of 200 pieces, and a band has forty lines or more: 1 to 2 %
        ratio = float(np.mean(density[band] / expected[band]))
        assert ratio == pytest.approx(1.0, rel=0.05, abs=0.0), (low, high)


def test_moved_slowly_it_is_the_static_curve():
    # damped, so that what rings after a jump of the force has died away
    dynamic = AfmConfig.model_validate({"cantilever": {"quality": 5.0}}).to_dynamic()
    state = steady_state(dynamic, REST_M - 6e-9, 0.0)
    static = initial_state(PLANT, REST_M - 6e-9)
    for base in np.linspace(REST_M - 6e-9, REST_M + 1e-9, 29).tolist():
        state, _ = advance(dynamic, state, base, 0.0, 0.0, 96 * 40, NO_NOISE)
        state, reading = advance(dynamic, state, base, 0.0, 0.0, 96 * 40, NO_NOISE)
        static = equilibrium(PLANT, static, base)
        force = 40.0 * (static.distance_m + base - REST_M)
        assert 40.0 * reading.mean_deflection_m == pytest.approx(force, rel=0.02, abs=0.05e-9)
        assert (state.contact, state.meniscus) == (static.contact, static.meniscus)


@pytest.mark.parametrize(
    ("arguments", "what"),
    [
        ((150e3, 0.5, 150e3), "quality factor Q = 0.5"),
        ((0.0, 100.0, 150e3), "resonance f = 0.0 Hz must be finite and > 0 Hz"),
        ((150e3, 100.0, math.nan), "drive frequency = nan Hz"),
        ((150e3, 100.0, 150e3, Damping(-1.0, 1e-9, 0, 1e-9)), "viscosities must be >= 0"),
        ((150e3, 100.0, 150e3, Damping(0, 0.0, 0, 1e-9)), "thicknesses"),
        ((150e3, 100.0, 150e3, Damping(0, 1e-9, 0, 1e-9), 60), "steps per period = 60"),
    ],
)
def test_what_cannot_be_is_named(arguments, what):
    given = arguments if len(arguments) > 3 else (*arguments, Damping(0, 1e-9, 0, 1e-9))
    with pytest.raises(ValueError, match=what):
        build_dynamic(PLANT, *given)
    with pytest.raises(ValueError, match="as_printed has no dynamic model"):
        AfmConfig(mode="as_printed").to_dynamic()


def test_compiled_code_looks_nothing_up_beyond_its_tables():
    dynamic = CONFIG.to_dynamic()
    n = dynamic.drive.shape[0]

    def after(z_m, v_m_per_s, base_m, phase_step=0):
        state = DynamicState(z_m, v_m_per_s, base_m, 0.0, 0.0, False, True, phase_step)
        return advance(dynamic, state, base_m, 0.0, 1e-9, n, NO_NOISE)[0]

    # far away, close, and deeper than the grid goes: what is no number has no place in it, and stays none
    for base_m in (FAR_M, REST_M, 1e-3, math.nan, math.inf):
        for z_m, v_m_per_s in ((0.0, 0.0), (math.nan, 0.0), (-1e3, 0.0), (0.0, math.inf)):
            found = after(z_m, v_m_per_s, base_m)
            assert math.isfinite(found.deflection_m) == math.isfinite(base_m + z_m + v_m_per_s)
    # a step of the period that was counted with more steps a period
    assert after(0.0, 0.0, FAR_M, 3 + 7 * n) == after(0.0, 0.0, FAR_M, 3)
    with pytest.raises(ValueError, match="two normal numbers for each eighth of a period"):
        advance(dynamic, found, FAR_M, 0.0, 1e-9, 2 * n, np.zeros(2 * NORMALS_PER_PERIOD - 1))
