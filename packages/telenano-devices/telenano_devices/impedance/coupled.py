"""A simulated device of impedance type with its hand: a mass with a damper per axis under the coupling of its servo.

    m x'' + b x' = u + F_hand,   u the force of the coupling, held for a sample time T and late by D

solved exactly over each part of a period in which u is constant. The hand on the normal axis is that of the
configuration; its force depends on the motion of the arm, and the two are solved together (the model of the hand is
linear, or clipped at its limit). The hand on the lateral axes is a spring and a damper on a path of its own, or a force
from outside.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from telenano.extend.hands import MODE_POSITION, DeviceReading, DriveCommand
from telenano.extend.operators import OperatorInputs
from telenano.hand import HandPart, interpolate, operator_step
from telenano.numerics import compiled
from telenano_devices.impedance.coupling import (
    GATE_ACTIVE,
    GATE_READY,
    UPRIGHT,
    ZERO,
    CouplingReading,
    CouplingReference,
    CouplingSettings,
    CouplingState,
    Pair,
    Vector,
    coupling_at_start,
    coupling_step,
    reading_of,
)


class LateralHand(NamedTuple):
    """The hand on the lateral axes: corners of its path (times [s], x, y [m]), its spring and damper, a force [N]."""

    times_s: NDArray[np.float64]
    x_m: NDArray[np.float64]
    y_m: NDArray[np.float64]
    stiffness_n_per_m: float
    damping_n_s_per_m: float
    force_n: Pair


class CoupledParams(NamedTuple):
    """Constants of device, coupling and hand.

    servo_period_s, delay_s: T and D [s]. reach_m: half the workspace on each axis, about its centre [m].
    """

    settings: CouplingSettings
    mass_kg: float
    damping_n_s_per_m: float
    servo_period_s: float
    delay_s: float
    reach_m: float
    lateral: LateralHand
    operator: Any


class CoupledState(NamedTuple):
    """State of device, coupling and hand; `late`: forces [N] that the drive has not yet applied, the oldest first.

    reference_m: reference of the last command, along the paper's axis [m]; engaged: whether that command drove the
    device; arm_count: number of times that a person has armed.
    """

    coupling: CouplingState
    position_m: Vector
    velocity_m_per_s: Vector
    late: tuple[Vector, ...]
    operator: Any
    reference_m: float
    engaged: bool
    arm_count: int


def initial_coupled(params: CoupledParams, position_m: float, operator: Any) -> CoupledState:
    """Return a device at rest at position_m [m] along the paper's axis, with the state of the hand on it."""
    periods = math.floor(params.delay_s / params.servo_period_s + 1e-9)
    return CoupledState(
        coupling=coupling_at_start(),
        position_m=(0.0, 0.0, 0.0 - position_m),
        velocity_m_per_s=ZERO,
        late=(ZERO,) * (periods + 1),
        operator=operator,
        reference_m=position_m,
        engaged=False,
        arm_count=0,
    )


@compiled
def arm_step(mass_kg: float, b: float, x: float, v: float, force_n: float, h: float) -> tuple[float, float]:
    """Return position [m] and velocity [m/s] of m x'' + b x' = F after h [s] under a constant force, exactly."""
    if b == 0.0:
        a = force_n / mass_kg
        return x + (v + 0.5 * a * h) * h, v + a * h
    share = -math.expm1(-b * h / mass_kg)
    way = share * mass_kg / b
    return x + way * v + (h - way) / b * force_n, v + share * (force_n / b - v)


@compiled
def _normal_step(
    params: CoupledParams, operator: Any, x: float, v: float, drive_n: float, session_s: float, h: float
) -> tuple[Any, float, float]:
    """Return hand, position and velocity along the paper's axis after h [s], with the hand's force for that motion."""
    free, _ = arm_step(params.mass_kg, params.damping_n_s_per_m, x, v, drive_n, h)
    _, first = operator_step(params.operator, operator, OperatorInputs(session_s, x, free), h)
    force = first.force_n
    guess, _ = arm_step(params.mass_kg, params.damping_n_s_per_m, x, v, drive_n + force, h)
    if guess != free:
        _, second = operator_step(params.operator, operator, OperatorInputs(session_s, x, guess), h)
        slope = (second.force_n - force) / (guess - free)
        # The end of the motion is free + (guess - free) F / force, and F is linear in it.
        force = force / (1.0 - slope * (guess - free) / force)
    end, speed = arm_step(params.mass_kg, params.damping_n_s_per_m, x, v, drive_n + force, h)
    operator, _ = operator_step(params.operator, operator, OperatorInputs(session_s, x, end), h)
    return operator, end, speed


@compiled
def _lateral_step(
    params: CoupledParams, path_m: Pair, x: float, v: float, pushed_n: float, held: bool, h: float
) -> tuple[float, float]:
    """Return position and velocity after h [s] on a lateral axis; path_m: the hand at the two ends of the step [m].

    held: whether the session runs, so that there is a hand.
    """
    m, b = params.mass_kg, params.damping_n_s_per_m
    k = params.lateral.stiffness_n_per_m if held else 0.0
    c = params.lateral.damping_n_s_per_m if held else 0.0
    free, _ = arm_step(m, b, x, v, pushed_n, h)
    unit, _ = arm_step(m, b, 0.0, 0.0, 1.0, h)
    middle, rate = 0.5 * (path_m[0] + path_m[1]), (path_m[1] - path_m[0]) / h
    # F = k (middle - (x + end) / 2) + c (rate - (end - x) / h) with end = free + unit F
    force = k * (middle - 0.5 * (x + free)) + c * (rate - (free - x) / h)
    force /= 1.0 + unit * (0.5 * k + c / h)
    return arm_step(m, b, x, v, pushed_n + force, h)


@compiled
def _moved(
    params: CoupledParams, state: CoupledState, force: Vector, session_s: float, h: float
) -> tuple[Vector, Vector, Any]:
    """Return positions, velocities and hand after h [s] under a constant force of the drive; session_s: at the end."""
    p, v, side = state.position_m, state.velocity_m_per_s, params.lateral
    held = session_s >= 0.0
    operator, x, speed = _normal_step(params, state.operator, 0.0 - p[2], 0.0 - v[2], 0.0 - force[2], session_s, h)
    at_x = (
        interpolate(side.times_s, side.x_m, session_s - h, 0.0),
        interpolate(side.times_s, side.x_m, session_s, 0.0),
    )
    at_y = (
        interpolate(side.times_s, side.y_m, session_s - h, 0.0),
        interpolate(side.times_s, side.y_m, session_s, 0.0),
    )
    x0, v0 = _lateral_step(params, at_x, p[0], v[0], force[0] + side.force_n[0], held, h)
    x1, v1 = _lateral_step(params, at_y, p[1], v[1], force[1] + side.force_n[1], held, h)
    x0, v0 = _stopped(x0, v0, params.reach_m)
    x1, v1 = _stopped(x1, v1, params.reach_m)
    z, vz = _stopped(0.0 - x, 0.0 - speed, params.reach_m)
    return (x0, x1, z), (v0, v1, vz), operator


@compiled
def _stopped(x: float, v: float, reach_m: float) -> tuple[float, float]:
    """Return position and velocity limited by the end stops, which set the speed to zero."""
    if abs(x) > reach_m:
        return math.copysign(reach_m, x), 0.0
    return x, v


@compiled
def servo_step(
    params: CoupledParams, state: CoupledState, reference: CouplingReference, session_s: float
) -> CoupledState:
    """Advance by one sample time of the servo, which samples and drives, and move the arm; session_s: at the end."""
    t = params.servo_period_s
    reading = CouplingReading(state.position_m, 0.0, True, 0.0)
    force, coupling = coupling_step(state.coupling, params.settings, reference, reading, t)
    late = state.late + (force,)  # noqa: RUF005 - the compiler knows no unpacking
    part = params.delay_s - t * math.floor(params.delay_s / t + 1e-9)
    if part > 1e-9 * t:
        position, velocity, operator = _moved(params, state, late[0], session_s - t + part, part)
        state = _with_motion(state, coupling, position, velocity, late, operator)
        position, velocity, operator = _moved(params, state, late[1], session_s, t - part)
    else:
        position, velocity, operator = _moved(params, state, late[1], session_s, t)
    return _with_motion(state, coupling, position, velocity, late, operator)


@compiled
def _with_motion(
    state: CoupledState, coupling: CouplingState, position: Vector, velocity: Vector, late: Any, operator: Any
) -> CoupledState:
    return CoupledState(
        coupling=coupling,
        position_m=position,
        velocity_m_per_s=velocity,
        late=late[1:],
        operator=operator,
        reference_m=state.reference_m,
        engaged=state.engaged,
        arm_count=state.arm_count,
    )


@compiled
def waits(state: CoupledState) -> bool:
    """Return whether the coupling gives no force for a reason of its own."""
    return state.coupling.gate not in (GATE_ACTIVE, GATE_READY)


@compiled
def coupled_plant_step(
    params: CoupledParams, state: CoupledState, command: DriveCommand, session_time_s: float, dt: float
) -> tuple[CoupledState, DeviceReading]:
    """Advance device, servo and hand by dt [s], > 0, under a guarded command, by whole steps of the servo."""
    engaged = command.mode == MODE_POSITION
    x = command.position_reference_m
    velocity = (x - state.reference_m) / dt if engaged and state.engaged else 0.0
    side, pull, arm_count = command.spatial.lateral_m, command.spatial.lateral_force_n, state.arm_count
    if command.spatial.arm:
        arm_count += 1
    count = max(1, round(dt / params.servo_period_s))
    for index in range(count):
        age_s = index * params.servo_period_s
        reference = CouplingReference(
            (side[0], side[1], 0.0 - x), (0.0, 0.0, 0.0 - velocity), (pull[0], pull[1], 0.0), engaged, age_s, arm_count
        )
        session_s = session_time_s - (count - 1 - index) * params.servo_period_s
        state = servo_step(params, state, reference, session_s)
    state = CoupledState(
        coupling=state.coupling,
        position_m=state.position_m,
        velocity_m_per_s=state.velocity_m_per_s,
        late=state.late,
        operator=state.operator,
        reference_m=x,
        engaged=engaged,
        arm_count=arm_count,
    )
    p, coupling = state.position_m, state.coupling
    at_end = max(abs(p[0]), abs(p[1]), abs(p[2])) >= params.reach_m
    marks, energies_j = (coupling.limited, at_end, coupling.gate), (coupling.hand_energy_j, coupling.coupling_energy_j)
    return state, reading_of(p, state.velocity_m_per_s, coupling.force_n, marks, (UPRIGHT, 0), energies_j)


@compiled
def _place(params: CoupledParams, state: CoupledState) -> tuple[float, bool]:
    return 0.0 - state.position_m[2], waits(state)


def _pushed(params: CoupledParams, force_n: Pair) -> CoupledParams:
    return params._replace(lateral=params.lateral._replace(force_n=force_n))


HandPart(initial_coupled, coupled_plant_step, _place, _pushed).register(CoupledParams)
