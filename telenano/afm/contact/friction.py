"""Lateral force on a tip in contact: the slope of the surface, and friction of Amontons with adhesion.

On a slope theta, with the load L of the cantilever downwards and the adhesion A along the normal, a tip that is pulled
up or down the slope needs the horizontal force

    T = (L sin theta +- mu (L cos theta + A)) / (cos theta -+ mu sin theta)

(D. F. Ogletree, R. W. Carpick, M. Salmeron, Rev. Sci. Instrum. 67 (1996) 3298, Eq. 7: upper signs uphill). The slope
alone needs L tan theta; the rest is the limit of friction. Below the limit the tip sticks and the cantilever bends
sideways with the stage; at the limit the tip slips. A reversal is therefore a slanted line in the friction loop.
"""

import math
from typing import NamedTuple

import numpy as np

from telenano.afm.contact.tip_sample import TipSample, branch_force
from telenano.numerics.compiler import compiled

# Lower bound of cos theta - mu sin theta: a tip on a steeper slope would jam.
_LEAST_SHARE = 0.05
_PROBES = 4000


class FrictionParams(NamedTuple):
    """Coefficient mu; adhesion A [N], >= 0; lateral stiffness at the tip [N/m]; height of the tip [m]."""

    coefficient: float
    adhesion_n: float
    stiffness_n_per_m: float
    tip_height_m: float


class FrictionState(NamedTuple):
    """Distance by which the stage leads the tip, which friction holds back [m]."""

    ahead_x_m: float
    ahead_y_m: float


@compiled
def friction_limit_n(params: FrictionParams, load_n: float, slope: float) -> float:
    """Return the friction [N] at which a tip slips that is pulled up a slope tan theta (negative: down the slope).

    This is T - L tan theta of the module, mu (L / cos theta + A) / (cos theta - mu sin theta); 0 where the cantilever
    pulls (negative load [N]) harder than the adhesion holds.
    """
    cosine = 1.0 / math.sqrt(1.0 + slope * slope)
    share = max(cosine - params.coefficient * slope * cosine, _LEAST_SHARE)
    return params.coefficient * max(load_n / cosine + params.adhesion_n, 0.0) / share


@compiled
def friction_step(
    params: FrictionParams,
    state: FrictionState,
    moved_x_m: float,
    moved_y_m: float,
    load_n: float,
    slope_x: float,
    slope_y: float,
    in_contact: bool,
) -> tuple[FrictionState, float, float]:
    """Return the state after a motion of the stage, and the force of the sample on the tip in x and y [N].

    Args:
        params: The parameters of friction.
        state: The state before the motion.
        moved_x_m: The motion of the stage in x [m].
        moved_y_m: The motion of the stage in y [m].
        load_n: The force of the cantilever [N], positive where it presses.
        slope_x: The slope dz/dx of the surface that the tip sees.
        slope_y: The slope dz/dy of the surface that the tip sees.
        in_contact: Whether the tip is in contact.
    """
    if not in_contact:
        return FrictionState(0.0, 0.0), 0.0, 0.0
    x, y = state.ahead_x_m + moved_x_m, state.ahead_y_m + moved_y_m
    k = params.stiffness_n_per_m
    # math.hypot would round differently in Python and in compiled code.
    ahead = math.sqrt(x * x + y * y)
    if ahead > 0.0:
        limit = friction_limit_n(params, load_n, (slope_x * x + slope_y * y) / ahead)
        if k * ahead > limit:
            share = limit / (k * ahead)
            x, y = share * x, share * y
    # The load adds a lateral part down the slope.
    return FrictionState(x, y), 0.0 - k * x - load_n * slope_x, 0.0 - k * y - load_n * slope_y


def adhesion_n(tip: TipSample) -> float:
    """Return the strongest attraction in contact [N], >= 0, with the meniscus where there is one: A of friction."""
    table = tip.table
    depths = np.linspace(table.cohesive_end_m, table.start_m + 2e-9, _PROBES)
    forces = [branch_force(tip, tip.contact_distance_m - float(depth), True, tip.has_meniscus)[0] for depth in depths]
    return max(0.0, -min(forces))
