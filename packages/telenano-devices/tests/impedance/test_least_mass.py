"""The moving mass that a virtual coupling needs, against the eigenvalues of a sample time, and what it refuses."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from coupling_theory import radius
from telenano_devices.impedance.coupling import least_mass_kg, stable_stiffness_n_per_m
from telenano_devices.impedance.impedance_config import MODELS, CouplingConfig, SimulatedImpedanceConfig

from telenano.extend.hands import DeviceError
from telenano.sections import HapticConfig
from telenano.testing import invoke

DRAWN = 3000
# sound of the eigenvalues of a matrix of some thirty rows
ROUNDING = 1e-10


def omega(**given: Any) -> Any:
    return SimulatedImpedanceConfig(model="omega", **given).capabilities()


def test_no_drawn_coupling_with_the_least_mass_grows() -> None:
    rng = np.random.default_rng(20)
    for _ in range(DRAWN):
        period_s, delay = 10.0 ** rng.uniform(-4.0, -2.0), float(rng.choice([0, 0.5, 1, 3.7, 10, rng.uniform(0, 30)]))
        b, filter_hz = 10.0 ** rng.uniform(-2.0, 2.0), float(rng.choice([0, 5, 20, 50, 200, 500]))
        damping = b * float(rng.choice([0.0, 10.0 ** rng.uniform(-3.0, 1.5)]))
        share = float(rng.choice([0.01, 0.25, 0.5, 0.9, 0.999]))
        k = share * stable_stiffness_n_per_m(damping, b, period_s, delay * period_s)
        least_kg = least_mass_kg(k, damping, b, period_s, delay * period_s, filter_hz)
        found = radius((1.0001 * least_kg, damping), period_s, k, b, delay, filter_hz)
        assert found < 1.0 + ROUNDING, (period_s, delay, damping, b, k, filter_hz)


@pytest.mark.parametrize("filter_hz", [0.0, 200.0])
@pytest.mark.parametrize("delay", [0.0, 1.0, 5.0, 20.0])
@pytest.mark.parametrize("share", [0.0001, 0.25, 0.5, 0.9])
def test_least_mass_is_at_most_three_times_what_the_eigenvalues_need(
    share: float, delay: float, filter_hz: float
) -> None:
    k = share * stable_stiffness_n_per_m(0.0, 1.0, 1e-3, delay * 1e-3)
    least_kg = least_mass_kg(k, 0.0, 1.0, 1e-3, delay * 1e-3, filter_hz)
    low, high = (0.6, 0.8) if delay >= 5.0 else (1.0 / 3.0, 1.0)
    assert radius((low * least_kg, 0.0), 1e-3, k, 1.0, delay, filter_hz) > 1.0 + ROUNDING
    assert radius((high * least_kg, 0.0), 1e-3, k, 1.0, delay, filter_hz) < 1.0 + ROUNDING


def test_no_mass_is_enough_at_the_stable_bound_and_that_of_the_damper_alone_is_its_delay() -> None:
    bound = stable_stiffness_n_per_m(0.5, 3.0, 1e-3, 2e-3)
    assert least_mass_kg(bound, 0.5, 3.0, 1e-3, 2e-3, 0.0) == math.inf
    assert least_mass_kg(0.0, 0.5, 3.0, 1e-3, 2e-3, 0.0) == pytest.approx(3.0 * 3e-3, rel=1e-12, abs=0.0)


def test_a_late_damper_makes_the_omega_swing_with_hardly_any_spring() -> None:
    late, device = 30e-3, (0.25, 0.5)
    assert radius(device, 1.0 / 4000.0, 1.0, 15.0, late * 4000.0, 200.0) > 1.0 + ROUNDING
    with pytest.raises(DeviceError, match=r"B = 15 N s/m that acts 30.9 ms late .* above 0.464 kg, .* 0.25 kg.* 8.0"):
        CouplingConfig().to_settings(omega(delay_s=late))


@pytest.mark.parametrize("model", MODELS)
def test_what_is_refused_begins_at_the_damping_that_is_named(model: Any) -> None:
    device = SimulatedImpedanceConfig(model=model, delay_s=0.01).capabilities()
    most = device.mass_kg / least_mass_kg(0.0, 0.0, 1.0, 1.0 / device.rate_hz, 0.01, 200.0)
    CouplingConfig(damping_n_s_per_m=0.999 * most).to_settings(device)
    for name in ("damping_n_s_per_m", "lateral_damping_n_s_per_m"):
        with pytest.raises(DeviceError, match="needs a moving mass"):
            CouplingConfig.model_validate({name: 1.001 * most}).to_settings(device)


def test_stable_is_said_where_the_device_has_the_mass_and_unproven_where_it_declares_none() -> None:
    device = omega()
    bounds = CouplingConfig().bounds(device)
    assert bounds.verdict == "stable" and bounds.least_mass_kg < device.mass_kg
    just = CouplingConfig().bounds(device._replace(mass_kg=0.999 * bounds.least_mass_kg))
    unknown = CouplingConfig().bounds(device._replace(mass_kg=0.0))
    assert just.verdict == unknown.verdict == "unproven"
    assert f"{bounds.least_mass_kg:.3g} kg" in unknown.sentence() and "declares none" in unknown.sentence()


def test_up_refuses_a_simulated_device_whose_damper_acts_too_late(tmp_path: Path) -> None:
    given = {"driver": "simulated_impedance", "impedance": {"model": "omega", "delay_s": 0.03}}
    with pytest.raises(ValueError, match=r"needs a moving mass above 0\.464 kg"):
        HapticConfig.model_validate(given)
    options = ["driver=simulated_impedance", "impedance.model=omega", "impedance.delay_s=0.03"]
    chosen = [word for option in options for word in ("--set", f"haptic_node.{option}")]
    done = invoke(["up", "--scenario", "fig12", "--headless", "--out", str(tmp_path / "up"), *chosen])
    assert done.exit_code == 2 and "above 0.464 kg" in " ".join(done.output.split()), done.output


@pytest.mark.parametrize(("model", "found_n"), [("touch", 0.33), ("omega", 1.0)])
def test_weak_device_has_to_answer_a_smaller_change_of_its_force(model: str, found_n: float) -> None:
    settings = CouplingConfig().to_settings(SimulatedImpedanceConfig.model_validate({"model": model}).capabilities())
    assert settings.frozen_force_n == pytest.approx(found_n, rel=1e-3, abs=0.0)
