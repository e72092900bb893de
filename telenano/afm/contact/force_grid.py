"""F(h) on an even grid of cubics, for a dynamic model that evaluates it ten million times a second.

Every cell is the cubic that has the force and the gradient of `branch_force` at its two ends; its largest error is
measured against `branch_force` when the grid is built. Above the grid the van der Waals force falls with 1/h^2; below
it the force continues along its tangent. `Passages` holds the distances at which the tip changes its branch, with the
jump of the force there.
"""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from telenano.afm.contact.tip_sample import TipSample, branch_force
from telenano.numerics.compiler import always_compiled, compiled

_CELL_M = 5e-12
_DEEPEST_M = 5e-9
_PROBES = (0.25, 0.5, 0.75)


class Passages(NamedTuple):
    """Distances at which the tip changes its branch [m], and the jump of the force [N] at each."""

    onset_m: float  # contact begins
    onset_n: float
    onset_n_per_m: float  # jump of the gradient there: Eq. 5 falls where contact rises
    end_m: float  # contact ends
    end_n: float
    end_n_per_m: float  # set to 0 at a fold, where it is infinite
    forms_m: float  # meniscus forms; -infinity where there is none
    forms_n: float
    breaks_m: float  # meniscus breaks; -infinity where there is none
    breaks_n: float


class ForceGrid(NamedTuple):
    """Cubics of shape (4, cells, 4), first index 2 contact + meniscus.

    The last index is the power of the position in the cell, which runs from 0 to 1; coefficients are in N.
    """

    start_m: float
    end_m: float
    cells_per_m: float
    attraction_n_m2: float  # H R / 6
    cubics: npt.NDArray[np.float64]
    error_n: float  # largest measured error against `branch_force`


@always_compiled
def grid_force(
    cubics: npt.NDArray[np.float64], start_m: float, cells_per_m: float, attraction_n_m2: float, h: float, b: int
) -> float:
    """Return F [N] at h [m] on branch b = 2 contact + meniscus; NaN if h is NaN."""
    place = (h - start_m) * cells_per_m
    # `not <` also catches NaN, which compiled code would otherwise use as an index anywhere in memory.
    if not place < cubics.shape[1]:
        return -attraction_n_m2 / (h * h)
    if place < 0.0:
        return float(cubics[b, 0, 0] + place * cubics[b, 0, 1])
    i = int(place)
    t = place - i
    return float(cubics[b, i, 0] + t * (cubics[b, i, 1] + t * (cubics[b, i, 2] + t * cubics[b, i, 3])))


@always_compiled
def grid_slopes(
    cubics: npt.NDArray[np.float64], start_m: float, cells_per_m: float, attraction_n_m2: float, h: float, b: int
) -> tuple[float, float]:
    """Return dF/dh [N/m] and d2F/dh2 [N/m^2] at h [m] on branch b = 2 contact + meniscus."""
    place = (h - start_m) * cells_per_m
    if not place < cubics.shape[1]:
        steep = 2.0 * attraction_n_m2 / (h * h * h)
        return steep, -3.0 * steep / h
    if place < 0.0:
        return float(cubics[b, 0, 1]) * cells_per_m, 0.0
    i = int(place)
    t = place - i
    slope = cubics[b, i, 1] + t * (2.0 * cubics[b, i, 2] + 3.0 * t * cubics[b, i, 3])
    return float(slope) * cells_per_m, float(2.0 * cubics[b, i, 2] + 6.0 * t * cubics[b, i, 3]) * cells_per_m**2


@always_compiled
def passed(passages: Passages, h: float, contact: bool, meniscus: bool) -> tuple[bool, bool]:
    """Return the flags (contact, meniscus) after a tip that had the flags given has moved to h [m].

    These are the passages of `cantilever`, without its equilibria.
    """
    touches = h <= passages.end_m if contact else h < passages.onset_m
    return touches, h <= passages.breaks_m if meniscus else h <= passages.forms_m


@compiled
def _fill(tip: TipSample, start_m: float, high_m: float, b: int, cubics: npt.NDArray[np.float64]) -> float:
    """Fill the cells of branch b up to high_m [m] in place; return their largest error [N]."""
    contact, meniscus = b >= 2, b % 2 == 1
    greatest = 0.0
    for i in range(cubics.shape[1]):
        near = start_m + i * _CELL_M
        if near > high_m or (not contact and near < 0.5 * tip.contact_onset_m):
            # The tip is never here on this branch.
            continue
        f0, g0 = branch_force(tip, near, contact, meniscus)
        d0 = g0 * _CELL_M
        if near + _CELL_M > high_m:
            c2, c3 = 0.0, 0.0
        else:
            f1, g1 = branch_force(tip, near + _CELL_M, contact, meniscus)
            d1 = g1 * _CELL_M
            c2, c3 = 3.0 * (f1 - f0) - 2.0 * d0 - d1, 2.0 * (f0 - f1) + d0 + d1
        cubics[b, i, 0], cubics[b, i, 1], cubics[b, i, 2], cubics[b, i, 3] = f0, d0, c2, c3
        for t in _PROBES:
            h = near + t * _CELL_M
            if h <= high_m and (contact or h >= tip.contact_onset_m):
                exact = branch_force(tip, h, contact, meniscus)[0]
                greatest = max(greatest, abs(f0 + t * (d0 + t * (c2 + t * c3)) - exact))
    return greatest


def build_force_grid(tip: TipSample, beyond_m: float) -> tuple[ForceGrid, Passages]:
    """Return the force grid and its passages.

    The grid begins at the end of the contact table, at most 5 nm below the contact distance, and reaches beyond_m [m].

    Raises:
        ValueError: The reading is as_printed, whose meniscus pulls on a free tip at any distance.
    """
    if tip.as_printed:
        raise ValueError("mode as_printed has no dynamic model: its meniscus pulls at any distance; take consistent")
    start = tip.contact_distance_m - min(tip.table.end_m, _DEEPEST_M)
    cubics = np.zeros((4, math.ceil((beyond_m - start) / _CELL_M), 4))
    error = 0.0
    for b in range(4):
        if b % 2 == 0 or tip.has_meniscus:
            error = max(error, _fill(tip, start, tip.contact_end_m if b >= 2 else math.inf, b, cubics))
    end = start + cubics.shape[1] * _CELL_M
    grid = ForceGrid(start, end, 1.0 / _CELL_M, tip.hamaker_j * tip.radius_m / 6.0, cubics, error)
    return grid, _passages(tip)


def _passages(tip: TipSample) -> Passages:
    def jump(h: float, contact: bool, meniscus: bool, touches: bool, wet: bool) -> float:
        return branch_force(tip, h, touches, wet)[0] - branch_force(tip, h, contact, meniscus)[0]

    onset, end = tip.contact_onset_m, tip.contact_end_m
    onset_n, end_n = jump(onset, False, False, True, False), jump(end, True, False, False, False)
    kink = branch_force(tip, onset, True, False)[1] - branch_force(tip, onset, False, False)[1]
    back = -kink if end == onset else 0.0
    if not tip.has_meniscus:
        return Passages(onset, onset_n, kink, end, end_n, back, -math.inf, 0.0, -math.inf, 0.0)
    forms, breaks = tip.meniscus_width_m, tip.meniscus_break_m
    forms_n, breaks_n = jump(forms, False, False, False, True), jump(breaks, False, True, False, False)
    return Passages(onset, onset_n, kink, end, end_n, back, forms, forms_n, breaks, breaks_n)
