"""Lines through gauges and masses, and the raw samples that they are made of."""

import shutil

import pytest
from telenano_devices.handle.emulated_handle import FORCE_ZERO, M_PER_COUNT, N_PER_COUNT, POSITION_ZERO
from telenano_devices.handle.handle_calibration import sample_raw
from telenano_devices.handle.handle_line import HandleLine
from telenano_devices.line_fit import CalibrationError, fit_line

from telenano.extend.hands import DeviceError

needs_compiler = pytest.mark.skipif(shutil.which("cc") is None, reason="needs a C compiler: apt install gcc libc6-dev")


def test_line_gives_scale_zero_and_standard_error() -> None:
    counts = [POSITION_ZERO + x / M_PER_COUNT for x in (0.0, 5e-3, 10e-3)]
    fit = fit_line("position", counts, [2.0, 2.0, 2.0], [0.0, 5e-3, 10e-3])
    assert fit.scale == pytest.approx(M_PER_COUNT, rel=1e-12, abs=0.0)
    assert fit.zero == pytest.approx(POSITION_ZERO, rel=1e-9, abs=0.0)
    # two counts of noise over 7.07 mm of spread
    assert fit.scale_error == pytest.approx(2.0 / (2.0**0.5 * 5e-3) * M_PER_COUNT**2, rel=1e-9, abs=0.0)
    turned = fit_line("force", [FORCE_ZERO, FORCE_ZERO - 2.0 / N_PER_COUNT], [1.0, 1.0], [0.0, 2.0])
    assert turned.scale == pytest.approx(-N_PER_COUNT, rel=1e-12, abs=0.0)


@pytest.mark.parametrize(
    ("counts", "values", "text"),
    [
        ([1.0, 2.0], [0.1, 0.1], "two different values"),
        ([100.0, 101.0], [0.0, 0.1], "no estimate|nothing tells"),
        ([0.0, 600.0, 1000.0], [0.0, 0.5, 1.0], "the point at 0.5 is 6.7% of the span off the line"),
    ],
)
def test_points_that_make_no_line_are_refused(counts: list[float], values: list[float], text: str) -> None:
    with pytest.raises(CalibrationError, match=text):
        fit_line("force", counts, [1.0] * len(counts), values)


@needs_compiler
def test_raw_samples_come_without_a_command_and_are_averaged() -> None:
    line = HandleLine()
    point, hello = sample_raw(line.driver, 0.5), line.driver.hello
    assert hello.model == "telenano posix"
    assert (point.position, point.force) == (POSITION_ZERO, FORCE_ZERO)
    assert (point.position_error, line.handle.core.mode) == (0.0, 0)
    with pytest.raises(DeviceError, match="sent 4 samples, 20 are needed"):
        sample_raw(line.driver, 0.04)
