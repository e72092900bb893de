"""Calibration of a stage and its deflection: travel of the stage by a gauge, and the deflection on a hard sample.

On a sample that is much stiffer than the cantilever the tip stands still, and the cantilever bends by the motion of the
base: the slope of input voltage against base position is the sensitivity of the deflection. A sample of stiffness k_s
reduces it by the share k / (k + k_s). The driver of the instrument moves the base, so its identity is checked, its
watchdog and its heartbeat act, and it retracts in any case.
"""

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

from telenano.devices import InstrumentCalibration
from telenano.extend.instruments import AfmDriver, DeviceError
from telenano_devices.line_fit import CalibrationError, LineFit, fit_line, mean_of

# The tip touches when the deflection departs by more than this multiple of the noise of the free cantilever.
_DEPARTURE = 8.0
_FREE_POINTS = 8
# Share of the touching points, the last ones, that is fitted: snap-in and adhesion come first and are no line.
_USED_SHARE = 0.6
_LEAST_POINTS = 6
_MOST_INPUT = 0.9
_SETTLE_TICKS = 20


class InputSensitivity(NamedTuple):
    """Result of pressing: input per deflection [V/m] with its standard error, the free input [V], number of points."""

    v_per_m: float
    standard_error_v_per_m: float
    zero_v: float
    points: int


class Mover:
    """Moves an instrument step by step and takes means.

    Args:
        driver: The opened driver of the instrument.
        calibration: A provisional calibration, whose scales are being determined.
        wait: The function that lets a period of the loop pass, as a node does.
        samples: The number of samples for each point.
    """

    def __init__(
        self,
        driver: AfmDriver,
        calibration: InstrumentCalibration,
        wait: Callable[[], None],
        samples: int = 40,
    ) -> None:
        self._driver, self._calibration, self._wait, self._samples = driver, calibration, wait, samples

    def settle(self, output_v: float) -> None:
        """Set the output to a voltage [V], and wait until it is reached.

        Raises:
            DeviceError: The device is lost.
        """
        step_s = abs(output_v - self.output_v) / self._calibration.stage.slew_v_per_s
        for _ in range(_SETTLE_TICKS + math.ceil(step_s * 1e3)):
            self.hold(output_v)

    def hold(self, output_v: float) -> float:
        """Hold the output at a voltage [V] for a period; return the input [V]."""
        self._wait()
        sample = self._driver.exchange(self._calibration.base_m(output_v))
        report = self._driver.report
        if report is None or report.status == "lost":
            raise DeviceError(report.text if report is not None else "the instrument has no converters")
        return sample.bridge_voltage_v

    @property
    def output_v(self) -> float:
        """Return the voltage read back from the output [V]."""
        report = self._driver.report
        return report.output_v if report is not None else 0.0

    def point(self, output_v: float) -> tuple[float, float, float]:
        """Go to a voltage [V]; return the output as read back, the mean of the input, and its standard error [V]."""
        self.settle(output_v)
        readings = [self.hold(output_v) for _ in range(self._samples)]
        return self.output_v, *mean_of(readings)


def fit_travel(outputs_v: Sequence[float], gauges_m: Sequence[float], output_step_v: float) -> LineFit:
    """Return the travel of the stage per volt, by a fit to readings of a gauge [m], towards the sample > 0.

    Raises:
        CalibrationError: The points are on no line, or a higher voltage moves the stage away from the sample.
    """
    errors = [output_step_v / math.sqrt(12.0)] * len(outputs_v)
    fit = fit_line("travel of the stage", outputs_v, errors, gauges_m)
    if fit.scale <= 0.0:
        raise CalibrationError(
            f"travel of the stage: {fit.scale:.3g} m/V is away from the sample at a higher voltage; turn the "
            "amplifier round, so that 0 V is retracted, or read the gauge towards the sample"
        )
    return fit


def press(mover: Mover, calibration: InstrumentCalibration, step_v: float, press_m: float) -> InputSensitivity:
    """Press the tip onto a hard sample and return the sensitivity of the deflection; the tip is retracted afterwards.

    Args:
        mover: The mover of the instrument.
        calibration: The calibration that has the travel of the stage.
        step_v: The step between two points [V].
        press_m: The motion of the base beyond the first touch [m].

    Raises:
        CalibrationError: There is no sample within the travel, or the points are on no line.
    """
    stage = calibration.stage
    # After it was opened, a driver stays retracted until it is once commanded to be retracted.
    mover.settle(stage.retract_v)
    try:
        return _pressed(mover, calibration, step_v, press_m)
    finally:
        mover.settle(stage.retract_v)


def _pressed(mover: Mover, calibration: InstrumentCalibration, step_v: float, press_m: float) -> InputSensitivity:
    stage, limit_v = calibration.stage, _MOST_INPUT * calibration.deflection.range_v
    free: list[tuple[float, float, float]] = []
    touching: list[tuple[float, float, float]] = []
    output_v = stage.rest_v
    while not touching or (touching[-1][0] - touching[0][0]) * stage.m_per_v < press_m:
        if output_v > stage.max_v:
            raise CalibrationError(
                f"no sample was touched and pressed for {press_m:g} m up to {stage.max_v:g} V: bring it "
                "nearer, or begin nearer"
            )
        point = mover.point(output_v)
        if abs(point[1]) > limit_v:
            raise CalibrationError(
                f"the input is at {point[1]:.4f} V of {calibration.deflection.range_v:g} V: choose a greater "
                "range, or press less"
            )
        output_v += step_v
        if touching or (len(free) >= _FREE_POINTS and _departs(free, point)):
            touching.append(point)
        else:
            free.append(point)
    used = touching[-max(_LEAST_POINTS, round(_USED_SHARE * len(touching))) :]
    if len(touching) < _LEAST_POINTS:
        raise CalibrationError(
            f"{len(touching)} points touch the sample, {_LEAST_POINTS} are needed: take smaller steps, or press further"
        )
    bases = [calibration.base_m(point[0]) for point in used]
    fit = fit_line("deflection", [point[1] for point in used], [point[2] for point in used], bases)
    zero_v = math.fsum(point[1] for point in free) / len(free)
    return InputSensitivity(1.0 / fit.scale, fit.scale_error / fit.scale**2, zero_v, len(used))


def _departs(free: Sequence[tuple[float, float, float]], point: tuple[float, float, float]) -> bool:
    """Return whether a point is off the line of the free points, which may have a slope, as a stage tilts the light."""
    first, last = free[0], free[-1]
    slope = (last[1] - first[1]) / (last[0] - first[0]) if last[0] != first[0] else 0.0
    expected = last[1] + slope * (point[0] - last[0])
    noise = max(max(reading[2] for reading in free), point[2], 1e-9)
    return abs(point[1] - expected) > _DEPARTURE * noise
