"""Images in simulated time: a raster over a sample, line by line there and back."""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from proto.errors import ConfigError
from services.afm_node.cantilever import Plant, initial_state
from services.afm_node.config import AfmConfig
from services.afm_node.dynamic import KICKS_PER_PERIOD, NO_NOISE, free_amplitude_m, steady_state
from services.afm_node.friction import FrictionState
from services.afm_node.imaging import CHANNELS, HEIGHT, Feedback, Line, contact_line, tapping_line
from services.afm_node.surface import Surface, dilated, height_at
from services.afm_node.tip_sample import branch_force

Array = npt.NDArray[np.float64]

# way of the feedback in contact [s]: 20 kHz, as instruments have it
CONTACT_PERIOD_S = 50e-6
# the tip begins this far above the first point [m], and has this long to arrive and settle before the first line [s]
_ABOVE_M = 5e-9
_SETTLE_S = 0.03


@dataclass(frozen=True)
class ScanRequest:
    """What to image and how; lengths [m], times [s], forces [N]."""

    mode: Literal["tapping", "contact"] = "tapping"
    pixels: int = 128
    lines: int = 128
    dwell_s: float = 1e-3
    amplitude_m: float = 20e-9
    setpoint_share: float = 0.8
    setpoint_n: float = 5e-9
    integral_per_s: float = 5000.0
    proportional: float = 1.0
    temperature_k: float = 0.0
    seed: int = 0

    def check(self) -> None:
        """Raise ConfigError naming what cannot be."""
        if not (2 <= self.pixels <= 4096 and 1 <= self.lines <= 4096):
            raise ConfigError(f"an image of {self.pixels} x {self.lines} is outside 2 x 1 to 4096 x 4096 pixels")
        if self.mode == "tapping" and not 0.05 <= self.setpoint_share < 1.0:
            raise ConfigError(
                f"the set-point is {self.setpoint_share:g} of the free amplitude; it must lie between 0.05 and 1,"
                " or the tip never reaches the sample"
            )
        positive = {"dwell [s]": self.dwell_s, "amplitude [m]": self.amplitude_m, "gain [1/s]": self.integral_per_s}
        for name, value in positive.items():
            if not (math.isfinite(value) and value > 0.0):
                raise ConfigError(f"{name} = {value:g} must be positive and finite")
        for name, value in (("proportional gain", self.proportional), ("temperature [K]", self.temperature_k)):
            if not (math.isfinite(value) and value >= 0.0):
                raise ConfigError(f"{name} = {value:g} must be 0 or more, and finite")


@dataclass(frozen=True)
class ScanResult:
    """An image: trace and retrace of shape (lines, pixels, CHANNELS), and what the tip sees at the same points [m]."""

    trace: Array
    retrace: Array
    truth_m: Array
    width_m: float
    depth_m: float
    simulated_s: float

    @property
    def height_m(self) -> Array:
        """Return the height of the trace [m], its mean that of the truth: an AFM knows no absolute height."""
        height = self.trace[:, :, HEIGHT]
        return np.asarray(height - height.mean() + self.truth_m[: len(height)].mean())

    @property
    def rms_error_m(self) -> float:
        return float(np.sqrt(np.mean((self.height_m - self.truth_m[: len(self.trace)]) ** 2)))

    @property
    def correlation(self) -> float:
        """Return the correlation with the truth; 0 where one of them is level."""
        a, b = self.height_m.ravel(), self.truth_m[: len(self.trace)].ravel()
        a, b = a - a.mean(), b - b.mean()
        norm = math.sqrt(float(np.sum(a * a)) * float(np.sum(b * b)))
        return float(np.sum(a * b)) / norm if norm > 0.0 else 0.0


def scan(
    surface: Surface, request: ScanRequest, config: AfmConfig, progress: Callable[[int, int], bool] = lambda n, of: True
) -> ScanResult:
    """Image the whole of a surface.

    Parameters: progress, called with the finished lines and their number; it ends the image by returning False, which
    leaves the lines so far, as Ctrl-C does. Raises: ConfigError, if the request or the surface cannot be imaged.
    """
    request.check()
    try:
        seen = dilated(surface, config.tip_sample.tip_radius_m)
    except ValueError as error:
        raise ConfigError(str(error)) from error
    first = height_at(*seen, 0.0, 0.5 * surface.depth_m / request.lines)[0]
    rest, amplitude = config.rest_distance_m, request.amplitude_m if request.mode == "tapping" else 0.0
    begin = rest - first - amplitude - _ABOVE_M
    # the piezo of an imaging AFM reaches as far as the sample is high
    low, high = rest - float(seen.height_m.max()), rest - float(seen.height_m.min())
    limits = (low - amplitude - 1e-7, high + 2e-7)
    run = (_Tapping if request.mode == "tapping" else _Contact)(request, config, begin, limits)
    trace, retrace = np.zeros((2, request.lines, request.pixels, CHANNELS))
    truth = np.zeros((request.lines, request.pixels))
    left, right = 0.0, surface.width_m
    xs = (np.arange(request.pixels) + 0.5) * (surface.width_m / request.pixels)
    done = 0
    try:
        for number in range(request.lines):
            y = (number + 0.5) * surface.depth_m / request.lines
            truth[number] = [height_at(*seen, float(x), y)[0] for x in xs]
            if number == 0:
                run(seen, Line(left, y, left, y, 1, run.settle_periods), np.zeros((1, CHANNELS)))
            run(seen, Line(left, y, right, y, request.pixels, run.periods), trace[number])
            back = np.zeros((request.pixels, CHANNELS))
            run(seen, Line(right, y, left, y, request.pixels, run.periods), back)
            retrace[number] = back[::-1]
            done = number + 1
            if not progress(done, request.lines):
                break
    except KeyboardInterrupt:
        # what is finished is kept; before the first line there is nothing
        if done == 0:
            raise
    depth = surface.depth_m * done / request.lines
    return ScanResult(trace[:done], retrace[:done], truth[:done], surface.width_m, depth, run.simulated_s)


class _Run(ABC):
    """The instrument during a scan: keeps its state from line to line."""

    def __init__(self, dwell_s: float, period_s: float) -> None:
        self.period_s = period_s
        self.periods = max(1, round(dwell_s / period_s))
        self.settle_periods = max(1, round(_SETTLE_S / period_s))
        self.simulated_s = 0.0

    def __call__(self, seen: Surface, line: Line, out: Array) -> None:
        self.simulated_s += line.pixels * line.periods * self.period_s
        self.scan_line(seen, line, out)

    @abstractmethod
    def scan_line(self, seen: Surface, line: Line, out: Array) -> None: ...


class _Tapping(_Run):
    """Dynamic cantilever with a lock-in; the feedback acts once a period of the drive."""

    def __init__(self, request: ScanRequest, config: AfmConfig, begin_m: float, limits: tuple[float, float]) -> None:
        try:
            self.plant = config.to_dynamic(temperature_k=request.temperature_k)
        except ValueError as error:
            raise ConfigError(str(error)) from error
        super().__init__(request.dwell_s, 1.0 / self.plant.drive_hz)
        self.drive_m = request.amplitude_m / free_amplitude_m(self.plant, 1.0)
        setpoint = request.setpoint_share * request.amplitude_m
        self.feedback = Feedback(setpoint, request.integral_per_s, request.proportional, 1e-3, *limits)
        self.state = steady_state(self.plant, begin_m, self.drive_m)
        self.integral_m, self.error_m = begin_m, request.amplitude_m - setpoint
        self.random = np.random.Generator(np.random.PCG64(request.seed)) if request.temperature_k > 0.0 else None

    def scan_line(self, seen: Surface, line: Line, out: Array) -> None:
        count = line.pixels * line.periods * KICKS_PER_PERIOD
        normals = NO_NOISE if self.random is None else self.random.standard_normal(count)
        self.state, self.integral_m, self.error_m = tapping_line(
            self.plant,
            self.state,
            self.integral_m,
            self.error_m,
            self.feedback,
            line,
            *seen,
            self.drive_m,
            normals,
            out,
        )


def _contact_stiffness(plant: Plant, force_n: float) -> float:
    """Return the stiffness of the contact [N/m] where it pushes with force_n [N]; ConfigError if it does nowhere."""
    tip = plant.tip
    low, high = -5e-9, tip.contact_end_m
    for _ in range(60):
        middle = 0.5 * (low + high)
        if branch_force(tip, middle, True, tip.has_meniscus)[0] < force_n:
            high = middle
        else:
            low = middle
    force, gradient = branch_force(tip, low, True, tip.has_meniscus)
    if not (abs(force - force_n) < 1e-3 * abs(force_n) + 1e-12 and gradient < 0.0):
        raise ConfigError(f"the set-point {force_n:g} N is no force at which the contact with this sample is stable")
    return -gradient


class _Contact(_Run):
    """Quasi-static cantilever at a constant force."""

    def __init__(self, request: ScanRequest, config: AfmConfig, begin_m: float, limits: tuple[float, float]) -> None:
        super().__init__(request.dwell_s, CONTACT_PERIOD_S)
        self.plant = config.to_params().plant
        k = self.plant.stiffness_n_per_m
        setpoint = request.setpoint_n / k
        # a base that comes nearer by 1 nm bends the cantilever by less: the rest goes into the sample
        share = _contact_stiffness(self.plant, request.setpoint_n)
        gain = request.integral_per_s * (1.0 + k / share)
        # the deflection answers at once, so that the integral alone is stable
        self.feedback = Feedback(setpoint, gain, 0.0, 1e-3, *limits)
        self.state = initial_state(self.plant, begin_m)
        self.base_m = self.integral_m = begin_m
        self.error_m = setpoint
        self.friction, self.held = config.to_friction_params(), FrictionState(0.0, 0.0)

    def scan_line(self, seen: Surface, line: Line, out: Array) -> None:
        self.state, self.base_m, self.integral_m, self.error_m, self.held = contact_line(
            self.plant, self.state, self.base_m, self.integral_m, self.error_m, self.feedback, line, *seen,
            self.period_s, self.friction, self.held, out,
        )  # fmt: skip
