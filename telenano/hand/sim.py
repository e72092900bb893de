"""The driver of the simulated haptic devices, each with the hand on it.

It has no socket and no clock: the caller passes the time.
"""

from typing import Any, cast

import msgspec
import numpy as np

from telenano.extend.hands import (
    MODE_NAMES,
    MODE_OFF,
    MODE_POSITION,
    Capabilities,
    DeviceError,
    DeviceReading,
    DriveCommand,
    Pair,
)
from telenano.hand.operator_models import operator_at_rest
from telenano.hand.part import initial_plant, place_of, plant_step, pushed_across
from telenano.hand.step import PlantParams

SAMPLE_TIME_S = 1e-3
_OFF = DriveCommand(MODE_OFF, 0.0, 0.0)


def capabilities(params: PlantParams) -> Capabilities:
    """Return the capabilities that the simulated device declares, from its own constants.

    The largest force is the limit of the hand's sensor, or the force that the motor can hold beyond its friction if
    that is smaller. The physical damping b at the arm is that of the motor, K_t K_e / (R Kp^2) with K_t = K_e = 1/Km;
    the largest stiffness is 2 b / T for samples every T = 1 ms.
    """
    motor = params.motor
    held = (motor.torque_limit_n_m - motor.friction_torque_n_m) / motor.screw_m_per_rad
    reflected = motor.speed_gain_rad_per_s_v * motor.screw_m_per_rad
    damping = 1.0 / (motor.armature_resistance_ohm * reflected * reflected)
    return Capabilities(
        max_force_n=min(params.operator.max_force_n, held),
        max_stiffness_n_per_m=2.0 * damping / SAMPLE_TIME_S,
        max_damping_n_s_per_m=damping,
        workspace_min_m=motor.position_min_m,
        workspace_max_m=motor.position_max_m,
        modes=(MODE_OFF, MODE_POSITION),
    )


class HandleState(msgspec.Struct, array_like=True):
    """State of device and hand; the command in force; the disturbances, None for a device that cannot have any."""

    plant: Any
    command: DriveCommand = _OFF
    disturbed: Any = None


class SimulatedHaptic:
    """A HapticDevice whose motor and hand are the compiled models."""

    def __init__(
        self, params: Any, start_position_m: float, declared: Capabilities | None = None, about: str = ""
    ) -> None:
        """Put device and hand at a position.

        Args:
            params: The constants, of a class registered with `part.HandPart.register`.
            start_position_m: The position of the arm [m].
            declared: The capabilities; None computes those of the device of the paper from its constants.
            about: A sentence that the node reports at its start.
        """
        self._params, self.about = params, about
        self._capabilities = capabilities(cast(PlantParams, params)) if declared is None else declared
        self.state = HandleState(initial_plant(params, start_position_m))
        self._opened = False

    @property
    def capabilities(self) -> Capabilities:
        return self._capabilities

    @property
    def report(self) -> None:
        return None

    def open(self) -> None:
        """Start in the safe state, with the arm where it was left."""
        self.state.command = _OFF
        # Compile (or load) the models now and drop the result, so that the first reading of a loop need not wait.
        plant_step(self._params, self.state.plant, self.state.command, -SAMPLE_TIME_S, SAMPLE_TIME_S)
        self._opened = True

    def close(self) -> None:
        """Switch the drive off and refuse further use."""
        self.make_safe()
        self._opened = False

    def write(self, command: DriveCommand) -> None:
        self._require_open()
        if command.mode not in self._capabilities.modes:
            raise DeviceError(
                f"mode {command.mode} ({MODE_NAMES.get(command.mode, 'unknown')}) is not one of this device's:"
                f" {', '.join(f'{code} ({MODE_NAMES[code]})' for code in self._capabilities.modes)}"
            )
        self.state.command = command

    def read(self, session_time_s: float, dt_s: float) -> DeviceReading:
        """Advance by dt_s [s] under the last command, and return the reading at the end.

        Raises:
            DeviceError: The device is closed.
            ValueError: dt_s is not above 0.
        """
        self._require_open()
        if not dt_s > 0.0:
            raise ValueError(f"dt_s of a reading must be a positive time in s, not {dt_s!r}")
        self.state.plant, reading = plant_step(self._params, self.state.plant, self.state.command, session_time_s, dt_s)
        return cast(DeviceReading, reading)

    def push(self, force_n: float) -> None:
        """Replace the profile of the hand by a constant force [N], positive towards the sample."""
        values = np.array([force_n])
        self._params = self._params._replace(operator=self._params.operator._replace(values=values))

    def push_lateral(self, force_n: Pair) -> None:
        """Hold a force of the hand [N] along x and y of the master frame; a device of one axis ignores it."""
        self._params = pushed_across(self._params, force_n)

    def take_operator(self, params: Any) -> None:
        """Put another hand, at rest, on the device; `params` belong to one of the models of the operator."""
        self._params = self._params._replace(operator=params)
        position_m = place_of(self._params, self.state.plant)[0]
        self.state.plant = self.state.plant._replace(operator=operator_at_rest(params, position_m))

    def make_safe(self) -> None:
        """Set the drive voltage to zero: the shorted motor brakes, and the screw, not back-drivable, stands still."""
        self.state.command = _OFF

    def _require_open(self) -> None:
        if not self._opened:
            raise DeviceError("the simulated haptic device is not open: call open() first")
