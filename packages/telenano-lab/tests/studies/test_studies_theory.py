"""Margins, absolute stability and passivity: known numbers, bounds, and independent ways to the same figure."""

import math

import numpy as np
import numpy.typing as npt
import pytest
from telenano_lab.studies.loops.theory import (
    Arm,
    Device,
    LoopModel,
    arm_response,
    critical_delay_s,
    critical_link_delay_s,
    delay_margin,
    direct_hybrid,
    hybrid_of,
    llewellyn,
    loop_model,
    margin_of,
    sampled_loop,
    transfer_function,
    wave_hybrid,
)

from telenano.sections import LAWS, HapticConfig, VirtualImpedanceConfig

OMEGA = np.geomspace(0.1, 3000.0, 2000)
PERIOD_S = 1e-3


def characteristic_radius(loop: LoopModel, period_s: float, samples: int) -> float:
    """Return the largest modulus of the poles of the sampled loop closed through so many samples of delay.

    An independent check of T_d: it passes 1 between the numbers of samples on either side of T_d / Ts. The growth rate
    of the slowest mode is log(radius) / Ts.
    """
    sampled = sampled_loop(transfer_function(loop), period_s)
    numerator, denominator = np.squeeze(sampled.num[0][0]), np.squeeze(sampled.den[0][0])
    closed = np.concatenate([denominator, np.zeros(samples)])
    closed[-len(numerator) :] += numerator
    return float(np.abs(np.roots(closed)).max())


def scattering_norm(hybrid: npt.NDArray[np.complex128], impedance_n_s_per_m: float) -> npt.NDArray[np.float64]:
    """Return the norm of the scattering matrix at each frequency; the two-port is passive if it never exceeds 1.

    S = diag(1, -1) (H' - 1)(H' + 1)^-1 with H' normalised by an impedance b [N s/m], > 0, which does not change whether
    the norm exceeds 1 (Anderson and Spong 1989).
    """
    root = math.sqrt(impedance_n_s_per_m)
    # velocity in, force out on the first port, force in, velocity out on the second
    normal = np.diag([1.0 / root, root]) @ hybrid @ np.diag([1.0 / root, root])
    one = np.eye(2)
    scattering = np.diag([1.0, -1.0]) @ (normal - one) @ np.linalg.inv(normal + one)
    return np.asarray(np.linalg.norm(scattering, ord=2, axis=(1, 2)), dtype=np.float64)


def paper_loop(stiffness: float) -> LoopModel:
    model = loop_model("virtual_impedance", VirtualImpedanceConfig(), stiffness)
    assert model is not None
    return model


@pytest.mark.parametrize(("stiffness", "delay_ms"), [(10.0, 95.05), (20.0, 45.51), (38.0, 22.44)])
def test_delay_margin_of_the_paper(stiffness: float, delay_ms: float) -> None:
    assert 1e3 * critical_delay_s(paper_loop(stiffness)) == pytest.approx(delay_ms, rel=2e-4, abs=0.0)


@pytest.mark.parametrize("stiffness", [3.0, 10.0, 38.0, 100.0])
def test_margin_is_the_closed_form(stiffness: float) -> None:
    # |L| = 1: (M w^2)^2 + (B w)^2 = G^2; phase of 1/(-M w^2 + j B w) is -(pi - atan(B / (M w)))
    model = paper_loop(stiffness)
    m, b, g = model.mass_kg, model.damping_n_s_per_m, model.gain_n_per_m
    w = math.sqrt((-(b * b) + math.sqrt(b**4 + 4.0 * m * m * g * g)) / (2.0 * m * m))
    expected = math.atan(b / (m * w)) / w
    margin = delay_margin(transfer_function(model))
    assert margin.delay_s == pytest.approx(expected, rel=1e-6, abs=0.0)
    assert margin.crossover_rad_per_s == pytest.approx(w, rel=1e-6, abs=0.0)


@pytest.mark.parametrize("stiffness", [10.0, 20.0, 38.0])
def test_hold_costs_half_a_period(stiffness: float) -> None:
    model = paper_loop(stiffness)
    link = critical_link_delay_s(model, PERIOD_S)
    assert critical_delay_s(model) - link == pytest.approx(0.5 * PERIOD_S, rel=0.02, abs=0.0)
    # and a tenth of the period costs a tenth of that
    assert critical_delay_s(model) - critical_link_delay_s(model, 1e-4) == pytest.approx(0.5e-4, rel=0.05, abs=0.0)


@pytest.mark.parametrize("stiffness", [10.0, 20.0, 38.0])
def test_poles_leave_the_circle_at_the_margin_of_the_sampled_loop(stiffness: float) -> None:
    model = paper_loop(stiffness)
    samples = int(critical_link_delay_s(model, PERIOD_S) / PERIOD_S)
    assert characteristic_radius(model, PERIOD_S, samples) < 1.0
    assert characteristic_radius(model, PERIOD_S, samples + 1) > 1.0


def test_loop_below_unity_bears_any_delay() -> None:
    assert critical_delay_s(LoopModel(10.0, 1.0, 50.0, 1000.0)) == math.inf


def test_laws_that_are_no_such_loop_have_none() -> None:
    assert loop_model("wave", LAWS["wave"].config(), 10.0) is None
    model = loop_model("position_force", LAWS["position_force"].config(), 10.0)
    assert model is not None
    assert model.gain_n_per_m == pytest.approx(1500.0, rel=1e-12, abs=0.0)


@pytest.mark.parametrize("law", ["virtual_impedance", "position_force"])
def test_direct_laws_are_absolutely_stable_without_delay_only(law: str) -> None:
    config = {"virtual_impedance": VirtualImpedanceConfig(), "position_force": LAWS["position_force"].config()}[law]
    for delay_s, holds in ((0.0, True), (1e-6, False), (0.04, False)):
        hybrid = hybrid_of(law, config, delay_s, OMEGA)
        assert hybrid is not None
        assert bool(llewellyn(hybrid).min() >= -1e-12) is holds


@pytest.mark.parametrize("filter_s", [0.0, 0.005])
@pytest.mark.parametrize("delays", [(0.0, 0.0), (0.02, 0.02), (0.01, 0.24)])
def test_waves_are_passive_at_every_constant_delay(delays: tuple[float, float], filter_s: float) -> None:
    hybrid = wave_hybrid(100.0, *delays, filter_s, OMEGA)
    assert llewellyn(hybrid).min() >= -1e-9
    for impedance in (10.0, 100.0, 1000.0):
        assert scattering_norm(hybrid, impedance).max() <= 1.0 + 1e-9
    law = hybrid_of("wave", LAWS["wave"].config(), sum(delays), OMEGA)
    assert law is not None
    assert scattering_norm(law, 100.0).max() <= 1.0 + 1e-9


def test_wave_bound_holds_at_a_gain_of_one_and_fails_just_past_it() -> None:
    # a gain g on both waves: a lossless line stays at the bound for g = 1
    for gain, passive in ((1.0, True), (1.0 + 1e-6, False), (0.9, True)):
        s = 1j * OMEGA
        a = gain * np.exp(-s * 0.03)
        line = (1.0 - a * a) / (1.0 + a * a)
        hybrid = np.moveaxis(np.array([[100.0 * line, 2.0 * a / (1.0 + a * a)],
                                       [-2.0 * a / (1.0 + a * a), line / 100.0]]), -1, 0)  # fmt: skip
        assert bool(scattering_norm(hybrid, 100.0).max() <= 1.0 + 1e-9) is passive


def test_scattering_of_the_wave_line_is_the_pure_delay() -> None:
    hybrid = wave_hybrid(100.0, 0.02, 0.03, 0.0, OMEGA)
    np.testing.assert_allclose(scattering_norm(hybrid, 100.0), 1.0, rtol=1e-9, atol=0.0)


def test_passive_is_absolutely_stable_but_not_the_other_way_round() -> None:
    # a gain on the force and its inverse on the velocity keeps h12 h21, which is all that Llewellyn sees
    impedance = np.full(3, 50.0 + 0.0j)
    omega = np.array([1.0, 2.0, 3.0])
    hybrid = direct_hybrid(impedance, None, 0.0, 0.0, omega)
    hybrid[:, 0, 1] *= 3.0
    hybrid[:, 1, 0] /= 3.0
    assert llewellyn(hybrid).min() >= -1e-12
    assert scattering_norm(hybrid, 50.0).max() > 1.0


def test_law_without_the_hands_say_has_no_hybrid_form() -> None:
    with pytest.raises(ValueError, match="K_f = 0"):
        hybrid_of("virtual_impedance", VirtualImpedanceConfig(force_gain=0.0), 0.0, OMEGA)


@pytest.mark.parametrize(("stiffness", "delay_ms"), [(5.0, 194.1236), (10.0, 94.5512), (38.0, 21.9442)])
def test_margin_of_the_sampled_loop_is_found_however_slow_its_crossover_is(stiffness: float, delay_ms: float) -> None:
    # independent roots of |L(e^(j w Ts))| = 1 on (0, pi/Ts)
    assert 1e3 * critical_link_delay_s(paper_loop(stiffness), PERIOD_S) == pytest.approx(delay_ms, rel=5e-6, abs=0.0)


@pytest.mark.parametrize("law", ["virtual_impedance", "position_force"])
def test_no_margin_of_an_integrating_loop_is_infinite(law: str) -> None:
    config = {"virtual_impedance": VirtualImpedanceConfig(), "position_force": LAWS["position_force"].config()}[law]
    for stiffness in (0.5, 1.0, 2.0, 3.0, 6.0, 200.0):
        model = loop_model(law, config, stiffness)
        assert model is not None
        continuous, sampled = critical_delay_s(model), critical_link_delay_s(model, PERIOD_S)
        assert continuous - sampled == pytest.approx(0.5 * PERIOD_S, rel=0.1, abs=0.0)


# K [N/m], arm, delay [ms] that the paper's law bears with it and the 30 Hz device in the loop
ARMS = {
    "constant force": (0.0, 0.0, 0.0),
    "soft": (50.0, 5.0, 0.15),
    "ordinary": (300.0, 5.0, 0.15),
    "stiff": (1000.0, 20.0, 0.15),
}


@pytest.mark.parametrize(
    ("stiffness", "arm", "delay_ms"),
    [
        (10.0, "constant force", 95.05),
        (5.0, "ordinary", 267.0),
        (10.0, "ordinary", 110.0),
        (38.0, "ordinary", 23.9),
        (10.0, "stiff", 197.1),
        (5.0, "stiff", math.inf),
    ],
)
def test_an_arm_bears_more_delay_than_a_hand_of_constant_force(stiffness: float, arm: str, delay_ms: float) -> None:
    config = VirtualImpedanceConfig()
    device = Device(*HapticConfig().device.to_params().closed_loop_coefficients())
    response = arm_response(paper_loop(stiffness), config.force_gain, Arm(*ARMS[arm]), device)
    assert 1e3 * margin_of(response).delay_s == pytest.approx(delay_ms, rel=5e-3, abs=0.0)


@pytest.mark.parametrize("stiffness_n_per_m", [10.0, 20.0, 38.0])
def test_direct_reflection_bears_nearly_the_delay_of_the_papers_law(stiffness_n_per_m: float) -> None:
    configs = {"virtual_impedance": VirtualImpedanceConfig(), "position_force": LAWS["position_force"].config()}
    loops = [loop_model(law, config, stiffness_n_per_m) for law, config in configs.items()]
    papers, direct = (critical_delay_s(loop) for loop in loops if loop is not None)
    assert direct == pytest.approx(papers, rel=0.06, abs=0.0)
