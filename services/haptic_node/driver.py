"""What every haptic device driver is to the node: declared capabilities and five verbs.

A driver obeys; it does not judge. The guard in `safety.py` stands in front of it, and what it still has to clip
(supply, current, end stops) is part of its reading. Positions and forces are along the paper's axis x, towards the
sample.
"""

from typing import NamedTuple, Protocol


class DeviceError(RuntimeError):
    """The device cannot do what it was asked: not open, not there, or not able."""


class Capabilities(NamedTuple):
    """What a device declares about itself before anything is sent to it.

    max_stiffness_n_per_m and max_damping_n_s_per_m are what a loop sampled at 1 kHz can render passively: with physical
    damping b at the arm, b > K T / 2 + B (Colgate and Schenkel 1997), so K <= 2 b / T alone and B <= b alone.
    """

    max_force_n: float
    max_stiffness_n_per_m: float
    max_damping_n_s_per_m: float
    workspace_min_m: float
    workspace_max_m: float
    modes: tuple[int, ...]


class DriveCommand(NamedTuple):
    """What the guard lets through: a mode code and the reference of that mode."""

    mode: int
    position_reference_m: float
    force_reference_n: float


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


class HapticDevice(Protocol):
    """A device with one arm and one force sensor. All methods belong to the thread of the loop."""

    @property
    def capabilities(self) -> Capabilities:
        """Return what the device can do; constant, and known before it is open."""

    def open(self) -> None:
        """Connect and come up in the safe state. Raises DeviceError saying what is missing."""

    def close(self) -> None:
        """Switch the drive off and disconnect; harmless when already closed."""

    def write(self, command: DriveCommand) -> None:
        """Write the command of this period. Raises DeviceError if not open or the mode is not one of its own."""

    def read(self, session_time_s: float, dt_s: float) -> DeviceReading:
        """Sample the device. Raises DeviceError if not open.

        session_time_s (negative: not started) and dt_s (since the previous reading, > 0) are for a device whose hand is
        simulated; one with a real hand does not need them.
        """

    def make_safe(self) -> None:
        """Bring the drive to its safe state (off) now; never raises, also when closed."""
