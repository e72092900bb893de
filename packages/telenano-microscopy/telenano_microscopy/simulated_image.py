"""An image in simulated time: the program `scan` of the instrument, behind the guard of a rig, without waiting."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from telenano.afm import AfmConfig, Surface, height_at, requested
from telenano.devices import VirtualInstrument, line_fields
from telenano.extend.programs import FinishedLine
from telenano.wire import AfmScanline, ConfigError, RefusedError, Scalar
from telenano_microscopy.image_files import LiveImage

Array = npt.NDArray[np.float64]


@dataclass
class SimulatedImage:
    """The lines of an image as a rig has them, beside what the tip sees at the same points.

    truth_m: heights of the surface as the tip sees it [m], of shape (lines, pixels), NaN where there is no line yet.
    simulated_s: the time that the image took on the instrument [s].
    """

    lines: LiveImage = field(default_factory=LiveImage)
    truth_m: Array = field(default_factory=lambda: np.empty((0, 0)))
    simulated_s: float = 0.0

    @property
    def height_m(self) -> Array:
        """Return the height of the finished lines [m], its mean that of the truth: an AFM knows no absolute height."""
        height = self.lines.trace_m[: self.lines.finished]
        return np.asarray(height - height.mean() + self._truth_m.mean())

    @property
    def rms_error_m(self) -> float:
        """Return the root mean square of the height less the truth [m]."""
        return float(np.sqrt(np.mean((self.height_m - self._truth_m) ** 2)))

    @property
    def correlation(self) -> float:
        """Return the correlation with the truth; 0 where one of them is level."""
        a, b = (each.ravel() - each.mean() for each in (self.height_m, self._truth_m))
        norm = math.sqrt(float(np.sum(a * a)) * float(np.sum(b * b)))
        return float(np.sum(a * b)) / norm if norm > 0.0 else 0.0

    @property
    def _truth_m(self) -> Array:
        return self.truth_m[: self.lines.finished]


def take_image(
    config: AfmConfig, keys: Mapping[str, Scalar], progress: Callable[[int, int], bool] = lambda n, of: True
) -> SimulatedImage:
    """Have a simulated instrument take an image of its sample.

    Args:
        config: The instrument, with the sample under its tip; tapping mode needs `model: dynamic`.
        keys: What is set of `scan`, as in `session set`: `{"scan.pixels": 64}`; the others have their defaults.
        progress: Called with the finished lines and their number; it ends the image by returning False, which leaves
            the lines so far, as Ctrl-C and SIGTERM do.

    Raises:
        ConfigError: The image cannot be taken; the message says what would be right.
    """
    image = SimulatedImage()
    try:
        instrument = VirtualInstrument(config)
        request = requested({"program": "scan", **keys})
        for line in (step.wanted.line for step in instrument.run(request)):
            if line is None:
                continue
            lines = request.settings_of("scan").lines
            _add(instrument, line, lines, image)
            if line.backward and not progress(line.line + 1, lines):
                break
    except RefusedError as error:
        raise ConfigError(str(error)) from error
    except KeyboardInterrupt:
        # What is finished is kept; before the first line there is nothing.
        if image.lines.finished == 0:
            raise
    image.simulated_s = instrument.time_s
    if instrument.outcome is not None and instrument.outcome.state != "finished":
        raise ConfigError(f"the image ended before its last line: {instrument.outcome.text}")
    return image


def _add(instrument: VirtualInstrument, line: FinishedLine, lines: int, found: SimulatedImage) -> None:
    message = line_fields(line, lines, instrument.config.friction)
    found.lines.add(AfmScanline(seq=line.line, t_ns=0, src="afm_node@slave", v=1, **message))
    if found.truth_m.size == 0:
        found.truth_m = np.full((lines, len(line.height_m)), math.nan)
    xs = np.linspace(line.start.x_m, line.end.x_m, len(line.height_m)).tolist()
    relief = instrument.device.relief
    surface: Surface | None = None if relief is None else relief.surface
    if surface is None:
        found.truth_m[line.line] = 0.0
        return
    left_m, front_m = 0.5 * surface.width_m, 0.5 * surface.depth_m
    found.truth_m[line.line] = [height_at(*surface, x + left_m, line.start.y_m + front_m)[0] for x in xs]
