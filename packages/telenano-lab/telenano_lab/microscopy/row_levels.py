"""Align the rows of an image to one level, ignoring masked features, and describe each step in words.

    aligned, steps = align_rows(heights_m, "median", above_m=2e-9)

A scan takes its lines one after another, so drift and jumps of the feedback leave them at different levels. The median,
the mean or a parabola is subtracted from each row. Particles on a flat ground would bias the level of their rows, so
points higher or lower than a threshold relative to the ground are masked and do not affect the level.
"""

import math
from typing import Annotated, Literal, NamedTuple

import numpy as np
import numpy.typing as npt
import typer

from telenano.cli import Void
from telenano.wire import ConfigError
from telenano_lab.microscopy.image_files import Image

Array = npt.NDArray[np.float64]
Method = Literal["median", "mean", "polynomial"]

# A row needs this share of its points unmasked, and at least so many.
_LEAST_SHARE, _LEAST_POINTS = 0.05, 4
# Degree of the polynomial; most programs, Gwyddion among them, use 2 for the bow of a scanner.
_DEGREE = 2
# Number of iterations in which mask and row levels are refined from each other.
_PASSES = 3

AlignOption = Annotated[
    Literal["median", "mean", "polynomial"] | None,
    typer.Option("--align-rows", help="Subtract this from each row: its median, its mean, or a parabola."),
]
AboveOption = Annotated[
    float | None,
    typer.Option(
        "--mask-above", min=0.0, metavar="NM", help="Leave out points higher than this above the ground [nm]."
    ),
]
BelowOption = Annotated[
    float | None,
    typer.Option("--mask-below", min=0.0, metavar="NM", help="Leave out points lower than this below the ground [nm]."),
]


def align_rows(
    heights: Array, method: Method, above_m: float | None = None, below_m: float | None = None
) -> tuple[Array, tuple[str, ...]]:
    """Return an image whose rows have one level, and a sentence for each step.

    With a threshold, the rows are first aligned by their medians to find the ground. The mask is then found again in
    the rows that were aligned without the masked points. A row that is mostly covered by features is mistaken for
    ground.

    Args:
        heights: The image, shape (rows, columns).
        method: Level that is subtracted from each row.
        above_m: Points higher than this above the ground are masked [m]; None for no limit.
        below_m: Points lower than this below the ground are masked [m]; None for no limit.

    Raises:
        ConfigError: The image has values that are not finite, or a row has too few unmasked points.
    """
    if heights.ndim != 2 or heights.size == 0 or not np.isfinite(heights).all():
        raise ConfigError("rows are aligned of an image whose values are all numbers")
    kept = np.ones(heights.shape, bool)
    if above_m is None and below_m is None:
        return _aligned(heights, method, kept), (f"rows aligned: {_WORDS[method]} of each row taken off",)
    # A mean or a parabola is biased by particles, a median hardly.
    aligned = _aligned(heights, "median", kept)
    for _ in range(_PASSES):
        ground = float(np.median(aligned[kept]))
        higher = np.zeros(heights.shape, bool) if above_m is None else aligned > ground + above_m
        lower = np.zeros(heights.shape, bool) if below_m is None else aligned < ground - below_m
        kept = ~(higher | lower)
        aligned = _aligned(heights, method, kept)
    steps = [] if above_m is None else [f"masked: {_share(higher)} higher than {above_m:.6g} m over the ground"]
    steps += [] if below_m is None else [f"masked: {_share(lower)} lower than {below_m:.6g} m under the ground"]
    return aligned, (*steps, f"rows aligned: {_WORDS[method]} of each row taken off, without what is masked")


_WORDS = {"median": "the median", "mean": "the mean", "polynomial": f"a polynomial of degree {_DEGREE}"}


class Levels(NamedTuple):
    """The options of the alignment: the method, and the limits of the mask [nm]."""

    method: Method | None
    above_nm: float | None
    below_nm: float | None


# A mask is of a method that uses it.
LEVEL_RULES = (Void("--mask-above, --mask-below", "from which they leave points out", unless="--align-rows"),)


def aligned_image(image: Image, method: Method | None, above_nm: float | None, below_nm: float | None) -> Image:
    """Return an image with its rows aligned as the options say, and the steps appended to its log.

    Raises:
        ConfigError: The rows cannot be aligned; the message names the option.
    """
    if method is None:
        return image
    metres = [None if each is None else 1e-9 * each for each in (above_nm, below_nm)]
    values, steps = align_rows(image.values, method, *metres)
    return image._replace(values=values, log=(*image.log, *steps))


def _share(masked: npt.NDArray[np.bool_]) -> str:
    return f"{100.0 * np.count_nonzero(masked) / masked.size:.3g} % of the points,"


def _aligned(heights: Array, method: Method, kept: npt.NDArray[np.bool_]) -> Array:
    columns = heights.shape[1]
    least = max(math.ceil(_LEAST_SHARE * columns), min(_LEAST_POINTS, columns))
    aligned = np.empty_like(heights)
    for row, (values, mask) in enumerate(zip(heights, kept, strict=True)):
        count = int(np.count_nonzero(mask))
        if count < least:
            raise ConfigError(
                f"--mask-above, --mask-below: row {row} has {count} of {columns} points that are not masked, {least}"
                " are needed: take a wider limit"
            )
        aligned[row] = values - _level_of(values, method, mask)
    return aligned


def _level_of(values: Array, method: Method, kept: npt.NDArray[np.bool_]) -> Array | float:
    """Return the level to subtract from a row; sums have one order, so every processor gives the same bits."""
    chosen = values[kept]
    if method == "median":
        return float(np.median(chosen))
    if method == "mean":
        return math.fsum(chosen.tolist()) / len(chosen)
    x = np.linspace(-1.0, 1.0, len(values))
    level = np.zeros(len(values))
    basis: list[tuple[Array, float]] = []
    for degree in range(_DEGREE + 1):
        # Gram-Schmidt orthogonalization over the unmasked points.
        form = np.ones(len(values))
        for _ in range(degree):
            form = form * x
        for other, square in basis:
            form = form - _product(form, other, kept) / square * other
        square = _product(form, form, kept)
        basis.append((form, square))
        level = level + _product(values - level, form, kept) / square * form
    return level


def _product(one: Array, other: Array, kept: npt.NDArray[np.bool_]) -> float:
    return math.fsum((one[kept] * other[kept]).tolist())
