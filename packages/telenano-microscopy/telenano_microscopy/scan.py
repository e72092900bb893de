"""Images in simulated time: a raster over a sample, line by line there and back."""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from proto.errors import ConfigError
from services.afm_node.config import AfmConfig
from services.afm_node.physics.cantilever import Plant, initial_state
from services.afm_node.physics.contact.friction import FrictionState
from services.afm_node.physics.contact.tip_sample import branch_force
from services.afm_node.physics.dynamic import NO_NOISE, free_amplitude_m, steady_state
from services.afm_node.physics.dynamic_plant import NORMALS_PER_PERIOD
from services.afm_node.physics.dynamic_sim import require_steps
from services.afm_node.physics.sample.surface import Surface, dilated, height_at
from services.afm_node.programs.feedback import gain_fault, remaining
from services.afm_node.programs.scan import GAIN_NAMES, ScanSettings
from telenano_microscopy.imaging import CHANNELS, HEIGHT, Feedback, Line, contact_line, tapping_line

Array = npt.NDArray[np.float64]

# way of the feedback in contact [s]: 20 kHz, as instruments have it
CONTACT_PERIOD_S = 50e-6
_PIEZO_M_PER_S = 1e-3
_MOST_K = 2000.0
# the tip begins this far above the first point [m]
_ABOVE_M = 5e-9
# a feedback is tried for some periods over the first point: it swings where the base goes on by more than this [m], and
# the last eighth of the time takes away less than half of it
_LEAST_TRIAL, _MOST_TRIAL = 2000, 20_000
_QUIET_M = 20e-12
# the gains that are tried in turn, as shares of the integral and the proportional gain
_LOWER_GAINS = ((1.0, 0.5), (1.0, 0.0), (0.5, 0.0), (0.25, 0.0), (0.125, 0.0))
# periods of the feedback in one compiled call, some 50 ms: a signal waits for its end
_CALL_PERIODS = 40_000


@dataclass(frozen=True)
class ScanResult:
    """An image: trace and retrace of shape (lines, pixels, CHANNELS), and what the tip sees at the same points [m].

    wanted_lines, of the whole image: there are fewer where it was ended early. gain_per_s [1/s] and proportional are
    the gains of the feedback that took it; those as shipped are lowered where they would swing.
    """

    trace: Array
    retrace: Array
    truth_m: Array
    width_m: float
    depth_m: float
    simulated_s: float
    wanted_lines: int
    gain_per_s: float
    proportional: float

    @property
    def partial(self) -> str:
        """Return in words how much there is of an image that was ended early; of a whole one nothing."""
        return f"{len(self.trace)} of {self.wanted_lines} lines" if len(self.trace) < self.wanted_lines else ""

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


@dataclass(frozen=True)
class Noise:
    """The thermal noise of the cantilever in tapping mode: its temperature [K], 0 for none, and its seed."""

    temperature_k: float = 0.0
    seed: int = 0

    def __post_init__(self) -> None:
        if not 0.0 <= self.temperature_k <= _MOST_K:
            raise ConfigError(f"temperature [K] = {self.temperature_k:g} must be 0 or more, and at most {_MOST_K:g}")


def scan(
    surface: Surface,
    request: ScanSettings,
    config: AfmConfig,
    progress: Callable[[int, int], bool] = lambda n, of: True,
    noise: Noise = Noise(),
) -> ScanResult:
    """Image the whole of a surface.

    Args:
        surface: What is imaged.
        request: What an image is, with the defaults of simulated time: `ScanSettings.in_simulated_time(pixels=64)`.
        config: The instrument.
        progress: Called with the finished lines and their number; it ends the image by returning False, which leaves
            the lines so far, as Ctrl-C and SIGTERM do.
        noise: The thermal noise of the cantilever.

    Raises:
        ConfigError: The request or the surface cannot be imaged.
    """
    if request.width_m is not None or request.depth_m is not None or request.x_m != 0.0 or request.y_m != 0.0:
        raise ConfigError("in simulated time the whole of a sample is imaged: give no place and no sides of the image")
    try:
        seen = dilated(surface, config.tip_sample.tip_radius_m)
    except ValueError as error:
        raise ConfigError(str(error)) from error
    first = height_at(*seen, 0.0, 0.5 * surface.depth_m / request.lines)[0]
    rest, amplitude = config.rest_distance_m, request.free_amplitude_m
    begin = rest - first - amplitude - _ABOVE_M
    # the piezo of an imaging AFM reaches as far as the sample is high
    low, high = rest - float(seen.height_m.max()), rest - float(seen.height_m.min())
    limits = (low - amplitude - 1e-7, high + 2e-7)
    run: _Run
    if request.mode == "tapping":
        run = _Tapping(request, config, begin, limits, noise)
    else:
        run = _Contact(request, config, begin, limits)
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
                run.settle(seen, left, y)
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
    return ScanResult(
        trace[:done], retrace[:done], truth[:done], surface.width_m, depth, run.simulated_s, request.lines,
        run.gain_per_s, run.proportional,
    )  # fmt: skip


class _Run(ABC):
    """The instrument during a scan: keeps its state from line to line."""

    def __init__(self, request: ScanSettings, period_s: float) -> None:
        self.period_s = period_s
        self.periods = max(1, round(request.dwell_s / period_s))
        self.settle_periods = max(1, round(request.settle_s / period_s))
        self.simulated_s = 0.0
        self.gain_per_s, self.proportional = request.gain_per_s, request.proportional

    def settle(self, seen: Surface, x_m: float, y_m: float) -> None:
        """Let the feedback come to rest over the first point."""
        self(seen, Line(x_m, y_m, x_m, y_m, 1, self.settle_periods), np.zeros((1, CHANNELS)))

    def __call__(self, seen: Surface, line: Line, out: Array) -> None:
        self.simulated_s += line.pixels * line.periods * self.period_s
        pixels = max(1, _CALL_PERIODS // line.periods)
        for first in range(0, line.pixels, pixels):
            self.scan_pixels(seen, line, first, out[first : first + pixels])

    @abstractmethod
    def scan_pixels(self, seen: Surface, line: Line, first: int, out: Array) -> None:
        """Scan as many pixels of a line as `out` has rows, from `first` on."""


def _feedback(
    request: ScanSettings, setpoint_m: float, period_s: float, lag: float | None, limits: tuple[float, float]
) -> Feedback:
    """Return the feedback; ConfigError names a gain with which it is unstable."""
    if fault := gain_fault(request.gain_per_s, request.proportional, period_s, lag, GAIN_NAMES):
        raise ConfigError(fault)
    return Feedback(setpoint_m, request.gain_per_s, request.proportional, _PIEZO_M_PER_S, *limits)


def _swing_m(height_m: Array) -> float:
    """Return the greatest less the least of heights [m], without the straight line from the first to the last."""
    flat = height_m - height_m[0] - np.arange(len(height_m)) * ((height_m[-1] - height_m[0]) / (len(height_m) - 1))
    return float(flat.max() - flat.min())


class _Tapping(_Run):
    """Dynamic cantilever with a lock-in; the feedback acts once a period of the drive."""

    def __init__(
        self, request: ScanSettings, config: AfmConfig, begin_m: float, limits: tuple[float, float], noise: Noise
    ) -> None:
        try:
            self.plant = config.to_dynamic(temperature_k=noise.temperature_k)
            require_steps(self.plant)
        except ValueError as error:
            raise ConfigError(str(error)) from error
        super().__init__(request, 1.0 / self.plant.drive_hz)
        self.drive_m = request.amplitude_m / free_amplitude_m(self.plant, 1.0)
        setpoint = request.setpoint_share * request.amplitude_m
        lag = remaining(self.period_s, config.cantilever.resonance_hz, config.cantilever.quality)
        self.feedback = _feedback(request, setpoint, self.period_s, lag, limits)
        self.state = steady_state(self.plant, begin_m, self.drive_m)
        self.proportional_m, self.error_m = 0.0, request.amplitude_m - setpoint
        self.random = np.random.Generator(np.random.PCG64(noise.seed)) if noise.temperature_k > 0.0 else None
        shipped = ScanSettings.in_simulated_time(mode="tapping")
        self.as_shipped = (request.gain_per_s, request.proportional) == (shipped.gain_per_s, shipped.proportional)

    def settle(self, seen: Surface, x_m: float, y_m: float) -> None:
        """Let the feedback come to rest over the first point, with lower gains where those as shipped would swing.

        The bounds of `gain_fault` are those of an amplitude that follows the base. A soft tip, or a low set-point, has
        an amplitude that another period of the drive may have twice, so the gains are tried here, without noise.

        Raises:
            ConfigError: Gains that were asked for swing; it names gains that do not.
        """
        if self._swings(seen, x_m, y_m, self.feedback):
            for integral, proportional in _LOWER_GAINS:
                lower = self.feedback._replace(
                    gain_per_s=integral * self.feedback.gain_per_s,
                    proportional=proportional * self.feedback.proportional,
                )
                if not self._swings(seen, x_m, y_m, lower):
                    break
            else:
                raise ConfigError("the feedback swings over the first point, even with an eighth of its gain")
            if not self.as_shipped:
                names = ", ".join(f"{name} = {value:g}" for name, value in zip(GAIN_NAMES, lower[1:3], strict=True))
                raise ConfigError(f"these gains make the feedback swing over the first point; with {names} it does not")
            self.feedback = lower
            self.gain_per_s, self.proportional = lower.gain_per_s, lower.proportional
        super().settle(seen, x_m, y_m)

    def _swings(self, seen: Surface, x_m: float, y_m: float, feedback: Feedback) -> bool:
        """Return whether the base is still swinging after the time in which the feedback is to settle."""
        periods = min(max(self.settle_periods, _LEAST_TRIAL), _MOST_TRIAL)
        out = np.zeros((periods, CHANNELS))
        tapping_line(
            self.plant, self.state, self.proportional_m, self.error_m, feedback,
            Line(x_m, y_m, x_m, y_m, periods, 1), *seen, self.drive_m, NO_NOISE, 0, out,
        )  # fmt: skip
        before, after = (_swing_m(out[-n * periods // 8 :][: periods // 8, HEIGHT]) for n in (2, 1))
        return after > _QUIET_M and after > 0.5 * before

    def scan_pixels(self, seen: Surface, line: Line, first: int, out: Array) -> None:
        count = len(out) * line.periods * NORMALS_PER_PERIOD
        normals = NO_NOISE if self.random is None else self.random.standard_normal(count)
        self.state, self.proportional_m, self.error_m = tapping_line(
            self.plant,
            self.state,
            self.proportional_m,
            self.error_m,
            self.feedback,
            line,
            *seen,
            self.drive_m,
            normals,
            first,
            out,
        )


def _require_contact(plant: Plant, force_n: float) -> None:
    """Raise ConfigError if the contact pushes with force_n [N] nowhere."""
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


class _Contact(_Run):
    """Quasi-static cantilever at a constant force."""

    def __init__(self, request: ScanSettings, config: AfmConfig, begin_m: float, limits: tuple[float, float]) -> None:
        super().__init__(request, CONTACT_PERIOD_S)
        self.plant = config.to_params().plant
        k = self.plant.stiffness_n_per_m
        setpoint = request.setpoint_n / k
        _require_contact(self.plant, request.setpoint_n)
        self.feedback = _feedback(request, setpoint, self.period_s, None, limits)
        self.state = initial_state(self.plant, begin_m)
        self.base_m, self.proportional_m = begin_m, 0.0
        self.error_m = setpoint
        self.friction, self.held = config.to_friction_params(), FrictionState(0.0, 0.0)

    def scan_pixels(self, seen: Surface, line: Line, first: int, out: Array) -> None:
        self.state, self.base_m, self.proportional_m, self.error_m, self.held = contact_line(
            self.plant, self.state, self.base_m, self.proportional_m, self.error_m, self.feedback, line, *seen,
            self.period_s, self.friction, self.held, first, out,
        )  # fmt: skip
