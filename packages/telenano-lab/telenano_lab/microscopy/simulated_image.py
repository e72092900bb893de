"""An image in simulated time: the instrument runs its program `scan` behind the guard of a rig, without waiting."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from telenano.afm import height_over_middle
from telenano.devices import VirtualInstrument
from telenano.sections import AfmConfig
from telenano.wire import AfmScanline, ConfigError, RefusedError, Scalar
from telenano_lab.microscopy.image_files import LiveImage

Array = npt.NDArray[np.float64]


@dataclass
class SimulatedImage:
    """The lines of an image as a rig records them, and the true surface at the same points.

    truth_m: heights of the surface as the tip sees it [m], shape (lines, pixels), NaN in lines not yet scanned.
    simulated_s: simulated time that the image took [s].
    """

    lines: LiveImage = field(default_factory=LiveImage)
    truth_m: Array = field(default_factory=lambda: np.empty((0, 0)))
    simulated_s: float = 0.0

    @property
    def height_m(self) -> Array:
        """Return the heights of the finished lines [m], shifted to the mean of the truth.

        An AFM measures no absolute height.
        """
        height = self.lines.trace_m[: self.lines.finished]
        return np.asarray(height - height.mean() + self._truth_m.mean())

    @property
    def rms_error_m(self) -> float:
        """Return the root mean square difference of height and truth [m]."""
        return float(np.sqrt(np.mean((self.height_m - self._truth_m) ** 2)))

    @property
    def correlation(self) -> float:
        """Return the correlation of height and truth; 0 if either is level."""
        a, b = (each.ravel() - each.mean() for each in (self.height_m, self._truth_m))
        norm = math.sqrt(float(np.sum(a * a)) * float(np.sum(b * b)))
        return float(np.sum(a * b)) / norm if norm > 0.0 else 0.0

    @property
    def _truth_m(self) -> Array:
        return self.truth_m[: self.lines.finished]


def take_image(
    config: AfmConfig, keys: Mapping[str, Scalar], progress: Callable[[int, int], bool] = lambda n, of: True
) -> SimulatedImage:
    """Simulate an instrument that takes an image of its sample.

    Args:
        config: The instrument, with the sample under its tip; tapping mode needs `model: dynamic`.
        keys: Settings of `scan`, as in `session set`: `{"scan.pixels": 64}`; the others have their defaults.
        progress: Called with the number of finished lines and their total. Returning False ends the image and keeps the
            lines so far, as Ctrl-C and SIGTERM do.

    Raises:
        ConfigError: The image cannot be taken; the message says what to change.
    """
    image = SimulatedImage()
    try:
        instrument = VirtualInstrument(config)
        for _ in instrument.run({"program": "scan", **keys}):
            if (fields := instrument.scanline()) is None:
                continue
            line = AfmScanline(seq=fields["line"], t_ns=0, src="afm_node@slave", v=1, **fields)
            _add(instrument, line, image)
            if line.direction == "retrace" and not progress(line.line + 1, line.lines):
                break
    except RefusedError as error:
        raise ConfigError(str(error)) from error
    except KeyboardInterrupt:
        # Finished lines are kept; before the first one there is nothing to keep.
        if image.lines.finished == 0:
            raise
    image.simulated_s = instrument.time_s
    if instrument.outcome is not None and instrument.outcome.state != "finished":
        raise ConfigError(f"the image ended before its last line: {instrument.outcome.text}")
    return image


def _add(instrument: VirtualInstrument, line: AfmScanline, image: SimulatedImage) -> None:
    image.lines.add(line)
    (pixels,) = line.height_m.shape
    if image.truth_m.size == 0:
        image.truth_m = np.full((line.lines, pixels), math.nan)
    relief = instrument.device.relief
    if relief is None or relief.surface is None:
        image.truth_m[line.line] = 0.0
        return
    xs = np.linspace(line.start_m[0], line.end_m[0], pixels).tolist()
    image.truth_m[line.line] = [height_over_middle(relief.surface, x, line.start_m[1])[0] for x in xs]
