"""Direct force reflection through a low-pass filter: a starting point for a law of your own.

    M_v x'' + B_v x' = F_m - F_f,   tau_f F_f' = alpha_f F_s(t - T_b) - F_f,   x_sr(t) = alpha_p x(t - T_f)

The operator moves a virtual mass M_v with damping B_v against the filtered force; its position, scaled by alpha_p, is
the tip's reference. Change `master_receive` first: it is where the law decides what the hand feels.
"""

import math
from typing import Annotated, NamedTuple

from pydantic import Field

from telenano.extend.laws import (
    HandSample,
    Law,
    Mass,
    MassConfig,
    MassParams,
    MasterReference,
    PortSignal,
    at_rest,
    compiled,
    is_coupled,
    let_go,
    moved,
    pass_through,
    periods_in,
    port_signal,
    rescaled,
    resumed,
    tip_reference,
)


class Params(NamedTuple):
    """Constants of the compiled steps; the class is this law's own, because studies tell laws apart by it."""

    mass: MassParams
    kept_share: float  # of the filtered force over a period, exp(-Ts / tau_f)


class Config(MassConfig):
    """Section `controller.law_of_a_release` of a scenario: every parameter with a range, a default and its unit."""

    filter_s: Annotated[float, Field(ge=0.0, le=10.0)] = Field(default=0.005, description="Time constant tau_f [s]")

    def to_params(self, period_s: float) -> Params:
        """Return the constants for a period [s] of the hand."""
        kept = math.exp(-period_s / self.filter_s) if self.filter_s > 0.0 else 0.0
        return Params(self.mass_params(period_s), kept)


class State(NamedTuple):
    """The virtual mass, and the filtered force at the hand's scale [N]."""

    mass: Mass
    force_n: float


@compiled
def master_start(params: Params, hand: HandSample) -> State:
    """Start with the mass at rest at the hand's position."""
    return State(at_rest(hand.position_m), 0.0)


@compiled
def master_resume(params: Params, hand: HandSample, tip_reference_m: float) -> State:
    """Take over from another law with the hand's motion and the tip's reference."""
    return State(resumed(params.mass, hand, tip_reference_m), hand.force_n)


@compiled
def master_send(params: Params, state: State, hand: HandSample, dt: float) -> tuple[State, PortSignal]:
    """Return the reference of the tip, and the hand's force for the record."""
    p = params.mass
    position, velocity = tip_reference(p, state.mass), p.position_scale * state.mass.velocity_m_per_s
    active = hand.following and state.mass.coupled
    force = hand.force_n / p.force_scale
    return state, port_signal(position_m=position, velocity_m_per_s=velocity, force_n=force, active=active)


@compiled
def master_receive(
    params: Params, state: State, hand: HandSample, signal: PortSignal, dt: float
) -> tuple[State, MasterReference]:
    """Filter the force that was received last, and move the mass over dt [s] against it."""
    p = params.mass
    coupled = is_coupled(p, signal)
    if not (coupled and hand.following):
        return State(let_go(p, state.mass, hand, signal), 0.0), MasterReference(hand.position_m, 0.0, 0.0, coupled)
    mass, force = state.mass, state.force_n
    received = p.force_scale * signal.force_n
    for _ in range(periods_in(dt, p.period_s)):
        force = received + params.kept_share * (force - received)
        mass = moved(p, mass, hand.force_n - force)
    return State(mass, force), MasterReference(mass.position_m, mass.velocity_m_per_s, force, True)


@compiled
def retune(old: Params, new: Params, state: State) -> State:
    """Keep the tip's reference where it is when alpha_p changes."""
    return State(rescaled(old.mass, new.mass, state.mass), state.force_n)


LAW_OF_A_RELEASE = Law(
    name="law_of_a_release",
    config=Config,
    master_start=master_start,
    master_resume=master_resume,
    master_send=master_send,
    master_receive=master_receive,
    # the slave passes the reference to the base, and sends the measured force back
    slave_start=pass_through.slave_start,
    slave_receive=pass_through.slave_receive,
    slave_send=pass_through.slave_send,
    retune=retune,
)
