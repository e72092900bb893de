"""The haptic site in one step: guard, then device, then hand.

The way of a sample ends here: the command comes from `telenano/hand/safety.py`, and the motion of the hand is the next
sample of `services/haptic_node/node.py`.

The simulated driver runs `plant_step` behind the node's own guard; `step` is the whole chain for lockstep studies.
Both use the same functions, so a study and a rig cannot differ.
"""

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from telenano.extend.hands import MODE_OFF, MODE_POSITION, DeviceReading, DriveCommand, SpatialCommand
from telenano.extend.operators import OperatorInputs
from telenano.hand import motor, safety
from telenano.hand.operator_models import operator_step
from telenano.hand.part import HandPart, initial_plant, place_of, plant_step
from telenano.numerics.compiler import compiled


class PlantParams(NamedTuple):
    """Constants of the simulated device and of the hand on it."""

    motor: motor.MotorParams
    # Parameters of one of the models of `operator_models`.
    operator: Any


class PlantState(NamedTuple):
    """States of the simulated device and of the hand on it."""

    motor: motor.MotorState
    operator: Any


class DisturbedPlantParams(NamedTuple):
    """A simulated device, and its disturbances for a whole run.

    forces_n: force added to each sample of the run [N]; wander_n: force added to each sample from the start of the
    session on [N]; resolution_m: step of the encoder [m], 0 for none.
    """

    plant: Any
    forces_n: npt.NDArray[np.float64]
    wander_n: npt.NDArray[np.float64]
    resolution_m: float

    @property
    def operator(self) -> Any:
        """Return the constants of the hand on the device."""
        return self.plant.operator


class DisturbedPlantState(NamedTuple):
    """State of the disturbed device, the position last read [m], and the number of samples taken."""

    plant: Any
    position_m: float
    samples: int


class HapticParams(NamedTuple):
    """Constants of the whole chain; the plant is that of a simulated device, disturbed or not."""

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
    """The command that the guard applied with its reason, and the reading of the device after it."""

    applied: safety.SafetyOutputs
    reading: DeviceReading


def initial_state(params: Any, position_m: float) -> HapticStepState:
    """Return the state of the chain at rest at position_m [m], off, without a latched e-stop."""
    return HapticStepState(safety.SafetyState(False, MODE_OFF, position_m), initial_plant(params, position_m))


def _start(params: PlantParams, position_m: float, operator: Any) -> PlantState:
    return PlantState(motor.MotorState(position_m, 0.0), operator)


def _disturbed_start(params: DisturbedPlantParams, position_m: float, operator: Any) -> DisturbedPlantState:
    return DisturbedPlantState(initial_plant(params.plant, position_m), position_m, 0)


@compiled
def motor_plant_step(
    params: PlantParams, state: PlantState, command: DriveCommand, session_time_s: float, dt: float
) -> tuple[PlantState, DeviceReading]:
    """Advance device and hand by dt [s], > 0, under a guarded command."""
    inputs = motor.MotorInputs(command.mode, command.position_reference_m)
    motion, drive = motor.step(params.motor, state.motor, inputs, dt)
    ends = OperatorInputs(session_time_s, state.motor.position_m, motion.position_m)
    hand, felt = operator_step(params.operator, state.operator, ends, dt)
    reading = DeviceReading(
        position_m=motion.position_m,
        velocity_m_per_s=motion.velocity_m_per_s,
        operator_force_n=felt.force_n,
        operator_force_limited=felt.limited,
        # The screw holds what the hand presses, whatever the motor's torque overcomes within it.
        motor_force_n=0.0 - felt.force_n if command.mode == MODE_POSITION else 0.0,
        motor_voltage_v=drive.voltage_v,
        end_stop=drive.end_stop,
        voltage_limited=drive.voltage_limited,
        torque_limited=drive.torque_limited,
        spatial=None,
    )
    return PlantState(motion, hand), reading


@compiled
def _motor_place(params: PlantParams, state: PlantState) -> tuple[float, bool]:
    return state.motor.position_m, False


@compiled
def disturbed_reading(
    reading: DeviceReading, resolution_m: float, before_m: float, force_n: float, dt: float
) -> DeviceReading:
    """Return a reading rounded to the encoder's steps [m], 0 for none, with a force [N] added to that of the hand.

    before_m: position of the previous reading [m], dt [s] ago, from which the velocity is computed.
    """
    position, velocity = reading.position_m, reading.velocity_m_per_s
    if resolution_m > 0.0:
        position = round(position / resolution_m) * resolution_m
        velocity = (position - before_m) / dt
    return DeviceReading(
        position_m=position,
        velocity_m_per_s=velocity,
        operator_force_n=reading.operator_force_n + force_n,
        operator_force_limited=reading.operator_force_limited,
        motor_force_n=reading.motor_force_n,
        motor_voltage_v=reading.motor_voltage_v,
        end_stop=reading.end_stop,
        voltage_limited=reading.voltage_limited,
        torque_limited=reading.torque_limited,
        spatial=reading.spatial,
    )


@compiled
def _disturbed_plant_step(
    params: DisturbedPlantParams, state: DisturbedPlantState, command: DriveCommand, session_time_s: float, dt: float
) -> tuple[DisturbedPlantState, DeviceReading]:
    plant, reading = plant_step(params.plant, state.plant, command, session_time_s, dt)
    last = len(params.forces_n) - 1
    force_n = float(params.forces_n[min(state.samples, last)])
    if session_time_s >= 0.0:
        force_n += float(params.wander_n[min(int(session_time_s / dt + 0.5), last)])
    reading = disturbed_reading(reading, params.resolution_m, state.position_m, force_n, dt)
    return DisturbedPlantState(plant, reading.position_m, state.samples + 1), reading


@compiled
def _disturbed_place(params: DisturbedPlantParams, state: DisturbedPlantState) -> tuple[float, bool]:
    position_m, is_waiting = place_of(params.plant, state.plant)
    return position_m, is_waiting


_CENTRE = SpatialCommand((0.0, 0.0), (0.0, 0.0), False)
HandPart(_start, motor_plant_step, _motor_place).register(PlantParams)
HandPart(_disturbed_start, _disturbed_plant_step, _disturbed_place).register(DisturbedPlantParams)


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
    position_m, device_waits = place_of(params.plant, state.plant)
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
