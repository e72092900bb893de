"""The interface of an AFM driver; `telenano.afm.sim.SimulatedInstrument` and the drivers of real devices implement it.

A driver only moves and measures; `safety.safety_step` decides before what may be sent to it.
"""

import math
from collections.abc import Mapping
from typing import Any, Literal, NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from telenano.extend.samples import AfmSample
from telenano.extend.samples import Oscillation as Oscillation
from telenano.wire.errors import ConfigError


class DeviceError(ConfigError, OSError):
    """The instrument cannot be driven: it is unreachable, not the configured one, or incapable."""


class AfmReport(NamedTuple):
    """State of a real instrument; a simulated one is measured at the moment of the exchange and has no report.

    status: `stale` repeats the last sample, `lost` means that nothing reaches the base. age_s: age of the sample [s].
    force_valid: whether the input was within its range. text: the newest sentence for a person. output_v, input_v:
    voltages of the converters in the newest sample [V].
    """

    status: Literal["ok", "stale", "lost"]
    age_s: float
    force_valid: bool
    text: str
    output_v: float = 0.0
    input_v: float = 0.0


class LateralStage(Protocol):
    """Lateral stage, which moves the tip over the sample."""

    def move_to(self, x_m: float, y_m: float) -> None:
        """Move the tip over a place of the sample [m]; (0, 0) is its centre.

        Raises:
            ValueError: The place is not finite.
        """

    @property
    def lateral_force_n(self) -> tuple[float, float]:
        """Force on the tip by the sample in x and y at the last exchange [N]."""


class VibratingCantilever(Protocol):
    """Drive that vibrates the base, for tapping mode."""

    def vibrate(self, amplitude_m: float) -> None:
        """Drive the base so that the amplitude without a sample becomes `amplitude_m` [m]; 0 switches the drive off."""

    @property
    def oscillation(self) -> Oscillation:
        """Oscillation measured at the last exchange; zeros while the base is not driven."""


class OwnImage(NamedTuple):
    """An image that the instrument takes by its own scan, each line there and back.

    Centre and sides [m], pixels per line, number of lines, time of a line in each direction [s], and force set-point
    [N].
    """

    x_m: float
    y_m: float
    width_m: float
    depth_m: float
    pixels: int
    lines: int
    line_s: float
    setpoint_n: float


class OwnLine(NamedTuple):
    """A line of an own image: number, direction, and heights [m], shape (pixels,), in the order of x."""

    line: int
    backward: bool
    height_m: npt.NDArray[np.float64]


class OwnScan(Protocol):
    """Scan of an instrument that regulates and scans by itself, because its connection is too slow for our feedback.

    A driver with such a scan has an attribute `own_scan`.
    """

    def want_image(self, image: OwnImage | None) -> None:
        """Begin an image, or continue if it is the present one; None ends it with the tip withdrawn."""

    def take_line(self) -> OwnLine | None:
        """Return the next finished line, each only once; None if there is none."""


class Relief(NamedTuple):
    """Heights under the tip that are known in advance.

    surface: the heights as the tip sees them (`telenano.afm.Surface`), None for a plane at 0; above_m: greatest height
    of objects on the surface above it [m], wherever they lie.
    """

    surface: Any
    above_m: float = 0.0


class Simulation(Protocol):
    """Interface to a simulated instrument: passing of time, disturbances, sample."""

    def elapse(self, dt: float) -> None:
        """Let the next exchange come `dt` [s] after the previous one."""

    @property
    def disturbances(self) -> Any:
        """The disturbances (`telenano.settings.DisturbanceConfig`); None if the simulation has none."""

    def configure(self, config: Any) -> None:
        """Use other disturbances from now on."""

    @property
    def truths(self) -> Mapping[str, Any]:
        """The true state of objects on the sample, by name of the layer, which no real instrument knows."""

    @property
    def is_spring(self) -> bool:
        """Whether the environment is a spring."""

    def take_spring(self, stiffness_n_per_m: float) -> None:
        """Set the stiffness of the environment [N/m], which must be a spring."""

    def restore_sample(self) -> None:
        """Restore the initial sample, with objects on it at their initial places."""

    @property
    def settles(self) -> bool:
        """Whether there is work that can be done in the pause between two exchanges."""

    def settle(self) -> bool:
        """Do a part of the computation of the motion before the next exchange; return whether there is more."""


class AfmDriver(Protocol):
    """One AFM: a base that can be moved, and a deflection that can be read.

    state: of a simulated AFM, everything besides its commands that determines its samples, as a NamedTuple of plain
    values, arrays and NamedTuples. The node saves it in its journal, and sets it to continue from there.
    """

    state: Any

    @property
    def safe_position_m(self) -> float:
        """Base position [m] of the safe state: retracted."""

    @property
    def latency_s(self) -> float:
        """Declared mean latency that a real instrument adds to the round trip [s]; 0 if simulated."""

    @property
    def calibration_identity(self) -> str:
        """Identity of the calibration of a real instrument; empty if simulated."""

    @property
    def report(self) -> AfmReport | None:
        """The state of the instrument at the last exchange; None if it is simulated."""

    @property
    def stage(self) -> LateralStage | None:
        """The lateral stage; None for an instrument that only moves its base."""

    @property
    def vibration(self) -> VibratingCantilever | None:
        """The drive that vibrates the base; None for an instrument without one."""

    @property
    def simulation(self) -> Simulation | None:
        """The simulation; None for a real instrument."""

    @property
    def relief(self) -> Relief | None:
        """The known heights under the tip; None for an instrument that must find the surface."""

    def open(self) -> None:
        """Connect, and put the device into its safe state.

        Raises:
            OSError: The device cannot be reached.
            RuntimeError: The device is already open.
        """

    def exchange(self, base_m: float) -> AfmSample:
        """Apply a base position [m] and return the newest sample of the device, without waiting.

        A lost device raises no error: its report states the loss, and the last sample is repeated.

        Raises:
            ValueError: The position is not finite.
            RuntimeError: The device is not open.
        """

    def retract(self) -> bool:
        """Go to the safe state at once, and return whether the device confirms that it is there.

        It is called on every exit, so it must also work after an error of `exchange`.
        """

    def close(self) -> None:
        """Go to the safe state and disconnect; harmless when already closed."""


class SafetyParams(NamedTuple):
    """Limits of the guard; base positions and speeds are along the paper's axis, towards the sample."""

    base_min_m: float
    base_max_m: float
    base_speed_m_per_s: float
    resume_acceleration_m_per_s2: float
    retract_position_m: float
    retract_speed_m_per_s: float
    force_limit_n: float
    command_deadline_s: float
    hold_time_s: float
    lateral_limit_n: float = math.inf
