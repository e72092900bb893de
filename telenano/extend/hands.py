"""The interface of every haptic device driver: declared capabilities and five methods.

A driver carries out commands without checking them: the guard in `safety.py` does that before. The driver's own limits
(supply, current, end stops) appear in its reading. Positions and forces are along the paper's axis x, towards the
sample.
"""

from collections.abc import Mapping
from enum import IntEnum
from types import MappingProxyType
from typing import Any, Literal, NamedTuple, Protocol, Self

from telenano.wire.errors import ConfigError

Status = Literal["ok", "stale", "lost"]


class DeviceError(ConfigError, RuntimeError):
    """The device cannot carry out a request: it is not open, absent, not the configured one, or incapable."""


Pair = tuple[float, float]
Quaternion = tuple[float, float, float, float]
UPRIGHT: Quaternion = (1.0, 0.0, 0.0, 0.0)


class Capabilities(NamedTuple):
    """Properties that a device declares before anything is sent to it.

    For an admittance device, max_stiffness_n_per_m and max_damping_n_s_per_m are the limits that a loop sampled at
    1 kHz renders passively: with physical damping b at the arm, b > K T / 2 + B (Colgate and Schenkel 1997), so
    K <= 2 b / T alone and B <= b alone. For an impedance device they are the maker's values for the rate of its servo.
    """

    max_force_n: float
    max_stiffness_n_per_m: float
    max_damping_n_s_per_m: float
    workspace_min_m: float
    workspace_max_m: float
    modes: tuple[int, ...]
    identity: str = ""
    force_source: Literal["sensor", "estimate", "none"] = "sensor"
    # Mean time from a command to the tick that publishes its effect, in addition to that of the simulated device [s].
    latency_s: float = 0.0
    # Identity of the calibration in use.
    calibration: str = ""
    # admittance: controls the position and measures the force; impedance: measures the position and applies a force.
    kind: Literal["admittance", "impedance"] = "admittance"
    # 1: the paper's axis; 3: also the lateral x and y of the master frame, whose workspace is lateral_m.
    axes: int = 1
    lateral_m: tuple[Pair, Pair] = ((0.0, 0.0), (0.0, 0.0))
    # Rate of the device's servo [Hz]; 0.0 represents that of the node.
    rate_hz: float = 0.0
    # Physical damping b [N s/m] and moving mass [kg]; 0.0 if unknown. If they are assumed, `identity` says so.
    damping_n_s_per_m: float = 0.0
    mass_kg: float = 0.0
    # Time from a sample until the force that answers it acts [s].
    drive_delay_s: float = 0.0
    # Names of the buttons, bit 0 first, and the name of the dead-man button; empty if there is none.
    buttons: tuple[str, ...] = ()
    deadman: str = ""
    has_orientation: bool = False


class SpatialCommand(NamedTuple):
    """Additional command for a device of impedance type or with three axes; x and y are of the master frame.

    lateral_force_n: force that the hand must feel. lateral_m: place to which a lateral stiffness, if the coupling has
    one, pulls the hand. arm: True if a person has armed the device since the previous command.
    """

    lateral_m: Pair = (0.0, 0.0)
    lateral_force_n: Pair = (0.0, 0.0)
    arm: bool = False


class DriveCommand(NamedTuple):
    """Command that has passed the guard: a mode code and its reference; some devices also use `spatial`."""

    mode: int
    position_reference_m: float
    force_reference_n: float
    spatial: SpatialCommand = SpatialCommand()


class Gate(IntEnum):
    """Reason why an impedance device gives no force; after a fault it stays off until armed, and counts as lost.

    Gate(reading.spatial.gate).text    # "the device gives no force until the hand has been at rest"
    """

    text: str

    def __new__(cls, number: int, text: str = "") -> Self:
        gate = int.__new__(cls, number)
        gate._value_, gate.text = number, text
        return gate

    @property
    def is_fault(self) -> bool:
        """Whether this is a fault, after which a person must arm the device again."""
        return self >= Gate.NOT_A_NUMBER

    ACTIVE = 0, "the device follows the law"
    READY = 1, "the device gives no force until the law engages it"
    RELEASED = 2, "the device gives no force until the law has let go of it once"
    REST = 3, "the device gives no force until the hand has been at rest"
    SILENT = 4, "the device gives no force: its servo has heard nothing from the node within its deadline"
    DEADMAN = 5, "the device gives no force: its dead-man button is not held, or its grip is asleep"
    REFERENCE = 6, "the device gives no force: the reference is not a finite number"
    DEVICE_SILENT = 7, "the device gives no force: it has sent no sample within the deadline"
    NOT_A_NUMBER = 8, "the device is refused until armed: its position was not a finite number"
    JUMP = 9, "the device is refused until armed: its position jumped, as that of a lost encoder does"
    FROZEN = 10, "the device is refused until armed: its position stood still while the force on it changed"
    RUNAWAY = 11, "the device is refused until armed: it ran against its force, as one whose sign is wrong does"


class SpatialReading(NamedTuple):
    """Additional reading of a device of impedance type or with three axes; x and y are of the master frame.

    lateral_operator_force_n: estimate of the hand's force; lateral_force_n: force that the device applied. orientation:
    of the handle, w x y z. buttons: bit 0 is the first named button. gate: number of a `Gate`, why there is no force.
    hand_energy_j: net energy that the hand has put in [J]; coupling_energy_j: net energy that spring and damper between
    the law and the device have absorbed [J].
    """

    lateral_m: Pair = (0.0, 0.0)
    lateral_velocity_m_per_s: Pair = (0.0, 0.0)
    lateral_operator_force_n: Pair = (0.0, 0.0)
    lateral_force_n: Pair = (0.0, 0.0)
    orientation: Quaternion = UPRIGHT
    buttons: int = 0
    gate: int = 0
    hand_energy_j: float = 0.0
    coupling_energy_j: float = 0.0


class DeviceReading(NamedTuple):
    """One sample of the device: its measurements, and the actual output of its drive after its own limits."""

    position_m: float
    velocity_m_per_s: float
    operator_force_n: float
    operator_force_limited: bool
    motor_force_n: float
    motor_voltage_v: float
    end_stop: bool
    voltage_limited: bool
    torque_limited: bool
    spatial: SpatialReading | None = None


class HapticReport(NamedTuple):
    """State of a real device; a simulated one is sampled at the moment of reading and has no report.

    status: `stale` repeats the last sample, `lost` means that nothing drives the arm. age_s: age of the sample [s].
    estop_pressed: state of the device's own emergency stop. text: the newest sentence for a person, such as why the
    device is lost. counts: raw values of the newest sample, by the keys of haptic/state; empty before the first.
    """

    status: Status
    age_s: float
    estop_pressed: bool
    text: str
    counts: Mapping[str, int] = MappingProxyType({})


class SimulatedHand(NamedTuple):
    """A simulated device including the hand, used both by a rig and by a session in lockstep.

    SimulatedHand(SlideParams(2e-3, operator.to_params()), able, "a slide: chosen, not measured")

    params: parameters, of a class registered by `telenano.hand.HandPart.register`. capabilities: declared properties of
    the device. about: a sentence that the node reports at its start.
    """

    params: Any
    capabilities: Capabilities
    about: str = ""


class HapticDevice(Protocol):
    """A device with one arm and one force sensor. All methods are called from the thread of the loop.

    state: of a simulated device, everything besides its commands that determines its readings, as a NamedTuple of plain
    values, arrays and NamedTuples. The node saves it in its journal, and sets it to continue from there.
    """

    state: Any

    @property
    def capabilities(self) -> Capabilities:
        """The declared properties; they are constant, and known once a real device is open."""

    @property
    def report(self) -> HapticReport | None:
        """The state of the device at the last reading; None if it is simulated."""

    def open(self) -> None:
        """Connect, and put the drive into its safe state.

        Raises:
            DeviceError: The device is not ready; the message names the reason.
        """

    def close(self) -> None:
        """Switch the drive off and disconnect; harmless when already closed."""

    def write(self, command: DriveCommand) -> None:
        """Send the command of this period without waiting.

        A lost device raises no error; its report states the loss.

        Raises:
            DeviceError: The device is not open, or does not support the mode.
        """

    def read(self, session_time_s: float, dt_s: float) -> DeviceReading:
        """Return the newest sample of the device, without waiting.

        session_time_s (negative: not started) and dt_s (since the previous reading, > 0) are for a device with a
        simulated hand; a real hand does not need them.

        Raises:
            DeviceError: The device is not open.
        """

    def make_safe(self) -> None:
        """Bring the drive to its safe state (off) at once; never raises, even when closed."""


MODE_OFF, MODE_POSITION, MODE_FORCE = range(3)


MODE_NAMES: dict[int, str] = {MODE_OFF: "off", MODE_POSITION: "position", MODE_FORCE: "force"}
