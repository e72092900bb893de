"""What wires of devices that take a force have in common: cadence, frame, dead-man button, and what they declare.

frame = Frame("y -x z")                       # x of the master frame is y of the device, and y is its -x
cadence = Cadence(settings.rate_hz)
while (force := turn(frame.sample(place, taken_ns, buttons=mask, deadman=settings.deadman_button))) is not None:
send(*frame.to_device(force))
cadence.wait()
"""

import time
from collections.abc import Callable, Sequence
from typing import NamedTuple

from telenano.extend.hands import MODE_OFF, MODE_POSITION, Capabilities
from telenano_devices.impedance.coupling import UPRIGHT, Quaternion, Vector
from telenano_devices.impedance.impedance_wire import quaternion_of
from telenano_devices.impedance.servo import DeviceSample

Span = tuple[float, float]


class Frame:
    """The axes of a device in those of the master: x to the right of the person, y away from the person, z up.

    Args:
        axes: For each axis of the master the one of the device, with its sign, such as `y -x z`.

    Raises:
        ValueError: An axis is missing, or is none.
    """

    def __init__(self, axes: str) -> None:
        named = axes.split()
        if sorted(name.removeprefix("-") for name in named) != ["x", "y", "z"]:
            raise ValueError(f"{axes!r} must name x, y and z once each, with a sign, such as 'y -x z'")
        self._axes = tuple(("xyz".index(name[-1]), -1.0 if name[0] == "-" else 1.0) for name in named)

    def to_master(self, of_device: Sequence[float]) -> Vector:
        """Return a vector of the device in the master frame."""
        (a, s), (b, t), (c, u) = self._axes
        return (s * of_device[a], t * of_device[b], u * of_device[c])

    def to_device(self, of_master: Vector) -> Vector:
        """Return a vector of the master frame in that of the device."""
        turned = [0.0, 0.0, 0.0]
        for (axis, sign), value in zip(self._axes, of_master, strict=True):
            turned[axis] = sign * value
        return (turned[0], turned[1], turned[2])

    def orientation(self, rows: Sequence[Sequence[float]]) -> Quaternion:
        """Return the orientation of a rotation matrix D in the frame of the device, by its rows: R = P D P^T."""
        turned = [self.to_master(row) for row in rows]
        return quaternion_of(tuple(_times(sign, turned[axis]) for axis, sign in self._axes))

    def sample(
        self,
        place: Sequence[float],
        taken_ns: int,
        *,
        buttons: int = 0,
        deadman: int | None = None,
        orientation: Quaternion = UPRIGHT,
        error: str = "",
    ) -> DeviceSample:
        """Return a sample of a place in the frame of the device [m].

        Args:
            place: The place in the frame of the device [m].
            taken_ns: When it was taken, on the monotonic clock [ns].
            buttons: A bit for each button that is held.
            deadman: The number of the button without which there is no force; None for none.
            orientation: The orientation of the handle in the master frame.
            error: Why the device must not be driven now; empty if it may.
        """
        held = deadman is None or bool(buttons >> deadman & 1)
        return DeviceSample(self.to_master(place), taken_ns, orientation, buttons, held, taken_ns, error)


def _times(sign: float, vector: Vector) -> Vector:
    return (sign * vector[0], sign * vector[1], sign * vector[2])


class Cadence:
    """An absolute cadence: a turn that takes longer than its period moves those after it, and is not made up for.

    Args:
        rate_hz: The turns in a second [Hz].
        now_ns: The monotonic clock [ns].
        sleep: Waits for a time [s].
    """

    def __init__(
        self,
        rate_hz: float,
        now_ns: Callable[[], int] = time.monotonic_ns,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self._period_ns, self._now_ns, self._sleep = round(1e9 / rate_hz), now_ns, sleep
        self._due_ns = now_ns()

    def wait(self) -> None:
        """Wait until the next turn is due."""
        self._due_ns = max(self._due_ns + self._period_ns, self._now_ns() - self._period_ns)
        if (left_ns := self._due_ns - self._now_ns()) > 0:
            self._sleep(left_ns * 1e-9)


class Declared(NamedTuple):
    """What a make declares: greatest force [N], stiffness [N/m], damping [N s/m], and the radius of its workspace [m].

    A workspace that is no ball has `ends` of x, y and z in the master frame [m] in place of a radius.
    """

    force_n: float
    stiffness_n_per_m: float
    damping_n_s_per_m: float
    radius_m: float = 0.0
    ends: tuple[Span, Span, Span] | None = None


class Mechanics(NamedTuple):
    """The arm of an emulator: chosen, and not measured; that of a real device is not known, which is zero."""

    mass_kg: float = 0.0
    damping_n_s_per_m: float = 0.0


def declared(
    identity: str,
    make: Declared,
    rate_hz: float,
    *,
    arm: Mechanics | None = None,
    buttons: tuple[str, ...] = (),
    deadman: str = "",
    has_orientation: bool = False,
) -> Capabilities:
    """Return what a device of three axes that takes a force declares.

    The force of a sample is sent within its period, and a period more is allowed for the line.

    Args:
        identity: The device in words, with its serial number.
        make: What its make declares.
        rate_hz: The rate of the servo [Hz].
        arm: The arm of an emulated device; None for a real one.
        buttons: The names of the buttons.
        deadman: The name of the button without which there is no force; empty for none.
        has_orientation: Whether the handle has an orientation.
    """
    ball = (-make.radius_m, make.radius_m)
    x, y, z = make.ends or (ball, ball, ball)
    mechanics = arm or Mechanics()
    return Capabilities(
        max_force_n=make.force_n,
        max_stiffness_n_per_m=make.stiffness_n_per_m,
        max_damping_n_s_per_m=make.damping_n_s_per_m,
        # Along the paper's axis, which goes down.
        workspace_min_m=-z[1],
        workspace_max_m=-z[0],
        modes=(MODE_OFF, MODE_POSITION),
        identity=identity + ("" if arm is None else ", emulated"),
        force_source="estimate",
        kind="impedance",
        axes=3,
        lateral_m=(x, y),
        rate_hz=float(rate_hz),
        damping_n_s_per_m=mechanics.damping_n_s_per_m,
        mass_kg=mechanics.mass_kg,
        drive_delay_s=1.0 / rate_hz,
        buttons=buttons,
        deadman=deadman,
        has_orientation=has_orientation,
    )
