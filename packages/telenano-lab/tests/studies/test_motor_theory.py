"""Poles and bandwidth of the paper's motor are those of its equation."""

import math
from typing import Any

import pytest
from telenano_lab.studies.pages.motor_theory import bandwidth_hz, closed_loop_poles

from telenano.hand import MotorParams
from telenano.sections import HapticConfig


def device(preset: Any = "paper_bandwidth", **changes: Any) -> MotorParams:
    return HapticConfig.model_validate({"device": {"preset": preset, **changes}}).device.to_params()


def test_poles_and_bandwidth_of_the_printed_gain() -> None:
    params = device("paper_gain")
    slow, fast = closed_loop_poles(params)
    assert slow.imag == fast.imag == 0.0
    assert f"{slow.real:.3f}" == "-8.281"
    assert f"{fast.real:.1f}" == "-900.8"
    assert f"{bandwidth_hz(params):.3f}" == "1.318"


def test_bandwidth_of_the_default_preset_is_the_printed_one() -> None:
    assert f"{bandwidth_hz(device()):.1f}" == "30.0"
    assert HapticConfig().device.preset == "paper_bandwidth"


@pytest.mark.parametrize("gain", [1e4, 1.917e5, 2.7e5, 3e6])
def test_poles_solve_the_characteristic_equation_and_bandwidth_halves_the_power(gain: float) -> None:
    params = device(servo_gain_v_per_m=gain)
    a2, b = params.closed_loop_coefficients()
    for pole in closed_loop_poles(params):
        assert abs(pole * pole + b * pole + a2) < 1e-12 * a2
    s = 2j * math.pi * bandwidth_hz(params)
    assert abs(a2 / (s * s + b * s + a2)) ** 2 == pytest.approx(0.5, rel=1e-12, abs=0.0)
