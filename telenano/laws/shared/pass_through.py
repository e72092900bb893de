"""The slave half of laws that need none: the reference is passed on to the base, the measured force is sent back."""

from typing import NamedTuple

from telenano.laws.law import PortSignal, SlaveReference, TipMeasurement, tip_signal
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


@compiled
def slave_send(params: object, state: SlaveState, tip: TipMeasurement, dt: float) -> tuple[SlaveState, PortSignal]:
    """Send the measured state of the tip back."""
    return state, tip_signal(tip, tip.base_position_m, tip.force_n)
