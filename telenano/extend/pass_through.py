"""The slave half of laws that need none: the reference is passed on to the base, the measured force is sent back."""

from typing import NamedTuple

from telenano.extend.laws import PortSignal, SlaveReference, TipMeasurement
from telenano.numerics.compiler import compiled


class SlaveState(NamedTuple):
    """The reference that was last passed on [m]."""

    position_m: float


@compiled
def slave_start(params: object, tip: TipMeasurement) -> SlaveState:
    """Start at the position of the base."""
    return SlaveState(tip.base_position_m)


@compiled
def slave_receive(
    params: object, state: SlaveState, signal: PortSignal, tip: TipMeasurement, dt: float
) -> tuple[SlaveState, SlaveReference]:
    """Pass the reference on to the base."""
    return SlaveState(signal.position_m), SlaveReference(signal.position_m, True)
