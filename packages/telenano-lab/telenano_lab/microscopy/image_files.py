"""Images for other programs: .gwy and .gsf of Gwyddion, and PNG; packages add other formats.

Rows are ordered by rising y, as everywhere in telenano; in the files the first row is the top of the picture.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import numpy.typing as npt

from telenano.wire import AfmScanline

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Heights = npt.NDArray[np.float64]
# First line of a Gwyddion Simple Field.
_GSF_MAGIC = b"Gwyddion Simple Field 1.0\n"


class Image(NamedTuple):
    """One channel: title, unit of the values, values of shape (rows, columns) with y rising, and side lengths [m].

    partial: how much there is of an image that ended early, such as `37 of 256 lines`, or empty. log: the steps applied
    to the values, one sentence each. Both are written into every file.
    """

    title: str
    unit: str
    values: npt.NDArray[np.float64]
    width_m: float
    depth_m: float
    partial: str = ""
    log: tuple[str, ...] = ()

    @property
    def caption(self) -> str:
        """Return the title, marked as partial if the image ended early."""
        return f"{self.title} (partial: {self.partial})" if self.partial else self.title


class ImageFacts(NamedTuple):
    """Origin of an image: mode (contact or tapping), instrument, version of telenano, and the sample if known."""

    mode: str
    instrument: str
    version: str
    sample: str = ""


@dataclass
class LiveImage:
    """The lines of an image so far: heights [m] and lateral forces [N], shape (lines, pixels), NaN where missing.

    In tapping mode the trace also has amplitude [m], phase [rad] and the energy that the sample dissipates per period
    [J].
    """

    trace_m: Heights = field(default_factory=lambda: np.empty((0, 0)))
    retrace_m: Heights = field(default_factory=lambda: np.empty((0, 0)))
    trace_n: Heights = field(default_factory=lambda: np.empty((0, 0)))
    retrace_n: Heights = field(default_factory=lambda: np.empty((0, 0)))
    amplitude_m: Heights = field(default_factory=lambda: np.empty((0, 0)))
    phase_rad: Heights = field(default_factory=lambda: np.empty((0, 0)))
    dissipated_j: Heights = field(default_factory=lambda: np.empty((0, 0)))
    width_m: float = 0.0
    depth_m: float = 0.0
    first_y_m: float = 0.0

    def add(self, line: AfmScanline) -> None:
        """Store a scan line at its row, allocating the arrays with the first one."""
        heights = np.asarray(line.height_m.to_numpy(), dtype=np.float64)
        if self.trace_m.shape != (line.lines, len(heights)):
            shape = (line.lines, len(heights))
            self.trace_m, self.retrace_m, self.trace_n, self.retrace_n = (np.full(shape, np.nan) for _ in range(4))
            self.amplitude_m, self.phase_rad, self.dissipated_j = (np.full(shape, np.nan) for _ in range(3))
            # The ends of a line are the centres of its outer pixels.
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
        """Return how much of an unfinished image there is, such as `37 of 256 lines`; empty for a complete one."""
        wanted = len(self.trace_m)
        return f"{self.finished} of {wanted} lines" if self.finished < wanted else ""

    @property
    def finished(self) -> int:
        """Return the number of leading lines whose trace and retrace are both complete."""
        whole = np.asarray(np.isfinite(self.trace_m + self.retrace_m).all(axis=1))
        return len(whole) if whole.all() else int(np.argmin(whole))


def images_of_lines(image: LiveImage, count: int) -> dict[str, Image]:
    """Return the channels of the first `count` lines of an image, whose trace and retrace must be complete."""

    def named(title: str, unit: str, values: npt.NDArray[np.float64]) -> Image:
        return Image(title, unit, values, image.width_m, depth_m, image.partial)

    # An AFM measures no absolute height.
    level = float(image.trace_m[:count].mean())
    depth_m = image.depth_m * count / len(image.trace_m)
    images = {
        "height": named("Height", "m", image.trace_m[:count] - level),
        "retrace": named("Height retrace", "m", image.retrace_m[:count] - level),
    }
    for name, title, unit, values in (
        ("amplitude", "Amplitude", "m", image.amplitude_m[:count]),
        ("phase", "Phase", "rad", image.phase_rad[:count]),
        ("dissipated", "Dissipated energy in a period", "J", image.dissipated_j[:count]),
        ("lateral", "Lateral force", "N", image.trace_n[:count]),
        ("lateral_retrace", "Lateral force retrace", "N", image.retrace_n[:count]),
    ):
        # A tapping tip has no lateral force along the line.
        if np.isfinite(values).all() and not (name.startswith("lateral") and "amplitude" in images):
            images[name] = named(title, unit, values)
    return images


def write_gsf(path: Path, image: Image) -> None:
    """Write one channel as a Gwyddion Simple Field: a text header, then 32-bit floats."""
    rows, columns = image.values.shape
    header = (
        f"XRes = {columns}\nYRes = {rows}\nXReal = {float(image.width_m)!r}\nYReal = {float(image.depth_m)!r}\n"
        f"XYUnits = m\nZUnits = {image.unit}\nTitle = {image.caption}\n"
    )
    if image.partial:
        header += f"Partial = {image.partial}\n"
    header += "".join(f"Step{number} = {step}\n" for number, step in enumerate(image.log, start=1))
    content = _GSF_MAGIC + header.encode()
    content += b"\0" * (4 - len(content) % 4)
    path.write_bytes(content + np.ascontiguousarray(image.values[::-1], dtype="<f4").tobytes())


def write_gwy(path: Path, images: Mapping[str, Image]) -> None:
    """Write channels, with the titles of the images, into one Gwyddion file."""
    from gwyfile.objects import GwyContainer, GwyDataField, GwyObject, GwySIUnit

    container = GwyContainer()
    for number, image in enumerate(images.values()):
        field = GwyDataField(
            np.ascontiguousarray(image.values[::-1], dtype="<f8"),
            xreal=image.width_m,
            yreal=image.depth_m,
            si_unit_xy=GwySIUnit(unitstr="m"),
            si_unit_z=GwySIUnit(unitstr=image.unit),
        )
        container[f"/{number}/data"] = field
        container[f"/{number}/data/title"] = image.caption
        if image.partial:
            container[f"/{number}/meta"] = GwyContainer({"Partial": image.partial})
        if image.log:
            container[f"/{number}/data/log"] = GwyObject(
                "GwyStringList", {"strings": list(image.log)}, {"strings": "S"}
            )
    container.tofile(str(path))


def write_png(path: Path, images: Mapping[str, Image]) -> None:
    """Draw channels into a PNG file, with remarks on partial images and processing steps in its metadata."""
    parts = {image.partial for image in images.values()} - {""}
    said = [f"partial: {', '.join(sorted(parts))}"] if parts else []
    said += [f"{image.title}: {step}" for image in images.values() for step in image.log]
    metadata = {"Description": "; ".join(said)} if said else {}
    image_figure(images).savefig(path, dpi=120, metadata=metadata)


def image_figure(images: Mapping[str, Image]) -> "Figure":
    """Draw channels beside each other, each with a colour scale."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    count = len(images)
    columns = min(count, 3)
    rows = -(-count // columns)
    figure = Figure(figsize=(4.6 * columns, 3.9 * rows), layout="constrained")
    FigureCanvasAgg(figure)
    for place, image in enumerate(images.values(), start=1):
        axes = figure.add_subplot(rows, columns, place)
        factor, unit = readable(image.values, image.unit)
        side, side_unit = readable(np.array([image.width_m, image.depth_m]), "m")
        extent = (0.0, image.width_m * side, 0.0, image.depth_m * side)
        shown = axes.imshow(image.values * factor, origin="lower", extent=extent, cmap="afmhot", aspect="equal")
        figure.colorbar(shown, ax=axes, label=unit)
        axes.set_title(image.caption.replace(" (", "\n("))
        axes.set_xlabel(f"x [{side_unit}]")
        axes.set_ylabel(f"y [{side_unit}]")
    return figure


_PREFIXES = (
    *((1e-18, "a"), (1e-15, "f"), (1e-12, "p"), (1e-9, "n"), (1e-6, "µ"), (1e-3, "m")),
    *((1.0, ""), (1e3, "k"), (1e6, "M"), (1e9, "G")),
)


def readable(values: npt.NDArray[np.float64], unit: str) -> tuple[float, str]:
    """Return a factor and a prefixed unit that bring the largest value between 1 and 1000."""
    if unit in ("deg", "rad", ""):
        return 1.0, unit
    largest = float(np.abs(values).max(initial=0.0))
    base, prefix = max((row for row in _PREFIXES if row[0] <= largest), default=(1.0, ""))
    return 1.0 / base, prefix + unit
