"""An image that comes line by line, from a running rig or from a recording."""

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from telenano.wire.messages import AfmScanline

Array = npt.NDArray[np.float64]


@dataclass
class LiveImage:
    """The lines of an image so far: heights [m], lateral forces [N] of shape (lines, pixels), NaN for none; sides.

    Of the trace in tapping mode amplitude [m], phase [rad], and energy that the sample takes in a period [J].
    """

    trace_m: Array = field(default_factory=lambda: np.empty((0, 0)))
    retrace_m: Array = field(default_factory=lambda: np.empty((0, 0)))
    trace_n: Array = field(default_factory=lambda: np.empty((0, 0)))
    retrace_n: Array = field(default_factory=lambda: np.empty((0, 0)))
    amplitude_m: Array = field(default_factory=lambda: np.empty((0, 0)))
    phase_rad: Array = field(default_factory=lambda: np.empty((0, 0)))
    dissipated_j: Array = field(default_factory=lambda: np.empty((0, 0)))
    width_m: float = 0.0
    depth_m: float = 0.0
    first_y_m: float = 0.0

    def add(self, line: AfmScanline) -> None:
        """Put a line in its place."""
        heights = np.asarray(line.height_m.to_numpy(), dtype=np.float64)
        if self.trace_m.shape != (line.lines, len(heights)):
            shape = (line.lines, len(heights))
            self.trace_m, self.retrace_m, self.trace_n, self.retrace_n = (np.full(shape, np.nan) for _ in range(4))
            self.amplitude_m, self.phase_rad, self.dissipated_j = (np.full(shape, np.nan) for _ in range(3))
            # the ends are the middles of the outer pixels
            span = line.end_m[0] - line.start_m[0]
            self.width_m = span * len(heights) / max(len(heights) - 1, 1)
        is_back = line.direction == "retrace"
        (self.retrace_m if is_back else self.trace_m)[line.line] = heights
        if line.lateral_force_n is not None:
            (self.retrace_n if is_back else self.trace_n)[line.line] = line.lateral_force_n.to_numpy()
        if not is_back and line.amplitude_m is not None and line.phase_rad is not None:
            self.amplitude_m[line.line] = line.amplitude_m.to_numpy()
            self.phase_rad[line.line] = line.phase_rad.to_numpy()
        if not is_back and line.dissipated_j is not None:
            self.dissipated_j[line.line] = line.dissipated_j.to_numpy()
        if line.line == 0:
            self.first_y_m, self.depth_m = line.start_m[1], self.width_m / len(heights)
        else:
            self.depth_m = (line.start_m[1] - self.first_y_m) / line.line * line.lines

    @property
    def partial(self) -> str:
        """Return in words how much there is of an image that is not whole; of a whole one nothing."""
        wanted = len(self.trace_m)
        return f"{self.finished} of {wanted} lines" if self.finished < wanted else ""

    @property
    def finished(self) -> int:
        """How many lines there are, from the first, both ways."""
        whole = np.asarray(np.isfinite(self.trace_m + self.retrace_m).all(axis=1))
        return len(whole) if whole.all() else int(np.argmin(whole))
