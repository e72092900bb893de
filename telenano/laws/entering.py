"""How a tip that was withdrawn is let in to where the hand already is.

A hand that is armed beyond the surface, as after a stop in contact, asks at once for a base that presses. Whatever the
law, the base then begins with an offset, away from the sample, and goes no further than the rest point of the base
(z = 0), nor than a clearance in front of the surface that it last met. The offset is let in at the speed of the paper's
approach (Fig. 12) for as long as the force on the tip is small, and stands while it is not.

The law sees the base where it would be without the offset, so the offset is to it a sample that lies deeper by as much,
and its loop is closed while the offset shrinks. A hand that is not beyond the rest point has no offset.
"""

import math
from typing import NamedTuple

from telenano.laws.law import TipMeasurement
from telenano.numerics.compiler import compiled

# The approach of Fig. 12 for 1 N at the hand [m/s].
LET_IN_M_PER_S = 15e-9
# The offset stands while the tip is pressed or pulled with more than this force, at the hand's scale [N].
SMALL_FORCE_N = 0.1
# The pull of the water film begins within this distance of a surface [m]; a meniscus breaks at 4 nm in Table 2.
CLEARANCE_M = 5e-9


class Entry(NamedTuple):
    """The offset of the base away from the sample [m], and where it last met a surface [m]; infinite for never."""

    offset_m: float
    surface_m: float


@compiled
def entry_at_start() -> Entry:
    """Return the state before the tip has followed: no offset, no known surface."""
    return Entry(0.0, math.inf)


@compiled
def shown_tip(entry: Entry, tip: TipMeasurement) -> TipMeasurement:
    """Return a measurement as the law sees it: with the base where it would be without the offset."""
    shown_m = tip.base_position_m + entry.offset_m if tip.following else tip.base_position_m
    return TipMeasurement(
        shown_m, tip.force_n, tip.separation_m, tip.separation_valid, tip.in_contact, tip.following, tip.outstanding_m
    )


@compiled
def entry_step(entry: Entry, wanted_m: float, tip: TipMeasurement, force_scale: float, dt: float) -> Entry:
    """Return the state after dt [s], for the base that the law wants [m], and the tip as the law sees it.

    Args:
        entry: The state before.
        wanted_m: The law's reference of the base, towards the sample [m].
        tip: The newest measurement (`shown_tip`).
        force_scale: alpha_f, newtons at the hand per newton at the tip.
        dt: The time since the last step [s], >= 0.
    """
    pressed_n = force_scale * tip.force_n
    if not tip.following:
        nearest_m = min(0.0, entry.surface_m - CLEARANCE_M)
        return Entry(max(wanted_m - nearest_m, 0.0), entry.surface_m)
    surface_m = entry.surface_m
    if pressed_n > SMALL_FORCE_N:
        surface_m = tip.base_position_m - entry.offset_m
    offset_m = entry.offset_m
    if abs(pressed_n) <= SMALL_FORCE_N:
        offset_m = max(offset_m - LET_IN_M_PER_S * dt, 0.0)
    return Entry(offset_m, surface_m)
