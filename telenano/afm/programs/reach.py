"""Checks that the base, within its limits, reaches a surface of known heights and comes clear of it again.

A tip without a force touches a surface of height z when its base is at L - z, with L the rest distance. A real
instrument does not know the heights in advance: there an approach ends after a time limit (`approach_limit_s`).
"""

import math
from typing import NamedTuple

import numpy as np

from telenano.afm.sample.surface import Surface
from telenano.extend.instruments import SafetyParams
from telenano.extend.programs import Span
from telenano.extend.stage import Place

_RETRACT_FURTHER = (
    "Start the rig with afm_node.safety.retract_position_m={base:g} or less, and afm_node.safety.base_min_m no higher"
    " than that"
)


class Reach(NamedTuple):
    """A surface as the tip sees it, None for a plane at height 0; rest distance L [m]; limits of the base.

    above_m: height of a layer above the surface [m], which may be at any place.
    """

    surface: Surface | None
    rest_m: float
    limits: SafetyParams
    above_m: float = 0.0

    def within(self, centre: Place, width_m: float, depth_m: float) -> Span:
        """Return the lowest and highest point [m] of a rectangle around a place, with the layer."""
        if self.surface is None:
            return Span(0.0, self.above_m)
        s, (rows, columns) = self.surface, self.surface.height_m.shape
        xs = _pixels(centre.x_m, width_m, s.step_x_m, columns)
        ys = _pixels(centre.y_m, depth_m, s.step_y_m, rows)
        part = s.height_m[ys, xs]
        return Span(float(part.min()), float(part.max()) + self.above_m)

    def along(self, begin: Place, end: Place) -> Span:
        """Return the lowest and highest point [m] of a straight line and the pixels beside it, with the layer."""
        if self.surface is None:
            return Span(0.0, self.above_m)
        s, (rows, columns) = self.surface, self.surface.height_m.shape
        way = math.hypot((end.x_m - begin.x_m) / s.step_x_m, (end.y_m - begin.y_m) / s.step_y_m)
        # The surface is level beyond the map, so more points than twice its diagonal find nothing new.
        shares = np.linspace(0.0, 1.0, min(math.ceil(2.0 * way), 4 * (rows + columns)) + 2)
        x = (begin.x_m + shares * (end.x_m - begin.x_m) + 0.5 * s.width_m) / s.step_x_m - 0.5
        y = (begin.y_m + shares * (end.y_m - begin.y_m) + 0.5 * s.depth_m) / s.step_y_m - 0.5
        x, y = np.clip(x, 0.0, columns - 1.0), np.clip(y, 0.0, rows - 1.0)
        seen = [
            s.height_m[row.astype(int), column.astype(int)]
            for row in (np.floor(y), np.ceil(y))
            for column in (np.floor(x), np.ceil(x))
        ]
        return Span(float(np.min(seen)), float(np.max(seen)) + self.above_m)

    def depth_fault(self, span: Span, press_m: float = 0.0) -> str:
        """Return why the base cannot bring the tip to the lowest point and press_m [m] further; empty if it can."""
        needed, most = self.rest_m - span.low_m + press_m, self.limits.base_max_m
        if needed <= most:
            return ""
        return (
            f"the surface is out of reach: its lowest point, {span.low_m:.3g} m, needs the base at {needed:.3g} m,"
            f" {needed - most:.3g} m beyond safety.base_max_m = {most:g} m. Start the rig with"
            f" afm_node.safety.base_max_m={_outwards(needed):g} or more, or choose a part that is not so deep"
        )

    def clearance_fault(self, span: Span, base_m: float, remedy: str, lift_m: float = 0.0) -> str:
        """Return why a tip with its base at base_m [m] hits the highest point; empty if it is clear of it.

        Args:
            span: The heights of the region that the tip crosses [m].
            base_m: The base [m].
            remedy: A sentence into which the base that is clear is put, as {base:g} [m].
            lift_m: Distance by which the tip swings below its mean [m].
        """
        needed = self.rest_m - span.high_m - lift_m
        if base_m <= needed:
            return ""
        return (
            f"the surface is too high: with the base at {base_m:.3g} m the tip is not clear of its highest point,"
            f" {span.high_m:.3g} m, by {base_m - needed:.3g} m. {remedy.format(base=-_outwards(-needed))}"
        )

    def retracted_fault(self, span: Span, lift_m: float = 0.0) -> str:
        """Return why a retracted tip hits the highest point; empty if it is clear of it."""
        return self.clearance_fault(span, self.limits.retract_position_m, _RETRACT_FURTHER, lift_m)

    def hand_fault(self, place: Place) -> str:
        """Return why a hand cannot use the tip at a place of the surface; empty if it can."""
        here = self.along(place, place)
        return self.depth_fault(here) or self.retracted_fault(here)


def _pixels(middle_m: float, length_m: float, step_m: float, count: int) -> slice:
    """Return the pixels of one side of the map that cover a length around middle_m [m]; 0 is the middle of the side."""
    first, last = (
        min(max((middle_m + way * length_m) / step_m + 0.5 * count - 0.5, 0.0), count - 1.0) for way in (-0.5, 0.5)
    )
    return slice(math.floor(first), math.ceil(last) + 1)


def _outwards(base_m: float) -> float:
    """Return the base rounded up to whole nanometres [m], towards the sample."""
    return round(math.ceil(base_m * 1e9 - 1e-6) * 1e-9, 9)
