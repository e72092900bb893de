"""The force of a voltage: against the exact sphere over a plane, and what it does to either cantilever."""

import math
from typing import Any

import numpy as np
import pytest

from telenano.afm.contact.electrostatic import (
    VACUUM_PERMITTIVITY_F_PER_M,
    electrostatic_force_n,
    electrostatic_strength_n_m2,
)
from telenano.afm.contact.lennard_jones import contact_distance_m, lennard_jones_force
from telenano.afm.disturbances import noise_start, noise_step
from telenano.afm.sim import simulated_afm
from telenano.devices.afm.instrument import dynamic_afm
from telenano.sections.afm_section import AfmConfig
from telenano.settings.afm_disturbances import DisturbanceConfig

R = 10e-9


def at_voltage(volts: float, **keys: Any) -> DisturbanceConfig:
    return DisturbanceConfig.model_validate({"electrostatic": {"enabled": True, "voltage_v": volts, **keys}, "seed": 6})


def instrument(volts: float, section: dict[str, Any]) -> Any:
    config = AfmConfig.model_validate(section)
    if config.model == "dynamic":
        driver: Any = dynamic_afm(config)
    else:
        driver = simulated_afm(config.to_params(), None, None, DisturbanceConfig())
    driver.configure(at_voltage(volts))
    driver.open()
    return driver


def moved(driver: Any, base_m: float, milliseconds: int = 1) -> Any:
    for _ in range(milliseconds):
        driver.elapse(1e-3)
        sample = driver.exchange(base_m)
    return sample


def sphere_force_n(distance_m: float, volts: float) -> float:
    """1/2 dC/dh V^2 by differences of the series of a sphere over a plane: C = 4 pi eps0 R sinh a sum 1 / sinh(n a)."""

    def capacitance(h: float) -> float:
        a = math.acosh(1.0 + h / R)
        rows = (1.0 / math.sinh(n * a) for n in range(1, int(40.0 / a)))
        return 4.0 * math.pi * VACUUM_PERMITTIVITY_F_PER_M * R * math.sinh(a) * sum(rows)

    step = 1e-4 * distance_m
    return 0.5 * (capacitance(distance_m + step) - capacitance(distance_m - step)) / (2.0 * step) * volts**2


@pytest.mark.parametrize("distance_m", [0.2e-9, 1e-9, 4e-9, 30e-9])
def test_it_is_the_force_of_a_sphere_over_a_plane_and_grows_no_more_in_contact(distance_m: float) -> None:
    strength = electrostatic_strength_n_m2(-2.0, R)
    found = electrostatic_force_n(strength, R, 0.1e-9, distance_m)
    # the approximation is within 6 % of the series
    assert found == pytest.approx(sphere_force_n(distance_m, 2.0), rel=0.06, abs=0.0)
    assert electrostatic_force_n(strength, R, 0.5e-9, 0.0) == electrostatic_force_n(strength, R, 0.5e-9, 0.5e-9)


def test_the_cantilever_bears_both_forces_at_the_distance_that_is_told() -> None:
    driver = instrument(5.0, {"meniscus": False})
    t = AfmConfig().tip_sample
    for gap_m in (8e-9, 4e-9, 2e-9):
        sample = moved(driver, 10e-9 - gap_m)
        h = sample.distance_m
        van_der_waals = lennard_jones_force(h, t.hamaker_j, R, t.sigma_m)[0]
        electric = electrostatic_force_n(electrostatic_strength_n_m2(5.0, R), R, contact_distance_m(t.sigma_m), h)
        assert electric < 3.0 * van_der_waals < 0.0
        assert sample.force_n == pytest.approx(van_der_waals + electric, rel=1e-4, abs=0.0)
        assert sample.force_n == pytest.approx(40.0 * (h - gap_m), rel=1e-6, abs=0.0)
        assert sample.bridge_voltage_v == pytest.approx(6.25e6 * sample.deflection_m, rel=1e-9, abs=0.0)


def test_a_soft_tip_is_pulled_in_from_further_away_and_let_go_again_when_the_voltage_goes() -> None:
    snaps = []
    for volts in (0.0, 3.0):
        driver = instrument(volts, {"meniscus": False, "cantilever": {"stiffness_n_per_m": 0.5}})
        bases = np.arange(-20e-9, 10e-9, 0.1e-9)
        snaps.append(next(base for base in bases.tolist() if moved(driver, base).in_contact))
    # 7 N/m of gradient at a distance of a tenth of a nanometre fall with the distance cubed: nm, not pm
    assert 1e-9 < snaps[0] - snaps[1] < 8e-9
    driver.configure(DisturbanceConfig())
    assert not moved(driver, -20e-9).in_contact


@pytest.mark.check("takes 3 s")
def test_the_dynamic_cantilever_rests_where_the_quasi_static_one_does() -> None:
    section: dict[str, Any] = {"meniscus": False, "cantilever": {"stiffness_n_per_m": 2.0}}
    static, dynamic = instrument(4.0, section), instrument(4.0, {**section, "model": "dynamic"})
    for base_m in (-2e-9, 2e-9, 4e-9, 5e-9, 12e-9):
        expected, found = moved(static, base_m, 3), moved(dynamic, base_m, 12)
        assert (found.in_contact, found.base_m) == (expected.in_contact, base_m)
        assert found.force_n == pytest.approx(expected.force_n, rel=2e-3, abs=1e-13)


def test_a_voltage_wanders_by_its_share_and_its_seed() -> None:
    config = at_voltage(0.5, noise_v=0.2, correlation_s=0.02)
    runs = []
    for _ in range(2):
        state, volts = noise_start(), []
        for _ in range(20_000):
            state, noise = noise_step(config, state, 1.0, 1e-3)
            volts.append(noise.voltage_v)
        runs.append(volts)
    assert runs[0] == runs[1]
    # a thousand times the time of correlation
    assert np.mean(runs[0]) == pytest.approx(0.5, rel=0.05, abs=0.0)
    assert np.std(runs[0]) == pytest.approx(0.2, rel=0.1, abs=0.0)
    lagged = np.corrcoef(runs[0][:-20], runs[0][20:])[0, 1]
    assert lagged == pytest.approx(math.exp(-1.0), rel=0.2, abs=0.0)
