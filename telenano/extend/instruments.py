"""The interface of an AFM device; that of the simulated ones is `sim.SimulatedInstrument`, and a real one has another.

A driver moves and measures, no more: what may be sent to it is decided before, by `safety.safety_step`.
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
    """The instrument cannot be driven: not reachable, not the one that was configured, or not able."""


class AfmReport(NamedTuple):
    """How a real instrument is doing; a simulated one is measured in the moment of the exchange and has none.

    status: `stale` repeats the last sample, `lost` means that nothing reaches the base. age_s: of the sample [s].
    force_valid: the input was within its range. text: the newest sentence for a person. output_v, input_v: what its
    converters had in the newest sample [V].
    """

    status: Literal["ok", "stale", "lost"]
    age_s: float
    force_valid: bool
    text: str
    output_v: float = 0.0
    input_v: float = 0.0


class LateralStage(Protocol):
    """What moves the tip over the sample."""

    def move_to(self, x_m: float, y_m: float) -> None:
        """Put the tip over a place of the sample [m], 0, 0 its middle.

        Raises:
            ValueError: The place is not finite.
        """

    @property
    def lateral_force_n(self) -> tuple[float, float]:
        """Return the force on the tip by the sample in x and y at the last exchange [N]."""


class VibratingCantilever(Protocol):
    """What vibrates the base: what tapping mode needs."""

    def vibrate(self, amplitude_m: float) -> None:
        """Drive the base so that the amplitude without a sample becomes amplitude_m [m]; 0: not at all."""

    @property
    def oscillation(self) -> Oscillation:
        """Return what was measured at the last exchange; zeros while the base is not driven."""


class OwnImage(NamedTuple):
    """An image that an instrument takes by its own scan, line by line there and back.

    Its middle and its sides [m], pixels of a line, lines, time of a line each way [s], and the force that is held [N].
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
    """A line of it: its number and sense, and the heights [m], shape (pixels,), in the order of x."""

    line: int
    backward: bool
    height_m: npt.NDArray[np.float64]


class OwnScan(Protocol):
    """The scan of an instrument that regulates and rasters by itself: what too slow a wire leaves to it.

    A driver that has one declares it by an attribute `own_scan`.
    """

    def want_image(self, image: OwnImage | None) -> None:
        """Begin an image, or continue with the one that is wanted already; None ends it, with the tip withdrawn."""

    def take_line(self) -> OwnLine | None:
        """Return the next line that is whole, once; None where there is none."""


class Relief(NamedTuple):
    """What is known in advance of the heights under the tip.

    surface: the heights as the tip sees them (`telenano.afm.Surface`), None for a plane at 0; above_m: how far what
    lies on it stands above it [m], wherever that is.
    """

    surface: Any
    above_m: float = 0.0


class Simulation(Protocol):
    """What an instrument that is simulated can be told: how time passes, and what disturbs it."""

    def elapse(self, dt: float) -> None:
        """Note that the next exchange comes so much later [s]."""

    @property
    def disturbances(self) -> Any:
        """Return what disturbs it (`telenano.settings.DisturbanceConfig`), None for one that cannot be disturbed."""

    def configure(self, config: Any) -> None:
        """Take other disturbances from now on."""

    @property
    def truths(self) -> Mapping[str, Any]:
        """Return what is so of what lies on the sample, by the name of the layer, which no instrument knows."""

    @property
    def is_spring(self) -> bool:
        """Return whether the environment is a spring."""

    def take_spring(self, stiffness_n_per_m: float) -> None:
        """Take another stiffness of the environment [N/m], which must be a spring."""

    def restore_sample(self) -> None:
        """Take a sample as it was in the beginning, with what lies on it where it lay."""

    @property
    def settles(self) -> bool:
        """Return whether there is work that nothing has to wait for, between two exchanges."""

    def settle(self) -> bool:
        """Continue by a part of what is known of the motion before the next exchange; return whether there is more."""


class AfmDriver(Protocol):
    """One AFM: a base that can be moved, a deflection that can be read.

    state: of a simulated one, all that its samples depend on besides what it is sent, as a NamedTuple of plain values,
    arrays and NamedTuples. The node keeps it in its journal, and sets it to continue from there.
    """

    state: Any

    @property
    def safe_position_m(self) -> float:
        """Base position [m] of the safe state: retracted."""

    @property
    def latency_s(self) -> float:
        """Return what a real instrument is declared to add to the round trip, in the mean [s]; 0 if simulated."""

    @property
    def calibration_identity(self) -> str:
        """Return which calibration of a real instrument is in use; empty if simulated."""

    @property
    def report(self) -> AfmReport | None:
        """Return how the instrument was at the last exchange; None if it is simulated."""

    @property
    def stage(self) -> LateralStage | None:
        """Return the lateral stage, None for an instrument that only moves its base."""

    @property
    def vibration(self) -> VibratingCantilever | None:
        """Return what vibrates the base, None for an instrument without it."""

    @property
    def simulation(self) -> Simulation | None:
        """Return the simulation, None for a real instrument."""

    @property
    def relief(self) -> Relief | None:
        """Return what is known of the heights under the tip, None for an instrument that has to find the surface."""

    def open(self) -> None:
        """Connect, and put the device into its safe state.

        Raises:
            OSError: The device cannot be reached.
            RuntimeError: The device is already open.
        """

    def exchange(self, base_m: float) -> AfmSample:
        """Apply a base position [m] and return the newest that the device measured, without waiting.

        A device that is lost raises nothing: its report states it, and the sample is the last one.

        Raises:
            ValueError: The position is not finite.
            RuntimeError: The device is not open.
        """

    def retract(self) -> bool:
        """Go to the safe state at once, and return whether the device says that it is there.

        Called on every way out, so it must work after an error of `exchange`.
        """

    def close(self) -> None:
        """Go to the safe state and disconnect; harmless when already closed."""


class SafetyParams(NamedTuple):
    """Limits; base positions and speeds along the paper's axis, towards the sample."""

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
