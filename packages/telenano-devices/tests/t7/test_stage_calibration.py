"""Calibration of a stage: travel by a gauge, the deflection on a hard sample, and what is refused."""

import random
import socket
import subprocess
import sys
import time
from pathlib import Path
from typing import Any, NamedTuple

import pytest
import yaml
from telenano_devices.line_fit import CalibrationError
from telenano_devices.t7.stage_calibration import Mover, fit_travel, press
from telenano_devices.t7.stage_line import PARAMS, StageLine, calibration
from telenano_devices.t7.t7_model import M_PER_V, T7Model

from telenano.testing import invoke

V_PER_M = 6.25e6
ZERO_V = 0.0123
TOUCH_M = 9e-9


class HardSample(NamedTuple):
    """A tip that sticks at first, and then bends by what the base moves; the light drifts with the stage."""

    stiffness_share: float = 1.0

    def exchange(self, base_m: float) -> Any:
        pressed_m = base_m - TOUCH_M
        zeta_m = self.stiffness_share * (pressed_m - 2e-9) if pressed_m > 0.0 else 0.0
        volts = ZERO_V + V_PER_M * zeta_m + 1e-5 * base_m / 1e-8
        return type("Sample", (), {"bridge_voltage_v": volts})()


class FarSample:
    """A sample that nothing reaches."""

    def exchange(self, base_m: float) -> Any:
        return HardSample().exchange(-1e-7)


def rig(afm: Any, **changes: Any) -> tuple[StageLine, Mover, Any]:
    found = calibration(**changes)
    line = StageLine(found)
    line.model = T7Model(afm, noise_v=2e-6)
    line.driver.open()
    return line, Mover(line.driver, found, lambda: line.pass_ms(1)), found


def test_sensitivity_and_zero_are_found_within_their_standard_errors() -> None:
    line, mover, provisional = rig(HardSample(), deflection={"v_per_m": 1e6})
    found = press(mover, provisional, 0.01, 1e-8)
    drift_v_per_m = 1e-5 / 1e-8
    assert found.v_per_m == pytest.approx(V_PER_M + drift_v_per_m, abs=4 * found.standard_error_v_per_m, rel=0.0)
    assert 0.0 < found.standard_error_v_per_m < 0.01 * V_PER_M
    assert found.zero_v == pytest.approx(ZERO_V, abs=1e-4)
    assert line.model.output_v == 0.0


def test_compiled_instrument_gives_its_sensitivity_less_what_its_sample_yields() -> None:
    from telenano.afm import simulated_afm

    afm = simulated_afm(PARAMS)
    afm.open()
    _, mover, provisional = rig(afm)
    found = press(mover, provisional, 0.01, 1e-8)
    true = PARAMS.plant.volts_per_m
    # a contact of mica is hardly stiffer than the cantilever at so small a force
    assert 0.4 * true < found.v_per_m < 0.9 * true


@pytest.mark.parametrize(
    ("afm", "press_m", "text"),
    [
        (HardSample(), 2e-8, "choose a greater range, or press less"),
        (HardSample(0.0), 5e-8, "no estimate|nothing tells|no sample was touched|off the line"),
        (FarSample(), 1e-8, "no sample was touched"),
    ],
)
def test_what_gives_no_line_is_refused_and_the_tip_is_retracted(afm: Any, press_m: float, text: str) -> None:
    line, mover, provisional = rig(afm)
    with pytest.raises(CalibrationError, match=text):
        press(mover, provisional, 0.05 if press_m > 2e-8 else 0.01, press_m)
    assert line.model.output_v == 0.0


def test_travel_has_a_standard_error_and_the_right_sense() -> None:
    source = random.Random(3)
    outputs_v = [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]
    gauges_m = [M_PER_V * volts + source.gauss(0.0, 2e-10) for volts in outputs_v]
    fit = fit_travel(outputs_v, gauges_m, 1.2e-3)
    assert fit.scale == pytest.approx(M_PER_V, abs=4 * fit.scale_error, rel=0.0)
    assert 0.0 < fit.scale_error < 0.01 * M_PER_V
    with pytest.raises(CalibrationError, match="turn the amplifier round"):
        fit_travel(outputs_v, gauges_m[::-1], 1.2e-3)
    with pytest.raises(CalibrationError, match="off the line"):
        fit_travel(outputs_v, [*gauges_m[:3], gauges_m[3] + 5e-8, *gauges_m[4:]], 1.2e-3)


@pytest.mark.endurance
def test_command_asks_measures_and_writes_a_file_that_the_driver_takes(tmp_path: Path) -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    command = [sys.executable, "-m", "telenano", "device", "simulate", "t7", "--port", str(port)]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    try:
        end = time.monotonic() + 60.0
        while True:
            with socket.socket() as probe:
                if probe.connect_ex(("127.0.0.1", port)) == 0:
                    break
            assert time.monotonic() < end
            time.sleep(0.05)
        out = tmp_path / "stage.yaml"
        arguments = ["device", "calibrate", "stage", "--host", "127.0.0.1", "--port", str(port), "--out", str(out)]
        arguments += ["--output", "1", "--output", "3", "--output", "5", "--range", "0.1", "--stiffness", "40"]
        arguments += ["--stiffness-error", "1.5", "--step", "0.02"]
        readings = "\n" + "".join(f"{1e9 * M_PER_V * volts:.6g}\n" for volts in (1, 3, 5)) + "\n"
        other = invoke([*arguments, "--serial", "7"], input=readings)
        assert other.exit_code == 2
        assert "serial 470012345 is not that of the calibration, 7" in " ".join(other.output.split())
        done = invoke([*arguments, "--serial", "470012345"], input=readings)
        assert done.exit_code == 0, done.output
        document = yaml.safe_load(out.read_text())
        assert document["stage"]["m_per_v"] == pytest.approx(M_PER_V, rel=1e-3)
        assert document["deflection"]["standard_error_v_per_m"] > 0.0
        probed = invoke(["device", "probe", "--calibration", str(out), "--json"])
        assert probed.exit_code == 0, probed.output
    finally:
        process.kill()
        process.wait()
