"""The interface of a device of impedance type to the servo's process: open it, run its loop, and close it.

Positions, velocities and forces are in the master frame of the messages: x to the right of the person, y away from the
person, z up, away from the sample, with the centre of the workspace at zero.
"""

import importlib
import math
from collections.abc import Callable
from typing import NamedTuple, Protocol

from pydantic import BaseModel

from telenano.extend.hands import Capabilities
from telenano_devices.impedance.coupling import Quaternion, Vector
from telenano_devices.impedance.servo import DeviceSample

# Function from a sample to the force on the hand [N], or None when the servo ends.
Turn = Callable[[DeviceSample], Vector | None]


class ImpedanceWire(Protocol):
    """One device behind its vendor's service or library."""

    def open(self) -> Capabilities:
        """Find the device and come up without force.

        Raises:
            DeviceError: The device is absent or unfit; the message says what is missing and where to get it.
        """

    def run(self, turn: Turn) -> None:
        """Call `turn` with each sample, at the rate of the device, and send the force that it returns, until None.

        Raises:
            DeviceError: The device is lost.
        """

    def session(self, runs: bool) -> None:
        """Tell an emulated device whether the session runs, for its simulated hand; send nothing to a real one."""

    def close(self) -> None:
        """Remove the force and release the device; harmless when already closed, and never raises."""


class Impedance(NamedTuple):
    """The part of a driver that the servo's process needs: `module:name` of the function that makes its wire."""

    path: str

    def wire(self, settings: BaseModel) -> ImpedanceWire:
        """Return the wire of these settings, not yet open; its module is imported now."""
        module, _, name = self.path.partition(":")
        wire: ImpedanceWire = getattr(importlib.import_module(module), name)(settings)
        return wire


def quaternion_of(r: tuple[tuple[float, float, float], ...]) -> Quaternion:
    """Return the unit quaternion (w, x, y, z) of a rotation matrix, w >= 0, computed from its largest component."""
    squares = (
        1.0 + r[0][0] + r[1][1] + r[2][2],
        1.0 + r[0][0] - r[1][1] - r[2][2],
        1.0 - r[0][0] + r[1][1] - r[2][2],
        1.0 - r[0][0] - r[1][1] + r[2][2],
    )
    i = squares.index(max(squares))
    a, b, c = r[2][1] - r[1][2], r[0][2] - r[2][0], r[1][0] - r[0][1]
    d, e, f = r[0][1] + r[1][0], r[0][2] + r[2][0], r[1][2] + r[2][1]
    rows = ((squares[0], a, b, c), (a, squares[1], d, e), (b, d, squares[2], f), (c, e, f, squares[3]))
    scale = 0.5 / math.sqrt(squares[i])
    scale = -scale if rows[i][0] < 0.0 else scale
    w, x, y, z = (value * scale for value in rows[i])
    return (w, x, y, z)
