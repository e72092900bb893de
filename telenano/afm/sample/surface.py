"""Height maps of samples, and their dilation by a round tip.

A map is a grid of heights over a rectangle that begins at x = y = 0; a height belongs to the middle of its pixel. The
surface is bilinear between the middles and constant beyond the outer ones. A tip that ends in a sphere of radius R does
not follow the surface s but the surface dilated by the sphere,

    d(x, y) = max over u, v of s(x + u, y + v) + sqrt(R^2 - u^2 - v^2) - R,

the height at which the lowest point of the sphere is held by whichever point of it touches (J. S. Villarrubia, J. Res.
NIST 102 (1997) 425). The forces are then those of the sphere over a flat at that height.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from telenano.numerics.compiler import compiled

Heights = npt.NDArray[np.float64]

# Attempts for each dot to find a free place.
_PLACEMENTS = 50
MOST_PIXELS = 4096
# The largest number of comparisons of a dilation: some tens of seconds.
_MOST_COMPARISONS = 2e10


class Surface(NamedTuple):
    """Heights [m], shape (rows, columns): y rises with the row, x with the column; width and depth of a pixel [m]."""

    height_m: Heights
    step_x_m: float
    step_y_m: float

    @property
    def width_m(self) -> float:
        return self.step_x_m * int(self.height_m.shape[1])

    @property
    def depth_m(self) -> float:
        return self.step_y_m * int(self.height_m.shape[0])

    def dilated(self, radius_m: float) -> "Surface":
        """Return the surface dilated by a sphere of radius_m [m]; beyond the map the surface counts as level.

        Raises:
            ValueError: The radius is not finite, negative, or spans so many pixels that this would take minutes.
        """
        if not (math.isfinite(radius_m) and radius_m >= 0.0):
            raise ValueError(f"tip radius = {radius_m} m must be finite and >= 0 m")
        heights = self.height_m
        rows, columns = heights.shape
        span = float(heights.max() - heights.min())
        # A neighbour further away would have to be higher than the highest point to touch the sphere.
        reach = radius_m if span >= radius_m else math.sqrt(max(2.0 * radius_m * span - span * span, 0.0))
        n, m = (min(int(reach / step), size) for step, size in ((self.step_x_m, columns), (self.step_y_m, rows)))
        if n == 0 and m == 0:
            return self
        if 3.2 * n * m * heights.size > _MOST_COMPARISONS:
            raise ValueError(
                f"a tip of radius {radius_m:g} m spans {2 * n} x {2 * m} pixels of a map of {columns} x {rows}: take a"
                " coarser map or a smaller tip"
            )
        padded = np.pad(heights, ((m, m), (n, n)), mode="edge")
        result = heights.copy()
        for dy in range(-m, m + 1):
            for dx in range(-n, n + 1):
                squared = radius_m**2 - (dx * self.step_x_m) ** 2 - (dy * self.step_y_m) ** 2
                if squared >= 0.0:
                    rise = math.sqrt(squared) - radius_m
                    np.maximum(result, padded[m + dy : m + dy + rows, n + dx : n + dx + columns] + rise, out=result)
        return Surface(result, self.step_x_m, self.step_y_m)


# A plane at height 0.
PLANE = Surface(np.zeros((2, 2)), 1.0, 1.0)


@compiled
def height_at(
    height_m: Heights, step_x_m: float, step_y_m: float, x_m: float, y_m: float
) -> tuple[float, float, float]:
    """Return height [m] and slopes dz/dx, dz/dy at a point [m] of the map; outside it continues level.

    Raises:
        ValueError: The point is not finite; compiled code would use it as an index anywhere in memory.
    """
    if not (math.isfinite(x_m) and math.isfinite(y_m)):
        raise ValueError("the point of the map in m must be finite")
    rows, columns = height_m.shape
    x = min(max(x_m / step_x_m - 0.5, 0.0), columns - 1.0)
    y = min(max(y_m / step_y_m - 0.5, 0.0), rows - 1.0)
    i, j = min(int(x), max(columns - 2, 0)), min(int(y), max(rows - 2, 0))
    u, v = x - i, y - j
    right, above = min(i + 1, columns - 1), min(j + 1, rows - 1)
    a, b = height_m[j, i], height_m[j, right]
    c, d = height_m[above, i], height_m[above, right]
    height = (a * (1.0 - u) + b * u) * (1.0 - v) + (c * (1.0 - u) + d * u) * v
    slope_x = ((b - a) * (1.0 - v) + (d - c) * v) / step_x_m
    slope_y = ((c - a) * (1.0 - u) + (d - b) * u) / step_y_m
    return height, slope_x, slope_y


@compiled
def height_over_middle(surface: Surface, x_m: float, y_m: float) -> tuple[float, float, float]:
    """Return height [m] and slopes dz/dx, dz/dy at a place [m] counted from the middle of the map."""
    rows, columns = surface.height_m.shape
    x, y = x_m + 0.5 * (surface.step_x_m * columns), y_m + 0.5 * (surface.step_y_m * rows)
    height, slope_x, slope_y = height_at(surface.height_m, surface.step_x_m, surface.step_y_m, x, y)
    return float(height), float(slope_x), float(slope_y)


def checked(height_m: npt.NDArray[np.generic], width_m: float, depth_m: float, *, may_lack: bool = False) -> Surface:
    """Return a checked map over width_m by depth_m [m]; with may_lack, missing heights are allowed and become NaN.

    Raises:
        ValueError: The map cannot be scanned because of its shape, its size, or a height that is no number.
    """
    heights = np.ascontiguousarray(height_m, dtype=np.float64)
    if heights.ndim != 2 or min(heights.shape) < 2 or max(heights.shape) > MOST_PIXELS:
        raise ValueError(f"has the shape {heights.shape}; a height map has 2 to {MOST_PIXELS} rows and columns")
    for name, size in (("width", width_m), ("depth", depth_m)):
        if not (math.isfinite(size) and 1e-9 <= size <= 1e-3):
            raise ValueError(f"has a {name} of {size:g} m; it must lie between 1e-9 and 1e-3 m")
    missing = ~np.isfinite(heights)
    bad = int(np.count_nonzero(missing))
    if bad and may_lack and bad < heights.size:
        heights = np.where(missing, np.nan, heights)
    elif bad:
        raise ValueError(f"has {bad} heights that are not finite (of {heights.size}); interpolate them first")
    span = float(np.nanmax(heights) - np.nanmin(heights))
    if span > 1e-4:
        raise ValueError(f"has heights over {span:g} m, more than 1e-4 m: is its unit of height right?")
    return Surface(heights, float(width_m) / heights.shape[1], float(depth_m) / heights.shape[0])


def flat(size_m: float, pixels: int) -> Surface:
    """Return a level square of size_m [m]."""
    return checked(np.zeros((pixels, pixels)), size_m, size_m)


def dots(size_m: float, pixels: int, dot_count: int, dot_radius_m: float, height_m: float, seed: int) -> Surface:
    """Return a level square of size_m [m] with dots at random places, none touching another (Fig. 8: InAs).

    A dot is half an ellipsoid, height_m [m] tall on a circle of dot_radius_m [m]. The places depend on the seed alone.

    Raises:
        ValueError: The dots find no room.
    """
    random = np.random.Generator(np.random.PCG64(seed))
    places: list[tuple[float, float]] = []
    room = size_m - 4.0 * dot_radius_m
    for _ in range(_PLACEMENTS * dot_count):
        if len(places) == dot_count:
            break
        x, y = (2.0 * dot_radius_m + room * value for value in random.random(2).tolist())
        if all((x - p) ** 2 + (y - q) ** 2 > (2.5 * dot_radius_m) ** 2 for p, q in places):
            places.append((x, y))
    if len(places) < dot_count or room <= 0.0:
        raise ValueError(
            f"{dot_count} dots of radius {dot_radius_m:g} m find no room on {size_m:g} m: take fewer or smaller ones"
        )
    middles = (np.arange(pixels) + 0.5) * (size_m / pixels)
    heights = np.zeros((pixels, pixels))
    for x, y in places:
        squared = ((middles[None, :] - x) ** 2 + (middles[:, None] - y) ** 2) / dot_radius_m**2
        np.maximum(heights, height_m * np.sqrt(np.maximum(1.0 - squared, 0.0)), out=heights)
    return checked(heights, size_m, size_m)


def grating(size_m: float, pixels: int, period_m: float, height_m: float) -> Surface:
    """Return a square of size_m [m] with ridges of height_m [m] along y, half a period_m [m] wide.

    x = 0 is the middle of a groove.
    """
    middles = (np.arange(pixels) + 0.5) * (size_m / pixels)
    ridge = np.abs(np.mod(middles / period_m + 0.5, 1.0) - 0.5) > 0.25
    return checked(np.tile(np.where(ridge, height_m, 0.0), (pixels, 1)), size_m, size_m)


# The shapes that a sample can have by name. A shape takes keys of the section of the sample by their names.
SHAPES: dict[str, Callable[..., Surface]] = {"flat": flat, "dots": dots, "grating": grating}


def centred(surface: Surface) -> Surface:
    """Return the surface shifted so that the height is 0 in its middle, where an AFM first brings its tip."""
    middle_m = height_at(*surface, 0.5 * surface.width_m, 0.5 * surface.depth_m)[0]
    return surface._replace(height_m=surface.height_m - middle_m)


def plane_levelled(surface: Surface) -> Surface:
    """Return the surface without its least-squares plane, that is without tilt and offset."""
    rows, columns = surface.height_m.shape
    x, y = np.arange(columns) - 0.5 * (columns - 1), np.arange(rows) - 0.5 * (rows - 1)
    # On a whole grid the three parameters of the fit are independent; `fsum` gives the same bits on every processor.
    heights = surface.height_m
    mean = math.fsum(heights.ravel().tolist()) / heights.size
    tilt_x = math.fsum((heights * x[None, :]).ravel().tolist()) / (rows * math.fsum((x * x).tolist()))
    tilt_y = math.fsum((heights * y[:, None]).ravel().tolist()) / (columns * math.fsum((y * y).tolist()))
    return surface._replace(height_m=heights - mean - tilt_x * x[None, :] - tilt_y * y[:, None])
