"""Force clamp of the slave: the tip presses no harder than the hand does, by the last signal, and a margin.

    x_s' <= (max(F_m, 0) + F_0 - F_s) / B_g   at the hand's scale

towards the sample; motion away from it is not limited. The clamp is a local force servo of F_m(t - T), closed at the
instrument with the measured force, so its loop does not pass through the link. The price: if the operator's arm
relaxes, the force follows, and the positions of hand and tip separate. `passivity`, `model_mediated` and `wave` have
the clamp in their own slave half, because they account for the motion that it refuses; for the other laws it is applied
here, after their slave half.
"""

from typing import NamedTuple

from telenano.extend.laws import PortSignal, SlaveReference, TipMeasurement
from telenano.numerics.compiler import compiled

# Margin of a clamp that is switched off [N].
NO_LIMIT_N = 1e9


class ClampParams(NamedTuple):
    """Constants of the clamp: reach_m_per_n, motion of the base in a period per newton at the hand's scale [m/N]."""

    enabled: bool
    force_scale: float
    reach_m_per_n: float
    margin_n: float


@compiled
def clamped(params: ClampParams, wanted: SlaveReference, signal: PortSignal, tip: TipMeasurement) -> SlaveReference:
    """Return the wanted reference of the base, limited to the motion that the clamp allows in a period."""
    if not (params.enabled and tip.following and signal.active):
        return wanted
    allowed = max(params.force_scale * signal.force_n, 0.0) + params.margin_n - params.force_scale * tip.force_n
    most = tip.base_position_m + tip.outstanding_m + params.reach_m_per_n * allowed
    return SlaveReference(min(wanted.position_m, most), wanted.active)
