"""Error-bounded table of the Maugis-Dugdale force against indentation, for the innermost loop.

The contact is tabulated in u = sqrt(delta - delta_start); delta_start is the indentation at which it ends. The force is
smooth in u there, both at a fold (square root of delta) and at a = 0, and proportional to u^3 far inside. Near lambda =
0.938, where the fold enters the contact, the curve has structure at every small scale of u; so the cells are equal
within an octave of u and halve from one octave to the next. The force is cubic Hermite between nodes whose value and
slope come from the direct solution; the stiffness is linear between its own nodes, because near u = 0 the force has too
few digits to differentiate. The lookup finds its cell by the binary exponent of u. The cohesive branch is closed form.

Outside the table: below the end of the stable branch the force is zero (surfaces apart). Above the last tabulated
indentation it continues along its tangent, which is continuous, monotone and softer than the contact. The last point
lies beyond every force that the device may meet (`build_contact_table`), so the force limit trips long before it.
"""

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from telenano.afm.contact.maugis_dugdale import (
    MaugisDugdale,
    angle_at,
    angle_between,
    cohesive_at,
    cohesive_end,
    contact_at,
    end_angle,
)
from telenano.afm.contact.maugis_dugdale import indentation_m as indentation_under
from telenano.numerics.compiler import compiled

FORCE_TOLERANCE = 1e-6  # of the force, or of FORCE_FLOOR pi w R where the force passes through zero
STIFFNESS_TOLERANCE = 1e-4  # of the stiffness, or of its unit where that is larger
FORCE_FLOOR = 1e-3
# Errors are measured inside every cell at these fractions and must leave a factor 2 for the points between.
_PROBES = (0.2, 0.5, 0.8)
_MARGIN = 0.5
# The innermost cell ends at 2^-18 of the range of u, 1e-11 of the range of delta: far below any motion, while delta
# still has the digits that its distance from the end of the contact needs.
_OCTAVES = 18
_FIRST_CELLS = 32  # per octave
_LAST_CELLS = 1024


class ContactTable(NamedTuple):
    """Tabulated contact.

    `nodes` has shape (octaves + 1, cells + 1, 3): force [N], its slope in u times the cell width [N], and stiffness
    [N/m], at the u that divide the octave from span 2^-k-1 to span 2^-k into equal cells. The last row is the single
    cell next to u = 0, where the stiffness is held constant.
    """

    contact: MaugisDugdale
    cohesive_end_m: float  # smallest indentation of the stable branch
    start_m: float  # smallest indentation of the contact (a = 0 or the fold)
    end_m: float  # largest tabulated indentation
    end_force_n: float
    end_stiffness_n_per_m: float
    span: float  # largest u, sqrt(m)
    nodes: npt.NDArray[np.float64]
    force_error: float  # largest measured relative error against the direct solution
    stiffness_error: float

    def force(self, indentation_m: float) -> tuple[float, float]:
        """Return force [N] and stiffness [N/m] at an indentation [m], as `table_force`."""
        return table_force(self, indentation_m)


@compiled
def table_force(table: ContactTable, indentation_m: float) -> tuple[float, float]:
    """Force [N] and stiffness dF/d delta [N/m] at the indentation delta = a0 - h [m], in constant time.

    At a fold the stiffness is infinite; in the innermost cell it is held at the value of that cell's outer end.
    """
    if indentation_m >= table.start_m:
        if indentation_m >= table.end_m:
            rest = indentation_m - table.end_m
            return table.end_force_n + table.end_stiffness_n_per_m * rest, table.end_stiffness_n_per_m
        return _hermite(table, math.sqrt(indentation_m - table.start_m) / table.span)
    if indentation_m >= table.cohesive_end_m:
        unit_n, unit_m = table.contact.force_unit_n, table.contact.indentation_unit_m
        force, stiffness = cohesive_at(table.contact.transition, indentation_m / unit_m)
        return force * unit_n, stiffness * unit_n / unit_m
    return 0.0, 0.0


@compiled
def _hermite(table: ContactTable, x: float) -> tuple[float, float]:
    """Force and stiffness at x = u / span in [0, 1)."""
    nodes = table.nodes
    cells = nodes.shape[1] - 1
    mantissa, exponent = math.frexp(x)
    k = -exponent if x > 0.0 else _OCTAVES
    if k < 0:  # delta is so close to the end of the table that u / span rounds to one
        k, i, t = 0, cells - 1, 1.0
    elif k < _OCTAVES:
        place = (2.0 * mantissa - 1.0) * cells
        i = int(place)
        t = place - i
    else:
        k, i, t = _OCTAVES, 0, math.ldexp(x, _OCTAVES)
    # The entries are converted to Python floats: arithmetic with NumPy scalars takes three times as long.
    f0, d0, s0 = float(nodes[k, i, 0]), float(nodes[k, i, 1]), float(nodes[k, i, 2])
    f1, d1, s1 = float(nodes[k, i + 1, 0]), float(nodes[k, i + 1, 1]), float(nodes[k, i + 1, 2])
    c2 = 3.0 * (f1 - f0) - 2.0 * d0 - d1
    c3 = 2.0 * (f0 - f1) + d0 + d1
    return f0 + t * (d0 + t * (c2 + t * c3)), s0 + t * (s1 - s0)


@lru_cache(maxsize=16)
def build_contact_table(contact: MaugisDugdale, largest_force_n: float) -> ContactTable:
    """Tabulate a contact up to the indentation at which its force is largest_force_n; the result is cached.

    Cells are halved until the errors measured against the direct solution inside every cell stay below
    `FORCE_TOLERANCE` and `STIFFNESS_TOLERANCE`.

    Args:
        contact: The contact to tabulate.
        largest_force_n: The largest force of the table [N], > 0.

    Raises:
        ValueError: The force is not positive, or the tolerance cannot be met.
    """
    if not (math.isfinite(largest_force_n) and largest_force_n > 0.0):
        raise ValueError(f"largest force of the contact table = {largest_force_n} N must be finite and > 0 N")
    end = end_angle(contact.transition)
    start = contact_at(contact.transition, end).indentation
    largest = indentation_under(contact, largest_force_n) / contact.indentation_unit_m
    span = math.sqrt(largest - start)
    cells = _FIRST_CELLS
    while cells <= _LAST_CELLS:
        table = _tabulate(contact, end, start, span, cells)
        force_error, stiffness_error = _measured_errors(table, end, start, span, cells)
        if _is_fine_enough(force_error, stiffness_error):
            return table._replace(force_error=force_error, stiffness_error=stiffness_error)
        cells *= 2
    raise ValueError(
        f"contact table for lambda = {contact.transition} misses its tolerance: relative error of the force "
        f"{force_error:.1e} (allowed {FORCE_TOLERANCE}), of the stiffness {stiffness_error:.1e} "
        f"(allowed {STIFFNESS_TOLERANCE})"
    )


def _tabulate(contact: MaugisDugdale, end: float, start: float, span: float, cells: int) -> ContactTable:
    unit_n, unit_m = contact.force_unit_n, contact.indentation_unit_m
    fractions = np.arange(cells + 1) / cells
    widths = np.append(0.5 / cells * 0.5 ** np.arange(_OCTAVES), 0.5**_OCTAVES)
    x = 0.5 ** np.arange(_OCTAVES + 1)[:, None] * 0.5 * (1.0 + fractions)
    x[_OCTAVES] = np.where(fractions == 0.0, 0.0, 0.5**_OCTAVES)
    exact = _direct(contact.transition, end, start, span * x.ravel()).reshape(*x.shape, 3)
    exact[_OCTAVES, 0, 1:] = exact[_OCTAVES, 1, 1:]  # at a fold the stiffness at u = 0 is infinite
    units = np.array([unit_n, unit_n * span, unit_n / unit_m])
    nodes = units * exact
    nodes[..., 1] *= widths[:, None]
    return ContactTable(
        contact=contact,
        cohesive_end_m=cohesive_end(contact.transition)[0] * unit_m,
        start_m=start * unit_m,
        end_m=(start + span**2) * unit_m,
        end_force_n=float(nodes[0, -1, 0]),
        end_stiffness_n_per_m=float(exact[0, -1, 2]) * unit_n / unit_m,
        span=span * math.sqrt(unit_m),
        nodes=nodes,
        force_error=math.inf,
        stiffness_error=math.inf,
    )


@compiled
def _direct(transition: float, end: float, start: float, u: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Force, its slope dP/du and the stiffness dP/dD at each u, nondimensional, shape (len(u), 3)."""
    exact = np.empty((u.shape[0], 3))
    greatest = u.max()
    # The first guess is an angle outside all solutions; then each solution is the guess for the next u.
    outer = 0.999 * angle_at(transition, start + greatest * greatest, end)
    s = outer
    for i in range(u.shape[0]):
        s = end if u[i] == 0.0 else angle_between(transition, start + u[i] * u[i], start, outer, end, s)
        point = contact_at(transition, s)
        stiffness = point.force_slope / min(point.indentation_slope, -1e-150)
        exact[i, 0], exact[i, 1], exact[i, 2] = point.force, 2.0 * u[i] * stiffness, stiffness
    return exact


def _measured_errors(table: ContactTable, end: float, start: float, span: float, cells: int) -> tuple[float, float]:
    """Return the largest relative errors of force and stiffness; a table that is too coarse ends the search early."""
    unit_n, unit_m = table.contact.force_unit_n, table.contact.indentation_unit_m
    inside = (np.arange(cells)[:, None] + np.array(_PROBES)).ravel() / cells
    force_error = stiffness_error = 0.0
    for octave in range(_OCTAVES + 1):
        innermost = octave == _OCTAVES
        x = 0.5**_OCTAVES * np.array(_PROBES) if innermost else 0.5**octave * 0.5 * (1.0 + inside)
        u = span * x
        exact = _direct(table.contact.transition, end, start, u)
        looked_up = _look_up(table, (start + u * u) * unit_m) / np.array([unit_n, unit_n / unit_m])
        force, stiffness = exact[:, 0], exact[:, 2]
        force_errors = np.abs(looked_up[:, 0] - force) / np.maximum(np.abs(force), FORCE_FLOOR)
        force_error = max(force_error, float(force_errors.max()))
        # The innermost cell holds its stiffness constant by definition, so only the error of its force is bounded.
        if not innermost:
            stiffness_errors = np.abs(looked_up[:, 1] - stiffness) / np.maximum(np.abs(stiffness), 1.0)
            stiffness_error = max(stiffness_error, float(stiffness_errors.max()))
        if not _is_fine_enough(force_error, stiffness_error):
            break
    return force_error, stiffness_error


def _is_fine_enough(force_error: float, stiffness_error: float) -> bool:
    return force_error <= _MARGIN * FORCE_TOLERANCE and stiffness_error <= _MARGIN * STIFFNESS_TOLERANCE


@compiled
def _look_up(table: ContactTable, indentations_m: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    entries = np.empty((indentations_m.shape[0], 2))
    for i in range(indentations_m.shape[0]):
        entries[i, 0], entries[i, 1] = table_force(table, indentations_m[i])
    return entries
