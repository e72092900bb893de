"""What a program of the instrument is: a class with its settings, its plan, its steps, and words about its progress.

A program moves the tip by itself, behind the guard. One file has all of it: the settings that `set`, a scenario, the
page and the commands take, the plan that is made of them or the reason why not, the step, and the report. A class has
no state of its own: plan and state are NamedTuples of plain values, which the journal of the node can keep.
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
    """Whether the base reaches a surface of known heights, and comes clear of it again.

    surface: the heights as the tip sees them, None for a plane at height 0. A fault is a sentence, empty without one.
    """

    @property
    def surface(self) -> Any: ...

    def within(self, centre: Place, width_m: float, depth_m: float) -> Span:
        """Return the heights of a rectangle around a place."""

    def along(self, begin: Place, end: Place) -> Span:
        """Return the heights of a straight line."""

    def depth_fault(self, span: Span, press_m: float = 0.0) -> str:
        """Return why the base does not bring the tip to the lowest point, pressed by press_m [m]."""

    def clearance_fault(self, span: Span, base_m: float, remedy: str, lift_m: float = 0.0) -> str:
        """Return why a tip with its base at base_m [m] hits the highest point; remedy names {base:g} [m]."""

    def retracted_fault(self, span: Span, lift_m: float = 0.0) -> str:
        """Return why a retracted tip hits the highest point."""


class Instrument(NamedTuple):
    """What a program may know of the instrument before it begins.

    limits of the guard and of the stage, None where there is none; size_m, sides of the sample [m]; stiffness_n_per_m,
    of the cantilever; period_s, of the node; can_vibrate, the base can be driven; lag, what is left of a change of the
    amplitude after a period; reach, of the base over a surface whose heights are known, None for an instrument that
    has to find the surface; lateral_uncertainty, relative, of the calibration of the lateral force; scans, the
    instrument takes images by its own scan.
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
        """Return the time after which an approach at a speed [m/s] has certainly found no surface [s]."""
        return approach_limit_s(self.limits, self.limits.retract_position_m, speed_m_per_s)


class Inputs(NamedTuple):
    """What a program is given at each step.

    Measured at the step before: base x_s [m] and place of the stage; force along z, and along x and y, on the tip [N];
    vibration of the tip. pointer, where a person wants the tip; is_paused, the program is to stand where it is; own,
    the next line of an image that the instrument takes by itself.
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
    """A step towards the surface: phase, time in it [s], and where base [m] and stage are to go."""

    # the phases of the way; those of a program itself come after
    RISE: ClassVar[int] = 0
    TRAVEL: ClassVar[int] = 1
    APPROACH: ClassVar[int] = 2
    ARRIVED: ClassVar[int] = 3
    # Each phase is reported in these words.
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
        """Take the tip up, above the first point, and down until it touches; then the phase is ARRIVED.

        Args:
            phase: RISE, TRAVEL or APPROACH.
            elapsed_s: Time in the phase [s].
            inputs: What was measured at the last step.
            first: The first point.
            clear_m: Base above every point [m].
            step_m: How far the base approaches in dt [m].
            touches: Whether the tip feels what it approaches for.
            dt: Time of the step [s].
        """
        if phase == cls.RISE:
            return cls(cls.TRAVEL if inputs.base_m <= clear_m else cls.RISE, 0.0, clear_m, inputs.place)
        if phase == cls.TRAVEL:
            return cls(cls.APPROACH if inputs.place == first else cls.TRAVEL, 0.0, clear_m, first)
        if touches:
            # the base continues from where it is
            return cls(cls.ARRIVED, 0.0, inputs.base_m, first)
        return cls(cls.APPROACH, elapsed_s + dt, inputs.base_m + step_m, first)


class FinishedLine(NamedTuple):
    """A line: its number and sense, its ends at the middles of the outer pixels, heights [m], forces in x [N].

    Amplitude [m], lag behind the drive [rad] and energy that the sample takes in a period [J], None in contact mode;
    the forces are None where the instrument takes the image and measures none.
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
    """A program that begins: its plan and first state, a sentence for the caller, and a warning for the events."""

    plan: P
    state: T
    text: str
    notice: str = ""


class Wanted(NamedTuple, Generic[T]):
    """What a program asks for the next step: its state, and where base x_s [m] and stage are to go.

    is_done: the tip is to retract; line, an image line that was finished; amplitude_m, of the vibration without a
    sample [m]; notice, a warning for the events; image, what the instrument is to take by its own scan.
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
    """How far a program is: in words, as a share of 1, in lines where it has any, and what it has measured by name."""

    text: str
    share: float
    line: int = 0
    lines: int = 0
    values: Mapping[str, Scalar] | None = None


class Program(ABC, Generic[S, P, T]):
    """A program of the instrument.

    settings: the model of its section, with units, bounds and defaults; title: what the page calls it; about: one line
    for a person; label: its name in sentences, where it differs from the one in the table; can_pause: it can stand
    where it is, and continue; leaves_tip: the stage stays where the program ends, for a hand that continues from there;
    moves_across: it needs an instrument that moves the tip over the sample.
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
        """Return the plan and the first state for a tip at `place`; RefusedError says why it cannot be done."""

    @abstractmethod
    def step(self, plan: P, state: T, inputs: Inputs, dt: float) -> Wanted[T]:
        """Return the next state and where base and stage are to go in the next dt [s]; it is a pure function."""

    @abstractmethod
    def progress(self, plan: P, state: T) -> Progress:
        """Return how far it is."""

    def searching_s(self, plan: P, state: T) -> tuple[float, float]:
        """Return for how long it has looked for the surface, and how long it may [s]; (0, inf) where it does not."""
        return 0.0, math.inf

    def shortfall(self, plan: P, state: T) -> str:
        """Return in words what a program that is finished did not reach; empty for nothing."""
        return ""


AnyProgram = Program[Any, Any, Any]

# The base needs this time besides that of its whole way, because it may still be taking up its speed after a hold.
_SPARE_S = 1.0


def approach_limit_s(limits: SafetyParams, clear_m: float, speed_m_per_s: float) -> float:
    """Return the time [s] in which a base that approaches from clear_m [m] has certainly gone its whole way."""
    speed = min(speed_m_per_s, limits.base_speed_m_per_s)
    return (limits.base_max_m - clear_m) / speed + _SPARE_S
