"""The slave half of laws without steps of their own: it passes the reference to the base, and sends the force back."""

from typing import NamedTuple

from telenano.extend.laws import PortSignal, SlaveReference, TipMeasurement
from telenano.numerics.compiler import compiled


class SlaveState(NamedTuple):
    """The last reference passed to the base [m]."""

    position_m: float


@compiled
def slave_start(params: object, tip: TipMeasurement) -> SlaveState:
    """Start at the position of the base."""
    return SlaveState(tip.base_position_m)


@compiled
def slave_receive(
    params: object, state: SlaveState, signal: PortSignal, tip: TipMeasurement, dt: float
) -> tuple[SlaveState, SlaveReference]:
    """Pass the reference to the base."""
    return SlaveState(signal.position_m), SlaveReference(signal.position_m, True)
