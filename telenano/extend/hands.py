"""What every haptic device driver is to the node: declared capabilities and five verbs.

A driver obeys; it does not judge. The guard in `safety.py` stands in front of it, and what it still has to clip
(supply, current, end stops) is part of its reading. Positions and forces are along the paper's axis x, towards the
sample.
"""

from collections.abc import Mapping
from enum import IntEnum
from types import MappingProxyType
from typing import Any, Literal, NamedTuple, Protocol, Self

from telenano.wire.errors import ConfigError

Status = Literal["ok", "stale", "lost"]


class DeviceError(ConfigError, RuntimeError):
    """The device cannot do what it was asked: not open, not there, not the one that was configured, or not able."""


Pair = tuple[float, float]
Quaternion = tuple[float, float, float, float]
UPRIGHT: Quaternion = (1.0, 0.0, 0.0, 0.0)


class Capabilities(NamedTuple):
    """What a device declares about itself before anything is sent to it.

    max_stiffness_n_per_m and max_damping_n_s_per_m of an admittance device are what a loop sampled at 1 kHz can render
    passively: with physical damping b at the arm, b > K T / 2 + B (Colgate and Schenkel 1997), so K <= 2 b / T alone
    and B <= b alone. Of an impedance device they are what its maker declares for its own rate.
    """

    max_force_n: float
    max_stiffness_n_per_m: float
    max_damping_n_s_per_m: float
    workspace_min_m: float
    workspace_max_m: float
    modes: tuple[int, ...]
    identity: str = ""
    force_source: Literal["sensor", "estimate", "none"] = "sensor"
    # The mean time from a command to the tick that publishes its effect, beyond that of the simulated device [s].
    latency_s: float = 0.0
    # identity of the calibration in use
    calibration: str = ""
    # admittance: it takes a position and measures the force; impedance: it measures the position and takes a force
    kind: Literal["admittance", "impedance"] = "admittance"
    # 1: along the paper's axis; 3: with the lateral x and y of the master frame, whose workspace is in lateral_m
    axes: int = 1
    lateral_m: tuple[Pair, Pair] = ((0.0, 0.0), (0.0, 0.0))
    # The rate of the servo that drives it [Hz]; 0.0 represents that of the node.
    rate_hz: float = 0.0
    # Physical damping b [N s/m] and moving mass [kg], 0.0 where they are not known; a chosen model states it in
    # identity.
    damping_n_s_per_m: float = 0.0
    mass_kg: float = 0.0
    # From a sample to the moment at which the force that answers it acts [s].
    drive_delay_s: float = 0.0
    # names of the buttons, bit 0 first; the one that has to be held, empty if there is none
    buttons: tuple[str, ...] = ()
    deadman: str = ""
    has_orientation: bool = False


class SpatialCommand(NamedTuple):
    """What a device of impedance type or of three axes is given besides; x and y are of the master frame.

    lateral_force_n: what the hand is to feel. lateral_m: the place to which a lateral stiffness, if the coupling has
    one, draws the hand. arm: a person has armed since the command before.
    """

    lateral_m: Pair = (0.0, 0.0)
    lateral_force_n: Pair = (0.0, 0.0)
    arm: bool = False


class DriveCommand(NamedTuple):
    """What the guard lets through: a mode code and the reference of that mode; `spatial` is for some."""

    mode: int
    position_reference_m: float
    force_reference_n: float
    spatial: SpatialCommand = SpatialCommand()


class Gate(IntEnum):
    """Why an impedance device gives no force; a fault is refused until armed, and the node takes the device as lost.

    Gate(reading.spatial.gate).text    # "the device gives no force until the hand has been at rest"
    """

    text: str

    def __new__(cls, number: int, text: str = "") -> Self:
        gate = int.__new__(cls, number)
        gate._value_, gate.text = number, text
        return gate

    @property
    def is_fault(self) -> bool:
        """Whether a person has to arm the device again."""
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
    """What a device of impedance type or of three axes says besides; x and y are of the master frame.

    lateral_operator_force_n: estimate of the hand's force; lateral_force_n: what the device sent. orientation: of the
    handle, w x y z. buttons: bit 0 is the first that the device names. gate: why there is no force, of `Gate`.
    hand_energy_j: what the hand has put in, less what it got; coupling_energy_j: what spring and damper between the law
    and the device have taken in.
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
    """One sample of the device: what it measures, and what its drive really sent after its own limits."""

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
    """How a real device is doing; a simulated one is sampled in the moment of the reading and has none.

    status: `stale` repeats the last sample, `lost` means that nothing drives the arm. age_s: of the sample [s].
    estop_pressed: the emergency stop of the device itself. text: the newest sentence for a person, such as why the
    device is lost. counts: the newest sample as it was sent, by the keys of haptic/state; none before there was one.
    """

    status: Status
    age_s: float
    estop_pressed: bool
    text: str
    counts: Mapping[str, int] = MappingProxyType({})


class SimulatedHand(NamedTuple):
    """A simulated device with the hand on it, which a rig and a session in lockstep run alike.

    SimulatedHand(SlideParams(2e-3, operator.to_params()), able, "a slide: chosen, not measured")

    params: of a class that `telenano.hand.HandPart.register` knows. capabilities: what the device declares. about: a
    sentence that the node reports at its start.
    """

    params: Any
    capabilities: Capabilities
    about: str = ""


class HapticDevice(Protocol):
    """A device with one arm and one force sensor. All methods belong to the thread of the loop.

    state: of a simulated one, all that its readings depend on besides what it is sent, as a NamedTuple of plain values,
    arrays and NamedTuples. The node keeps it in its journal, and sets it to continue from there.
    """

    state: Any

    @property
    def capabilities(self) -> Capabilities:
        """Return what the device can do; constant, and of a real device known once it is open."""

    @property
    def report(self) -> HapticReport | None:
        """Return how the device was at the last reading; None if it is simulated."""

    def open(self) -> None:
        """Connect and come up in the safe state.

        Raises:
            DeviceError: The device is not ready; the message says what is missing.
        """

    def close(self) -> None:
        """Switch the drive off and disconnect; harmless when already closed."""

    def write(self, command: DriveCommand) -> None:
        """Write the command of this period, without waiting.

        A device that is lost raises nothing: its report states it.

        Raises:
            DeviceError: The device is not open, or the mode is not one of its own.
        """

    def read(self, session_time_s: float, dt_s: float) -> DeviceReading:
        """Return the newest sample of the device, without waiting.

        session_time_s (negative: not started) and dt_s (since the previous reading, > 0) are for a device whose hand is
        simulated; one with a real hand does not need them.

        Raises:
            DeviceError: The device is not open.
        """

    def make_safe(self) -> None:
        """Bring the drive to its safe state (off) now; never raises, also when closed."""


MODE_OFF, MODE_POSITION, MODE_FORCE = range(3)


MODE_NAMES: dict[int, str] = {MODE_OFF: "off", MODE_POSITION: "position", MODE_FORCE: "force"}
