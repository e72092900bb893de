"""Find particles in an image: places, radii and their standard errors.

The parts of an image above the ground are divided into groups of peaks. Profiles of spheres under a tip
(`tip_shape.ride_height_m`) are fitted to each group by least squares, with places and radii free. The height of a
sphere is 2 R for any tip, and its flanks are those of the tip: so a fit, unlike a centroid, is not biased towards the
pixels.
"""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy import ndimage, optimize

from telenano_lab.assembly.particles.tip_shape import TipShape

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

# A peak rises above this number of standard deviations of the noise.
_DEVIATIONS = 3.0
# A peak rises above this share of the usual height of peaks.
_SHARE = 0.3
# Two tops nearer than this share of the radius are one.
_LEAST_APART = 0.7
# Residuals above this share of the height mean several particles that touch.
_CLUSTER = 0.05
_FEWEST_PIXELS = 6
# An object beside the particles is fixed to the sample if it exceeds this number of deviations of the noise.
_STANDS_DEVIATIONS = 6.0
# It must also exceed this share of the usual height of peaks.
_STANDS_SHARE = 0.05
# Pixels nearer to a particle than this multiple of the reach of its image belong to that image.
_BESIDE = 1.4
# The flanks of a particle extend this multiple of its height around the high part.
_AROUND = 0.25
_EIGHT = np.ones((3, 3))
_DEVIATION_OF_MEDIAN = 1.4826


class FoundParticle(NamedTuple):
    """A particle in an image: place of its centre, its radius, and their standard errors [m].

    residual: root mean square residual of the fit, as a share of the height. is_cluster: whether it exceeds that of
    spheres. time: time at which the line through its centre was taken, as a share of the image, 0 to 1.
    """

    x_m: float
    y_m: float
    radius_m: float
    x_error_m: float
    y_error_m: float
    radius_error_m: float
    residual: float
    is_cluster: bool
    time: float


def sphere_m(tip: TipShape, radius_m: float, distance_m: Array) -> Array:
    """Return the height of the apex over a sphere [m] at these distances from its centre, as `ride_height_m`."""
    both = tip.radius_m + radius_m
    cap = radius_m - tip.radius_m + np.sqrt(np.maximum(both * both - distance_m * distance_m, 0.0))
    cone = np.maximum(radius_m - tip.radius_m + (both / tip.cos_cone - distance_m) / tip.tan_cone, 0.0)
    return np.where(distance_m <= both * tip.cos_cone, cap, cone)


def flattened(height_m: Array) -> tuple[Array, float]:
    """Return an image whose lines are level at 0 [m] beside the particles, and the standard deviation of its noise [m].

    A straight line is subtracted from each row, fitted to the part that does not exceed the noise.
    """
    rows, columns = height_m.shape
    level = height_m - np.median(height_m, axis=1, keepdims=True)
    x = np.arange(columns, dtype=np.float64)
    noise = 0.0
    for _ in range(5):
        ground = level[level <= np.median(level)]
        noise = _DEVIATION_OF_MEDIAN * float(np.median(np.abs(ground - np.median(level))))
        low = level <= np.median(level) + max(_DEVIATIONS * noise, 1e-13)
        for row in range(rows):
            at = x[low[row]]
            if len(at) < max(3, columns // 8):
                continue
            values = level[row, low[row]]
            middle, mean = float(at.mean()), float(values.mean())
            spread = float(np.sum((at - middle) ** 2))
            slope = float(np.sum((at - middle) * (values - mean))) / spread if spread > 0.0 else 0.0
            level[row] -= mean + slope * (x - middle)
    return level, noise


def find_particles(
    height_m: npt.ArrayLike, step_x_m: float, step_y_m: float, tip: TipShape, middle: tuple[float, float] = (0.0, 0.0)
) -> list[FoundParticle]:
    """Return the particles in an image, from left to right.

    Args:
        height_m: Heights [m], shape (rows, columns); y rises with the row. Values that are not finite are ignored.
        step_x_m: Width of a pixel [m].
        step_y_m: Depth of a pixel [m].
        tip: The tip that took the image.
        middle: The place of the middle of the image [m].

    Raises:
        ValueError: The image has fewer than 3 rows or columns, or a pixel has no size.
    """
    heights = np.array(height_m, np.float64)
    if heights.ndim != 2 or min(heights.shape) < 3:
        raise ValueError(f"an image has at least 3 rows and columns, not the shape {heights.shape}")
    if not (step_x_m > 0.0 and step_y_m > 0.0):
        raise ValueError(f"pixels of {step_x_m:g} x {step_y_m:g} m have no size")
    is_finite = np.isfinite(heights)
    if not is_finite.any():
        return []
    heights[~is_finite] = np.median(heights[is_finite])
    level, noise = flattened(heights)
    rows, columns = heights.shape
    x = middle[0] + (np.arange(columns) - 0.5 * (columns - 1)) * step_x_m
    y = middle[1] + (np.arange(rows) - 0.5 * (rows - 1)) * step_y_m
    particles: list[FoundParticle] = []
    for pixels, tops in _groups(level, noise, step_x_m, step_y_m):
        particles += _fitted(level, pixels & is_finite, tops, x, y, noise, tip)
    return sorted(particles, key=lambda one: (one.x_m, one.y_m))


def fixed_places(
    height_m: npt.ArrayLike,
    step_x_m: float,
    step_y_m: float,
    particles: list[FoundParticle],
    reach_m: float,
    middle: tuple[float, float] = (0.0, 0.0),
) -> list[tuple[float, float]]:
    """Return thinned-out places of objects in an image that are no particles, such as the edges of steps.

    Args:
        height_m: Heights, as for `find_particles`.
        step_x_m: Width of a pixel [m].
        step_y_m: Depth of a pixel [m].
        particles: The particles of the image.
        reach_m: Radius of the image of a particle [m].
        middle: The place of the middle of the image [m].
    """
    heights = np.array(height_m, np.float64)
    is_finite = np.isfinite(heights)
    if not particles or not is_finite.any():
        return []
    heights[~is_finite] = np.median(heights[is_finite])
    level, noise = flattened(heights)
    usual = 2.0 * float(np.median([one.radius_m for one in particles]))
    rows, columns = level.shape
    x = middle[0] + (np.arange(columns) - 0.5 * (columns - 1)) * step_x_m
    y = middle[1] + (np.arange(rows) - 0.5 * (rows - 1)) * step_y_m
    stands = is_finite & (ndimage.median_filter(level, 3) > max(_STANDS_DEVIATIONS * noise, _STANDS_SHARE * usual))
    for one in particles:
        stands &= np.hypot(x[None, :] - one.x_m, y[:, None] - one.y_m) > _BESIDE * reach_m
    places: list[tuple[float, float]] = []
    for row, column in np.argwhere(stands).tolist():
        place = (float(x[column]), float(y[row]))
        if all(math.dist(place, other) > 0.5 * usual for other in places):
            places.append(place)
    return places


def _groups(level: Array, noise: float, step_x_m: float, step_y_m: float) -> list[tuple[Mask, list[tuple[int, int]]]]:
    """Return for each group of peaks with joined flanks a mask of its pixels and surroundings, and its tops."""
    above = ndimage.binary_opening(level > max(_DEVIATIONS * noise, 1e-12))
    labels, count = ndimage.label(above)
    if count == 0:
        return []
    heights = np.asarray(ndimage.maximum(level, labels, range(1, count + 1)))
    high = heights[heights > 5.0 * noise]
    if len(high) == 0:
        return []
    usual = float(np.median(high))
    mask = level > max(_DEVIATIONS * noise, _SHARE * usual)
    smooth = ndimage.gaussian_filter(level, 1.0)
    apart = _LEAST_APART * 0.5 * usual
    size = (2 * math.ceil(apart / step_y_m) + 1, 2 * math.ceil(apart / step_x_m) + 1)
    tops, number = ndimage.label((smooth == ndimage.maximum_filter(smooth, size)) & mask, _EIGHT)
    places = [(round(row), round(column)) for row, column in ndimage.center_of_mass(tops, tops, range(1, number + 1))]
    groups, _ = ndimage.label(mask, _EIGHT)
    # The flanks below the mask determine the place of a particle best.
    around = (2 * math.ceil(_AROUND * usual / step_y_m) + 1, 2 * math.ceil(_AROUND * usual / step_x_m) + 1)
    result = []
    for group in sorted({int(groups[place]) for place in places} - {0}):
        pixels = ndimage.binary_dilation(groups == group, np.ones(around)) & ((groups == 0) | (groups == group))
        result.append((pixels, [place for place in places if groups[place] == group]))
    return result


def _fitted(
    level: Array, pixels: Mask, tops: list[tuple[int, int]], x: Array, y: Array, noise: float, tip: TipShape
) -> list[FoundParticle]:
    """Return the spheres of a group of peaks, fitted together; empty if there are too few pixels."""
    if int(np.count_nonzero(pixels)) < max(_FEWEST_PIXELS, 3 * len(tops)):
        return []
    row, column = np.nonzero(pixels)
    heights, at_x, at_y = level[row, column], x[column], y[row]
    scale = 0.5 * float(heights.max())
    start = [value for r, c in tops for value in (x[c], y[r], scale)]

    def left(parameters: Array) -> Array:
        spheres = parameters.reshape(-1, 3) * scale
        seen = [sphere_m(tip, abs(r), np.hypot(at_x - p, at_y - q)) for p, q, r in spheres.tolist()]
        return np.asarray(np.max(seen, axis=0) - heights) / scale

    fit = optimize.least_squares(left, np.array(start) / scale, method="lm")
    residual = 0.5 * math.sqrt(float(np.mean(fit.fun**2)))
    variance = max(float(np.sum(fit.fun**2)) / max(len(heights) - len(start), 1), (noise / scale) ** 2)
    covariance = np.linalg.pinv(fit.jac.T @ fit.jac) * variance
    errors = np.sqrt(np.maximum(np.diag(covariance), 0.0)).reshape(-1, 3) * scale
    kind = residual > _CLUSTER + 0.5 * noise / scale
    fits = []
    for (p, q, r), (p_error, q_error, r_error) in zip(
        (fit.x.reshape(-1, 3) * scale).tolist(), errors.tolist(), strict=True
    ):
        when = min(max((q - float(y[0])) / float(y[-1] - y[0]), 0.0), 1.0)
        fits.append(FoundParticle(p, q, abs(r), p_error, q_error, r_error, residual, kind, when))
    return fits
