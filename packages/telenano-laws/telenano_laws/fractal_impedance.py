"""Fractal impedance: a spring between hand and tip that takes back the energy it gave, so that it needs no damper.

The target of each side is the position of the other side. At the distance e to it, the force towards it is

    F = P(e) while e grows,   F = K_out (e - e_max / 2), K_out = 4 U(e_max) / e_max^2, while it falls:

on the return the spring gives energy in the first half, and takes it back in the second half. P(e) = K_0 e up to e_0,
and then approaches the greatest force W; U is its integral. The hand feels F(x_m - x_s); the base moves as
b_s x_s' = F(x_m - x_s) - F_s.

Source: K. K. Babarahmati, C. Tiseo and others, arXiv:2003.01463 and 2003.01466 (abstracts read); P, U and the return
are those of an author's public code (W. Merkt, superimposition_of_passive_taskspace_controllers); the coupling of the
two sides is derived here. A moving target does work that no account pays for, so the law is passive only over swings
during which the other side is at rest.

At the nanoscale, 1 N on a sample of 20 N/m is 0.33 mm at the hand's scale, so K_0 is the softest spring in the chain
and determines the stiffness felt; and the base is a position source, so the tip's damper b_s is a rate of motion.
"""

import math
from typing import NamedTuple

from telenano.extend.laws import (
    HandSample,
    Law,
    MasterReference,
    PortSignal,
    SlaveReference,
    TipMeasurement,
)
from telenano.extend.ranges import parameter
from telenano.extend.virtual_mass import (
    Mass,
    MassConfig,
    MassParams,
    at_hand,
    at_rest,
    at_tip,
    let_go,
    mass_signal,
    moved,
    periods_in,
    rescaled,
    resumed,
)
from telenano.numerics import compiled
from telenano_laws.ports import followed, of_scales

# The width of the rise from K_0 e_0 to W is the distance from e_0 to e_b divided by this.
_RISE_PARTS = 20.0
# Least width of the rise, because the force is computed by division by it.
_LEAST_RISE_M = 1e-12
# On the return the spring has no force if it turned at less than twice this distance.
_LEAST_HALF_M = 1e-9


class Fractal(NamedTuple):
    """K_0 [N/m], W [N], e_0 [m], and the width b of the rise from K_0 e_0 to W [m]."""

    stiffness_n_per_m: float
    most_n: float
    linear_m: float
    rise_m: float


class Turn(NamedTuple):
    """The last distance to the target, and the distance at the last turn [m]."""

    last_m: float
    farthest_m: float


class FractalImpedanceParams(NamedTuple):
    """Constants of the law."""

    mass: MassParams
    spring: Fractal
    damping_n_s_per_m: float


class FractalImpedanceConfig(MassConfig):
    """Section `controller.fractal_impedance`; all at the hand's scale."""

    silence_limit_s: float = parameter(
        0.5, "s", "Time without a signal from the other half after which the hand is let go [s]"
    )
    stiffness_n_per_m: float = parameter(1500.0, "N/m", "Stiffness of the spring K_0 [N/m]")
    greatest_force_n: float = parameter(10.0, "N", "Greatest force of the spring W [N]")
    base_damping_n_s_per_m: float = parameter(30.0, "N s/m", "Damper of the base b_s [N s/m]")

    def to_params(self, period_s: float) -> FractalImpedanceParams:
        """Return the constants of the compiled steps for a period [s] of the hand."""
        # The spring is linear over nine tenths of the distance to the greatest force.
        farthest = self.greatest_force_n / self.stiffness_n_per_m
        return FractalImpedanceParams(
            self.mass_params(period_s),
            fractal(self.stiffness_n_per_m, self.greatest_force_n, 0.9 * farthest, farthest),
            self.base_damping_n_s_per_m,
        )

    def stiffness_limit_n_per_m(self, period_s: float) -> float:
        """Return the stiffest sample [N/m] that the base tolerates in addition to its own spring; 0 if none."""
        felt = self.force_scale * self.position_scale
        limit = self.limit_of_damper(self.base_damping_n_s_per_m, period_s)
        return max(limit - 2.0 * self.stiffness_n_per_m / felt, 0.0)


def fractal(stiffness_n_per_m: float, most_n: float, linear_m: float, farthest_m: float) -> Fractal:
    """Return a spring K_0 up to e_0 [m] that has nearly its greatest force W [N] at e_b [m]."""
    return Fractal(stiffness_n_per_m, most_n, linear_m, max((farthest_m - linear_m) / _RISE_PARTS, _LEAST_RISE_M))


class MasterState(NamedTuple):
    """The mass, and the turn of the hand's spring."""

    mass: Mass
    turn: Turn


class SlaveState(NamedTuple):
    """The base reference [m], and the turn of the tip's spring."""

    position_m: float
    turn: Turn


@compiled
def faded(ratio: float) -> float:
    """Return exp(-ratio), ratio >= 0, by products alone, so that the bits are the same on every machine."""
    part = min(ratio, 700.0) / 1024.0
    value = 1.0 - part * (1.0 - part * (0.5 - part * (1.0 / 6.0 - part / 24.0)))
    for _ in range(10):
        value *= value
    return value


@compiled
def outward_force(spring: Fractal, distance_m: float) -> float:
    """Return P(e) [N], the force while the distance to the target grows."""
    a, linear = abs(distance_m), spring.linear_m
    if a < linear:
        return spring.stiffness_n_per_m * distance_m
    first = spring.stiffness_n_per_m * linear
    rise = (1.0 - faded((a - linear) / spring.rise_m)) * (spring.most_n - first)
    return math.copysign(first + rise, distance_m)


@compiled
def stored(spring: Fractal, distance_m: float) -> float:
    """Return U(e) [J], the integral of P from 0 to e."""
    a, linear, b = abs(distance_m), spring.linear_m, spring.rise_m
    if a < linear:
        return 0.5 * spring.stiffness_n_per_m * a * a
    first = spring.stiffness_n_per_m * linear
    more = (a - linear - b * (1.0 - faded((a - linear) / b))) * (spring.most_n - first)
    return 0.5 * first * linear + first * (a - linear) + more


@compiled
def fractal_force(spring: Fractal, turn: Turn, distance_m: float) -> tuple[Turn, float]:
    """Return the new turn and the force towards the target [N] at a distance from it [m], which grows or falls."""
    change = distance_m - turn.last_m
    if distance_m * change >= 0.0:
        return Turn(distance_m, distance_m), outward_force(spring, distance_m)
    half = 0.5 * turn.farthest_m
    if abs(half) < _LEAST_HALF_M:
        return Turn(distance_m, turn.farthest_m), 0.0
    force = stored(spring, turn.farthest_m) / (half * half) * (distance_m - half)
    return Turn(distance_m, turn.farthest_m), min(max(force, -spring.most_n), spring.most_n)


@compiled
def _turned_at(distance_m: float) -> Turn:
    return Turn(distance_m, distance_m)


@compiled
def master_start(params: FractalImpedanceParams, hand: HandSample) -> MasterState:
    """Start with the virtual mass at rest at the hand's position."""
    return MasterState(at_rest(hand.position_m), _turned_at(0.0))


@compiled
def master_resume(params: FractalImpedanceParams, hand: HandSample, tip_reference_m: float) -> MasterState:
    """Continue with the hand's motion and the tip's reference."""
    return MasterState(resumed(params.mass, hand, tip_reference_m), _turned_at(0.0))


@compiled
def master_send(
    params: FractalImpedanceParams, state: MasterState, hand: HandSample, dt: float
) -> tuple[MasterState, PortSignal]:
    """Return the slave's target, and the hand's force for the recording."""
    return state, mass_signal(params.mass, state.mass, hand, 0.0, hand.following and state.mass.coupled)


@compiled
def master_receive(
    params: FractalImpedanceParams, state: MasterState, hand: HandSample, signal: PortSignal, dt: float
) -> tuple[MasterState, MasterReference]:
    """Move the mass for dt [s] against the spring to the last known position of the tip."""
    p, mass, turn = params.mass, state.mass, state.turn
    may = at_hand(p, hand, signal, mass.coupled, 0.0, dt, False)
    if not may.acts:
        state = MasterState(let_go(p, mass, hand, signal), _turned_at(0.0))
        return state, MasterReference(hand.position_m, 0.0, 0.0, may.coupled)
    target, force = (signal.position_m - mass.tip_offset_m) / p.position_scale, 0.0
    for _ in range(periods_in(dt, p.period_s)):
        turn, force = fractal_force(params.spring, turn, mass.position_m - target)
        mass = moved(p, mass, hand.force_n - force)
    return MasterState(mass, turn), MasterReference(mass.position_m, mass.velocity_m_per_s, force, True)


@compiled
def slave_start(params: FractalImpedanceParams, tip: TipMeasurement) -> SlaveState:
    """Start at the position of the base."""
    return SlaveState(tip.base_position_m, _turned_at(0.0))


@compiled
def slave_receive(
    params: FractalImpedanceParams, state: SlaveState, signal: PortSignal, tip: TipMeasurement, dt: float
) -> tuple[SlaveState, SlaveReference]:
    """Move the base for a period under its spring to the hand and against the measured force.

    While the tip does not follow, the reference is the master's; while the master does not, the base stays.
    """
    p = params.mass
    may = at_tip(p, signal, tip, state.position_m, False)
    if not may.leads:
        return SlaveState(may.base_m, _turned_at(0.0)), SlaveReference(may.base_m, True)
    start = followed(p, state.position_m, tip)
    turn, pulled = fractal_force(params.spring, state.turn, (signal.position_m - start) / p.position_scale)
    speed = (pulled - p.force_scale * tip.force_n) / params.damping_n_s_per_m
    base = start + p.position_scale * p.period_s * speed
    return SlaveState(base, turn), SlaveReference(base, True)


@compiled
def retune(old: FractalImpedanceParams, new: FractalImpedanceParams, state: MasterState) -> MasterState:
    """Keep the tip's reference constant when alpha_p changes."""
    longer, _ = of_scales(old.mass, new.mass)
    return MasterState(rescaled(old.mass, new.mass, state.mass), _longer_turn(state.turn, longer))


@compiled
def _longer_turn(turn: Turn, longer: float) -> Turn:
    return Turn(longer * turn.last_m, longer * turn.farthest_m)


@compiled
def slave_retune(old: FractalImpedanceParams, new: FractalImpedanceParams, state: SlaveState) -> SlaveState:
    """Convert the turn, which is at the hand's scale, to the new scales."""
    longer, _ = of_scales(old.mass, new.mass)
    return SlaveState(state.position_m, _longer_turn(state.turn, longer))


FRACTAL_IMPEDANCE = Law.of(
    __name__,
    FractalImpedanceConfig,
    local_loop=True,
    fixed_in_contact=("stiffness_n_per_m", "greatest_force_n"),
)
