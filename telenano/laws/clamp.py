"""Force clamp of the slave: the tip presses no harder than the hand does, by the last signal, and a margin.

    x_s' <= (max(F_m, 0) + F_0 - F_s) / B_g   at the hand's scale

towards the sample; away from it nothing is limited. It is a local force servo to F_m(t - T), closed by the instrument
with the force that it measures, so no loop of it passes the link. What it costs: where the hand's own arm relaxes, the
force follows, and the positions of hand and tip part. `passivity`, `model_mediated` and `wave` have it in their own
slave half, because they count what it refuses; the others get it here, behind theirs.
"""

from typing import NamedTuple

from telenano.extend.laws import PortSignal, SlaveReference, TipMeasurement
from telenano.numerics.compiler import compiled

# the margin of a clamp that is off [N]
NO_LIMIT_N = 1e9


class ClampParams(NamedTuple):
    """Whether it acts, and on what: reach_m_per_n, way of the base in a period for a newton at the hand [m/N]."""

    enabled: bool
    force_scale: float
    reach_m_per_n: float
    margin_n: float


@compiled
def clamped(params: ClampParams, wanted: SlaveReference, signal: PortSignal, tip: TipMeasurement) -> SlaveReference:
    """Return the reference of the base that the clamp lets through in a period."""
    if not (params.enabled and tip.following and signal.active):
        return wanted
    allowed = max(params.force_scale * signal.force_n, 0.0) + params.margin_n - params.force_scale * tip.force_n
    most = tip.base_position_m + tip.outstanding_m + params.reach_m_per_n * allowed
    return SlaveReference(min(wanted.position_m, most), wanted.active)
