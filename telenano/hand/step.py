"""The haptic site in one step: guard, then device, then hand.

`plant_step` is what the simulated driver runs behind the node's own guard; `step` is the whole chain for lockstep
studies. Both are the same functions, so a study and a rig cannot differ.
"""

from typing import Any, NamedTuple

from telenano.hand import motor, operator, safety
from telenano.hand.coupled import CoupledParams, coupled_plant_step, initial_coupled, waits
from telenano.hand.driver import DeviceReading, DriveCommand, SpatialCommand
from telenano.hand.operator_models import operator_at_rest, operator_step
from telenano.numerics.compiler import chosen_step, compiled


class PlantParams(NamedTuple):
    """Constants of the simulated device and of the hand on it."""

    motor: motor.MotorParams
    # The parameters are those of one of the models of `operator_models`.
    operator: Any


class PlantState(NamedTuple):
    """States of the simulated device and of the hand on it."""

    motor: motor.MotorState
    operator: Any


class HapticParams(NamedTuple):
    """Constants of the whole chain; the plant is that of one of the two simulated devices."""

    safety: safety.SafetyParams
    plant: Any


class HapticStepState(NamedTuple):
    """State of the whole chain."""

    safety: safety.SafetyState
    plant: Any


class HapticInputs(NamedTuple):
    """The newest command with its age, and the session's clock and requests.

    command_mode: 0 off, 1 position, 2 force. position_reference_m: along x, towards the sample. command_age_s: infinite
    if there never was a command. session_time_s: since the start of the session, negative if it has not started.
    """

    command_mode: int
    position_reference_m: float
    force_reference_n: float
    command_age_s: float
    session_time_s: float
    estop: bool
    arm_requested: bool


class HapticOutputs(NamedTuple):
    """What the guard applied and why, and what the device then measured and really sent."""

    applied: safety.SafetyOutputs
    reading: DeviceReading


def initial_plant(params: Any, position_m: float) -> Any:
    """Return the device and the hand at rest at position_m [m]."""
    if isinstance(params, CoupledParams):
        return initial_coupled(params, position_m)
    return PlantState(motor.MotorState(position_m, 0.0), operator_at_rest(params.operator, position_m))


def initial_state(params: Any, position_m: float) -> HapticStepState:
    """Return the chain at rest at position_m [m], off, not latched."""
    return HapticStepState(safety.SafetyState(False, safety.MODE_OFF, position_m), initial_plant(params, position_m))


@compiled
def motor_plant_step(
    params: PlantParams, state: PlantState, command: DriveCommand, session_time_s: float, dt: float
) -> tuple[PlantState, DeviceReading]:
    """Advance device and hand by dt [s], > 0, under a guarded command."""
    inputs = motor.MotorInputs(command.mode, command.position_reference_m)
    motion, drive = motor.step(params.motor, state.motor, inputs, dt)
    ends = operator.OperatorInputs(session_time_s, state.motor.position_m, motion.position_m)
    hand, felt = operator_step(params.operator, state.operator, ends, dt)
    reading = DeviceReading(
        position_m=motion.position_m,
        velocity_m_per_s=motion.velocity_m_per_s,
        operator_force_n=felt.force_n,
        operator_force_limited=felt.limited,
        motor_force_n=drive.force_n,
        motor_voltage_v=drive.voltage_v,
        end_stop=drive.end_stop,
        voltage_limited=drive.voltage_limited,
        torque_limited=drive.torque_limited,
        spatial=None,
    )
    return PlantState(motion, hand), reading


@compiled
def _motor_found(params: PlantParams, state: PlantState) -> tuple[float, bool]:
    return state.motor.position_m, False


@compiled
def _coupled_found(params: CoupledParams, state: Any) -> tuple[float, bool]:
    return 0.0 - state.position_m[2], waits(state)


_CENTRE = SpatialCommand((0.0, 0.0), (0.0, 0.0), False)
plant_step = chosen_step(lambda kind: coupled_plant_step if kind is CoupledParams else motor_plant_step)
# where the device is [m], and whether it gives no force for a reason of its own
found = chosen_step(lambda kind: _coupled_found if kind is CoupledParams else _motor_found)


@compiled
def step(
    params: HapticParams, state: HapticStepState, inputs: HapticInputs, dt: float
) -> tuple[HapticStepState, HapticOutputs]:
    """Advance the haptic site by dt [s].

    Raises:
        ValueError: dt is not a positive time.
    """
    if not dt > 0.0:
        raise ValueError("dt of the haptic step must be a positive time in s")
    position_m, device_waits = found(params.plant, state.plant)
    guard_inputs = safety.SafetyInputs(
        command_mode=inputs.command_mode,
        position_reference_m=inputs.position_reference_m,
        force_reference_n=inputs.force_reference_n,
        command_age_s=inputs.command_age_s,
        estop=inputs.estop,
        arm_requested=inputs.arm_requested,
        position_m=position_m,
        device_lost=False,
        device_waits=device_waits,
    )
    guard, applied = safety.step(params.safety, state.safety, guard_inputs, dt)
    command = DriveCommand(applied.mode, applied.position_reference_m, applied.force_reference_n, _CENTRE)
    plant, reading = plant_step(params.plant, state.plant, command, inputs.session_time_s, dt)
    return HapticStepState(guard, plant), HapticOutputs(applied, reading)
