"""Common parts of wires of devices that take a force: cadence, frame, dead-man button and capabilities.

The loop of a wire combines them:

    frame = Frame("y -x z")                   # x of the master frame is y of the device, and y is its -x
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
    """The axes of a device relative to the master frame: x to the right of the person, y away from the person, z up.

    Args:
        axes: For each axis of the master frame the axis of the device with its sign, such as `y -x z`.

    Raises:
        ValueError: An axis is missing or unknown.
    """

    def __init__(self, axes: str) -> None:
        named = axes.split()
        if sorted(name.removeprefix("-") for name in named) != ["x", "y", "z"]:
            raise ValueError(f"{axes!r} must name x, y and z once each, with a sign, such as 'y -x z'")
        self._axes = tuple(("xyz".index(name[-1]), -1.0 if name[0] == "-" else 1.0) for name in named)

    def to_master(self, of_device: Sequence[float]) -> Vector:
        """Convert a vector from the device's frame to the master frame."""
        (a, s), (b, t), (c, u) = self._axes
        return (s * of_device[a], t * of_device[b], u * of_device[c])

    def to_device(self, of_master: Vector) -> Vector:
        """Convert a vector from the master frame to the device's frame."""
        turned = [0.0, 0.0, 0.0]
        for (axis, sign), value in zip(self._axes, of_master, strict=True):
            turned[axis] = sign * value
        return (turned[0], turned[1], turned[2])

    def orientation(self, rows: Sequence[Sequence[float]]) -> Quaternion:
        """Return the orientation, in the master frame, of a rotation matrix D in the device's frame: R = P D P^T."""
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
        """Return a sample in the master frame.

        Args:
            place: The position in the frame of the device [m].
            taken_ns: The time of the sample on the monotonic clock [ns].
            buttons: A bit for each button that is held.
            deadman: The number of the button without which there is no force; None for none.
            orientation: The orientation of the handle in the master frame.
            error: The reason why the device must not be driven now; empty if it may.
        """
        held = deadman is None or bool(buttons >> deadman & 1)
        return DeviceSample(self.to_master(place), taken_ns, orientation, buttons, held, taken_ns, error)


def _times(sign: float, vector: Vector) -> Vector:
    return (sign * vector[0], sign * vector[1], sign * vector[2])


class Cadence:
    """Absolute deadlines for a loop; a turn that takes longer than its period delays those after it.

    Args:
        rate_hz: The number of turns a second [Hz].
        now_ns: The monotonic clock [ns].
        sleep: The function that waits for a time [s].
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
        """Wait until the next turn is due; long delays are not made up for."""
        self._due_ns = max(self._due_ns + self._period_ns, self._now_ns() - self._period_ns)
        if (left_ns := self._due_ns - self._now_ns()) > 0:
            self._sleep(left_ns * 1e-9)


class Declared(NamedTuple):
    """Declared values of a make: greatest force [N], stiffness [N/m], damping [N s/m], radius of the workspace [m].

    For a workspace that is not a ball, `ends` gives the limits of x, y and z in the master frame [m] instead.
    """

    force_n: float
    stiffness_n_per_m: float
    damping_n_s_per_m: float
    radius_m: float = 0.0
    ends: tuple[Span, Span, Span] | None = None


class Mechanics(NamedTuple):
    """Mass and damping of an emulated arm, chosen, not measured; zero for the unknown values of a real device."""

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
    """Return the capabilities of a device of three axes that takes a force.

    The declared delay of the drive is one period: the force for a sample is sent within its period, and one period is
    allowed for the line.

    Args:
        identity: The device in words, with its serial number.
        make: The declared values of its make.
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
        # These are along the paper's axis, which points down.
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
