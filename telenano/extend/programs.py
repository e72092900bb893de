"""The interface of a program of the instrument: a class with its settings, plan, steps and report of progress.

A program moves the tip by itself, behind the guard. One file contains all of it: the settings for `set`, scenarios, the
page and the commands; the plan made from them, or the reason of a refusal; the step; and the report. The class has no
state of its own: plan and state are NamedTuples of plain values, which the journal of the node can store.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Generic, NamedTuple, Protocol, TypeVar, get_args, get_origin

import numpy as np
import numpy.typing as npt

from telenano.extend.instruments import OwnImage, OwnLine, SafetyParams
from telenano.extend.samples import Oscillation
from telenano.extend.stage import LateralParams, Place
from telenano.settings.config import Settings
from telenano.settings.program_settings import Force as Force
from telenano.settings.program_settings import Length as Length
from telenano.settings.program_settings import Position as Position
from telenano.settings.program_settings import ProgramSettings as ProgramSettings
from telenano.settings.program_settings import Speed as Speed
from telenano.wire.messages import Scalar

Array = npt.NDArray[np.float64]
S = TypeVar("S", bound=Settings)
P = TypeVar("P", bound=tuple[object, ...])
T = TypeVar("T", bound=tuple[object, ...])


class Span(NamedTuple):
    """Lowest and highest point of a part of a surface [m]."""

    low_m: float
    high_m: float


class Reach(Protocol):
    """Checks whether the base reaches a surface of known heights, and clears it again.

    surface: the heights as the tip sees them, None for a plane at height 0. A fault is a sentence, or empty.
    """

    @property
    def surface(self) -> Any: ...

    def within(self, centre: Place, width_m: float, depth_m: float) -> Span:
        """Return lowest and highest point of a rectangle around a place."""

    def along(self, begin: Place, end: Place) -> Span:
        """Return lowest and highest point along a straight line."""

    def depth_fault(self, span: Span, press_m: float = 0.0) -> str:
        """Return the fault that the base cannot bring the tip to the lowest point and press it by `press_m` [m]."""

    def clearance_fault(self, span: Span, base_m: float, remedy: str, lift_m: float = 0.0) -> str:
        """Return the fault that a tip with its base at `base_m` [m] hits the highest point; `remedy` has {base:g}."""

    def retracted_fault(self, span: Span, lift_m: float = 0.0) -> str:
        """Return the fault that a retracted tip hits the highest point."""


class Instrument(NamedTuple):
    """Facts on the instrument for a program, known before it begins.

    limits: of the guard; lateral: limits of the stage, None without a stage; size_m: sides of the sample [m];
    stiffness_n_per_m: of the cantilever; period_s: of the node; can_vibrate: whether the base can be driven; lag: share
    of a change of the amplitude that remains after a period; reach: of the base over a surface of known heights, None
    for an instrument that must find the surface; lateral_uncertainty: relative, of the calibration of the lateral
    force; scans: whether the instrument takes images by its own scan.
    """

    limits: SafetyParams
    lateral: LateralParams | None
    size_m: tuple[float, float]
    stiffness_n_per_m: float
    period_s: float
    can_vibrate: bool = False
    lag: float = 0.0
    reach: Reach | None = None
    lateral_uncertainty: float = 0.0
    scans: bool = False

    def approach_limit_s(self, speed_m_per_s: float) -> float:
        """Return the time after which an approach at a speed [m/s] that has found no surface is hopeless [s]."""
        return approach_limit_s(self.limits, self.limits.retract_position_m, speed_m_per_s)


class Inputs(NamedTuple):
    """Inputs of a program's step.

    Measurements of the previous step: base x_s [m] and place of the stage; force on the tip along z, and along x and y
    [N]; oscillation of the tip. pointer: place where a person wants the tip; is_paused: whether the program must stand
    still; own: the next line of an image that the instrument takes by itself.
    """

    base_m: float
    place: Place
    force_n: float
    lateral_n: tuple[float, float]
    oscillation: Oscillation
    pointer: Place
    is_paused: bool = False
    own: OwnLine | None = None


@dataclass(frozen=True)
class Way:
    """A step towards the surface: phase, time in it [s], and targets of base [m] and stage."""

    # The phases of the approach; those of the program itself follow.
    RISE: ClassVar[int] = 0
    TRAVEL: ClassVar[int] = 1
    APPROACH: ClassVar[int] = 2
    ARRIVED: ClassVar[int] = 3
    # Texts in which the phases are reported.
    TEXTS: ClassVar[tuple[str, ...]] = ("the tip rises", "the stage moves to the first point", "approach")

    phase: int
    elapsed_s: float
    base_m: float
    place: Place

    @classmethod
    def to_surface(
        cls,
        phase: int,
        elapsed_s: float,
        inputs: Inputs,
        first: Place,
        clear_m: float,
        step_m: float,
        touches: bool,
        dt: float,
    ) -> "Way":
        """Move the tip up, above the first point, and down until it touches; then the phase is ARRIVED.

        Args:
            phase: RISE, TRAVEL or APPROACH.
            elapsed_s: Time in the phase [s].
            inputs: The measurements of the last step.
            first: The first point.
            clear_m: Base position that is above every point [m].
            step_m: Approach of the base in dt [m].
            touches: Whether the tip has reached its criterion of contact.
            dt: Time of the step [s].
        """
        if phase == cls.RISE:
            return cls(cls.TRAVEL if inputs.base_m <= clear_m else cls.RISE, 0.0, clear_m, inputs.place)
        if phase == cls.TRAVEL:
            return cls(cls.APPROACH if inputs.place == first else cls.TRAVEL, 0.0, clear_m, first)
        if touches:
            # The program continues from the present base position.
            return cls(cls.ARRIVED, 0.0, inputs.base_m, first)
        return cls(cls.APPROACH, elapsed_s + dt, inputs.base_m + step_m, first)


class FinishedLine(NamedTuple):
    """A line of an image: number, direction, ends (centres of the outer pixels), heights [m], forces in x [N].

    Amplitude [m], phase lag behind the drive [rad] and energy dissipated by the sample per period [J] are None in
    contact mode. The forces are None if the instrument takes the image by itself and does not measure them.
    """

    line: int
    backward: bool
    start: Place
    end: Place
    height_m: Array
    lateral_n: Array | None
    amplitude_m: Array | None = None
    phase_rad: Array | None = None
    dissipated_j: Array | None = None


class Begun(NamedTuple, Generic[P, T]):
    """Start of a program: its plan and first state, a sentence for the caller, and a warning for the events."""

    plan: P
    state: T
    text: str
    notice: str = ""


class Wanted(NamedTuple, Generic[T]):
    """Result of a program's step: its state, and targets of base x_s [m] and stage.

    is_done: the program is over and the tip must retract; line: a finished line of an image; amplitude_m: of the
    vibration without a sample [m]; notice: a warning for the events; image: the image to take by the instrument's own
    scan.
    """

    state: T
    base_m: float
    place: Place
    is_done: bool = False
    line: FinishedLine | None = None
    amplitude_m: float = 0.0
    notice: str = ""
    image: OwnImage | None = None


class Progress(NamedTuple):
    """Progress of a program: a text, a share from 0 to 1, finished and total lines, and measured values by name."""

    text: str
    share: float
    line: int = 0
    lines: int = 0
    values: Mapping[str, Scalar] | None = None


class Program(ABC, Generic[S, P, T]):
    """A program of the instrument.

    settings: the model of its section, with units, bounds and defaults; title: its name on the page; about: one line
    for a person; label: its name in sentences, if it differs from that in the table; can_pause: whether it can stand
    still and continue; leaves_tip: whether the stage stays where the program ends, for a hand that continues there;
    moves_across: whether it needs an instrument that moves the tip over the sample.
    """

    settings: type[S]
    title: ClassVar[str]
    about: ClassVar[str]
    label: ClassVar[str] = ""
    can_pause: ClassVar[bool] = False
    leaves_tip: ClassVar[bool] = False
    moves_across: ClassVar[bool] = False

    @classmethod
    def kinds(cls) -> tuple[type[P], type[T]]:
        """Return the classes of the plan and of the state."""
        bases = (base for kind in cls.__mro__ for base in getattr(kind, "__orig_bases__", ()))
        _, plan, state = get_args(next(base for base in bases if get_origin(base) is Program))
        return plan, state

    @abstractmethod
    def begin(self, settings: S, instrument: Instrument, place: Place) -> Begun[P, T]:
        """Return plan and first state for a tip at `place`; raise RefusedError, with the reason, if impossible."""

    @abstractmethod
    def step(self, plan: P, state: T, inputs: Inputs, dt: float) -> Wanted[T]:
        """Return the next state and the targets of base and stage for the next dt [s]; a pure function."""

    @abstractmethod
    def progress(self, plan: P, state: T) -> Progress:
        """Return the progress of the program."""

    def searching_s(self, plan: P, state: T) -> tuple[float, float]:
        """Return the time of the present search for the surface, and its limit [s]; (0, inf) if there is none."""
        return 0.0, math.inf

    def shortfall(self, plan: P, state: T) -> str:
        """Return a sentence on the parts that a finished program did not reach; empty if it reached all."""
        return ""


AnyProgram = Program[Any, Any, Any]

# Additional time for the base's whole travel, because it may still be accelerating after a hold.
_SPARE_S = 1.0


def approach_limit_s(limits: SafetyParams, clear_m: float, speed_m_per_s: float) -> float:
    """Return the time [s] in which a base that approaches from `clear_m` [m] has certainly covered its whole travel."""
    speed = min(speed_m_per_s, limits.base_speed_m_per_s)
    return (limits.base_max_m - clear_m) / speed + _SPARE_S
