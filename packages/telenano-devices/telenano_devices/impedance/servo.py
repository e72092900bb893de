"""The servo of an impedance device, and the messages between it and the node.

The servo reads the device, calls `Servo.step`, and writes the force, at the device's own rate. It runs in a process of
its own, or in the vendor's callback in such a process, never in a thread beside the loop of the node; a simulated
device runs it in virtual time. The node sends a `ServoCommand` each period and reads the newest `ServoSample`; neither
side waits. Between processes each of the two is in a `Slot` of shared memory.
"""

import math
import struct
import zlib
from operator import methodcaller
from typing import Any, Generic, NamedTuple, Protocol, TypeVar

import msgspec

from telenano.extend.hands import Capabilities, Gate
from telenano_devices.impedance.coupling import (
    UPRIGHT,
    ZERO,
    CouplingReading,
    CouplingReference,
    CouplingSettings,
    Quaternion,
    Vector,
    coupling_at_start,
    coupling_step,
)

# The largest size of an error text [bytes].
ERROR_BYTES = 240


class ServoCommand(NamedTuple):
    """The command of the node to the servo, once a period; without it the servo removes the force.

    sent_ns: time of sending on the monotonic clock that both processes share [ns]. stop: the servo has to leave its
    loop, with no force. The other fields are those of `CouplingReference`, in the master frame.
    """

    counter: int
    sent_ns: int
    position_m: Vector
    velocity_m_per_s: Vector
    force_n: Vector
    engaged: bool
    arm_count: int
    stop: bool
    settings: CouplingSettings


class DeviceSample(NamedTuple):
    """A sample of the device for the servo: position [m], time, orientation, buttons and dead-man button.

    taken_ns: time at which the servo got it, on the monotonic clock [ns]; a repeated sample keeps its time. deadman_ns:
    time at which the state of the dead-man button was reported [ns]. error: a sentence if the device is lost or must
    not be driven, else empty.
    """

    position_m: Vector
    taken_ns: int
    orientation: Quaternion = UPRIGHT
    buttons: int = 0
    deadman: bool = True
    deadman_ns: int = 0
    error: str = ""


class ServoSample(NamedTuple):
    """The report of the servo to the node after each step; see `CouplingState` for the fields not explained here.

    counter: number of steps of the servo. answered: counter of the newest command. late: number of steps that came more
    than half a period late. worst_s: longest time between two steps since the servo began [s].
    """

    counter: int = 0
    taken_ns: int = 0
    position_m: Vector = ZERO
    velocity_m_per_s: Vector = ZERO
    force_n: Vector = ZERO
    orientation: Quaternion = UPRIGHT
    buttons: int = 0
    gate: int = Gate.REST
    limited: bool = False
    hand_energy_j: float = 0.0
    coupling_energy_j: float = 0.0
    arm_count: int = 0
    answered: int = 0
    late: int = 0
    worst_s: float = 0.0
    error: str = ""


class ServoLink(Protocol):
    """The node's connection to one impedance device and its servo."""

    @property
    def capabilities(self) -> Capabilities:
        """Return the capabilities of the device; known once it is open."""

    def open(self) -> None:
        """Find the device, start its servo, and come up without force.

        Raises:
            DeviceError: The device is not ready; the message says what is missing.
        """

    def send(self, command: ServoCommand) -> None:
        """Pass the command of this period to the servo, without waiting."""

    def newest(self, session_time_s: float, dt_s: float) -> ServoSample | None:
        """Return the newest sample of the servo without waiting; None before the first.

        The times are for a device whose hand is simulated; see `HapticDevice.read`.
        """

    def close(self) -> None:
        """Remove the force, end the servo and disconnect; harmless when already closed, and never raises."""


class Servo:
    """The coupling of one device, called by the loop of that device; it has no clock and no input or output."""

    def __init__(self, period_s: float) -> None:
        self.state = coupling_at_start(0)
        self._period_s = period_s
        self._steps = self._late = 0
        self._worst_s = 0.0

    def step(
        self, command: ServoCommand | None, sample: DeviceSample, now_ns: int, dt_s: float
    ) -> tuple[Vector, ServoSample]:
        """Return the force to write to the device now [N, master frame], and the sample for the node.

        Args:
            command: The newest command; None before the first, when there is no force.
            sample: The newest sample of the device.
            now_ns: The present time on the monotonic clock [ns].
            dt_s: The time since the previous step [s], > 0.
        """
        force = ZERO
        if command is not None:
            c = command
            reference = CouplingReference(
                c.position_m, c.velocity_m_per_s, c.force_n, c.engaged, (now_ns - c.sent_ns) * 1e-9, c.arm_count
            )
            # A device that is lost or must not be driven gets no force at once, even with a fresh sample.
            reading = CouplingReading(
                sample.position_m,
                math.inf if sample.error else (now_ns - sample.taken_ns) * 1e-9,
                sample.deadman,
                (now_ns - sample.deadman_ns) * 1e-9,
            )
            force, self.state = coupling_step(self.state, c.settings, reference, reading, dt_s)
        self._steps += 1
        # The time before the first step is no lateness.
        if self._steps > 1:
            self._late += dt_s > 1.5 * self._period_s
            self._worst_s = max(self._worst_s, dt_s)
        state = self.state
        return force, ServoSample(
            counter=self._steps,
            taken_ns=sample.taken_ns,
            position_m=state.position_m if state.started else sample.position_m,
            velocity_m_per_s=state.velocity_m_per_s,
            force_n=force,
            orientation=sample.orientation,
            buttons=sample.buttons,
            gate=state.gate,
            limited=state.limited,
            hand_energy_j=state.hand_energy_j,
            coupling_energy_j=state.coupling_energy_j,
            arm_count=state.arm_count,
            answered=0 if command is None else command.counter,
            late=self._late,
            worst_s=self._worst_s,
            error=sample.error.encode()[:ERROR_BYTES].decode(errors="replace"),
        )


T = TypeVar("T", bound=tuple[Any, ...])
# Checksum and length of the packed value that follows.
_HEAD = struct.Struct("<II")
# A device may return NumPy scalars.
_encode = msgspec.msgpack.Encoder(enc_hook=methodcaller("item")).encode


class Slot(Generic[T]):
    """The newest value of one type in shared memory, from one writer to one reader, neither of which waits.

    It has a checksum, so that a reader never accepts a half-written value, even on a processor that reorders stores, or
    if the writer died in the middle.
    """

    # Size of a slot [bytes], twice that of a sample with the longest error.
    size = 1024

    def __init__(self, kind: type[T]) -> None:
        self._decode = msgspec.msgpack.Decoder(kind).decode
        self._last: T | None = None

    def write(self, memory: memoryview, value: T) -> None:
        """Write a value into the first `size` bytes of memory."""
        packed = _encode(value)
        memory[: _HEAD.size + len(packed)] = _HEAD.pack(zlib.crc32(packed, 1), len(packed)) + packed

    def read(self, memory: memoryview) -> T | None:
        """Return the newest complete value, the previous one while another is being written, None before the first."""
        for _ in range(3):
            whole = bytes(memory[: self.size])
            check, length = _HEAD.unpack_from(whole)
            packed = whole[_HEAD.size : _HEAD.size + length]
            if zlib.crc32(packed, 1) == check:
                self._last = self._decode(packed)
                break
        return self._last
