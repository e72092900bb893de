"""The servo of an impedance device, and what it and the node tell each other.

The servo reads the device, calls `Servo.step`, and writes the force, at the device's own rate. It is in a process of
its own, or in the vendor's callback in such a process, never in a thread beside the loop of the node; a simulated
device runs it in virtual time. The node sends a `ServoCommand` each period and takes the newest `ServoSample`; neither
waits. Between processes both cross in a `Slot` of shared memory each.
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

# An error is a sentence of at most this number of bytes.
ERROR_BYTES = 240


class ServoCommand(NamedTuple):
    """What the node asks of the servo, once a period: its silence takes the force away.

    sent_ns: when, on the monotonic clock that both processes share. The others are those of `CouplingReference`, in the
    master frame. stop: the servo is to leave its loop, with no force.
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
    """What the device reported to the servo: its place, when it was taken, and what else it has.

    taken_ns: when the servo had it from the device, on the monotonic clock; a sample that is repeated keeps it.
    deadman_ns: when the state of the dead-man button was heard. error: a sentence if the device is lost, else empty.
    """

    position_m: Vector
    taken_ns: int
    orientation: Quaternion = UPRIGHT
    buttons: int = 0
    deadman: bool = True
    deadman_ns: int = 0
    error: str = ""


class ServoSample(NamedTuple):
    """What the servo tells the node after each of its steps; see `CouplingState` for what is not explained here.

    steps: counts the steps of the servo. late: of these, how many came more than half a period late. worst_s: the
    longest time between two steps since the servo began.
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
    """The way of the node to one impedance device and its servo. A driver of a make of devices is one of these."""

    @property
    def capabilities(self) -> Capabilities:
        """Return what the device can do; known once it is open."""

    def open(self) -> None:
        """Find the device, start its servo, and come up without force.

        Raises:
            DeviceError: The device is not ready; the message says what is missing.
        """

    def send(self, command: ServoCommand) -> None:
        """Hand the command of this period to the servo, without waiting."""

    def newest(self, session_time_s: float, dt_s: float) -> ServoSample | None:
        """Return the newest sample of the servo without waiting; None before there was one.

        The times are for a device whose hand is simulated; see `HapticDevice.read`.
        """

    def close(self) -> None:
        """Take the force away, end the servo and disconnect; harmless when already closed, and never raises."""


class Servo:
    """One device's coupling, called by whatever loop the device has; it has no clock and no input or output."""

    def __init__(self, period_s: float) -> None:
        self.state = coupling_at_start(0)
        self._period_s = period_s
        self._steps = self._late = 0
        self._worst_s = 0.0

    def step(
        self, command: ServoCommand | None, sample: DeviceSample, now_ns: int, dt_s: float
    ) -> tuple[Vector, ServoSample]:
        """Return the force to write to the device now [N, master frame], and what the node is to hear.

        Args:
            command: The newest command; None before the first, and then there is no force.
            sample: The newest word of the device.
            now_ns: The present time on the monotonic clock.
            dt_s: The time since the step before [s], > 0.
        """
        force = ZERO
        if command is not None:
            c = command
            reference = CouplingReference(
                c.position_m, c.velocity_m_per_s, c.force_n, c.engaged, (now_ns - c.sent_ns) * 1e-9, c.arm_count
            )
            # A device that is not there, or must not be driven, has no force at once, however young its sample is.
            reading = CouplingReading(
                sample.position_m,
                math.inf if sample.error else (now_ns - sample.taken_ns) * 1e-9,
                sample.deadman,
                (now_ns - sample.deadman_ns) * 1e-9,
            )
            force, self.state = coupling_step(self.state, c.settings, reference, reading, dt_s)
        self._steps += 1
        # The first step has nothing before it, and what it took to begin is no lateness.
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
# checksum and length of what follows
_HEAD = struct.Struct("<II")
# A device may give numbers of numpy.
_encode = msgspec.msgpack.Encoder(enc_hook=methodcaller("item")).encode


class Slot(Generic[T]):
    """One value of a kind in shared memory, the newest, from one writer to one reader, neither of which waits.

    It has a checksum, so that a reader never takes a value that was half written, also on a processor that orders its
    stores otherwise, and also where the writer died in the middle.
    """

    # Twice what a sample with the longest error takes [bytes].
    size = 1024

    def __init__(self, kind: type[T]) -> None:
        self._decode = msgspec.msgpack.Decoder(kind).decode
        self._last: T | None = None

    def write(self, memory: memoryview, value: T) -> None:
        """Write a value into the first `size` bytes of memory."""
        packed = _encode(value)
        memory[: _HEAD.size + len(packed)] = _HEAD.pack(zlib.crc32(packed, 1), len(packed)) + packed

    def read(self, memory: memoryview) -> T | None:
        """Return the newest whole value; the one before while another is written; None before the first."""
        for _ in range(3):
            whole = bytes(memory[: self.size])
            check, length = _HEAD.unpack_from(whole)
            packed = whole[_HEAD.size : _HEAD.size + length]
            if zlib.crc32(packed, 1) == check:
                self._last = self._decode(packed)
                break
        return self._last
