"""The slave half of laws that need none: the reference is passed on to the base, the measured force is sent back."""

from typing import NamedTuple

from services.controller.law import PortSignal, SlaveReference, TipMeasurement
from services.numerics.compiled import compiled


class SlaveState(NamedTuple):
    """The reference that was last passed on [m]."""

    position_m: float


@compiled
def measured(tip: TipMeasurement) -> PortSignal:
    """Return the signal that carries the measured state of the tip."""
    return PortSignal(
        tip.base_position_m,
        0.0,
        tip.force_n,
        0.0,
        0.0,
        tip.separation_m,
        tip.separation_valid,
        tip.in_contact,
        tip.following,
        0.0,
        0.0,
    )


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
    """Send the measured force back."""
    return state, measured(tip)
