"""The range of every quantity on the wire: declared here once, with the hardest physical case that needs it.

A range bounds what a reader may act on, so that the arithmetic behind it stays finite. It lies far above anything that
can be measured and is no limit of an instrument: those stand in the guard of each device.
"""

import math
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from types import UnionType
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin

from annotated_types import Ge
from pydantic import BaseModel, GetCoreSchemaHandler, ValidationError, create_model
from pydantic_core import CoreSchema, InitErrorDetails, core_schema

M = TypeVar("M", bound=BaseModel)

# a number that is beyond its range may be infinite, and then its bound is told at the second attempt only
_ATTEMPTS = 8


@dataclass(frozen=True)
class Range:
    """Bounds of a quantity, both included, and the case that needs them."""

    quantity: str
    low: float
    high: float
    unit: str
    reason: str

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Return the schema of a number within the bounds."""
        return core_schema.float_schema(ge=self.low, le=self.high)


POSITION = Range(
    "position", -10.0, 10.0, "m", "ten times the travel of 1 m that a haptic device may be given; an AFM moves 0.1 mm"
)
WAY = Range(
    "position at the slave's scale",
    -1e6,
    1e6,
    "m",
    "the counter of waves, which grows with the impulse: 10 N on a line of 1 N s/m for a day are 8.6e5 m",
)
VELOCITY = Range("velocity", -1e3, 1e3, "m/s", "a hundred times the fastest reference that a device may be given")
FORCE = Range(
    "force",
    -1e6,
    1e6,
    "N",
    "a motor of 10 N m through a screw of 2.8e-5 m/rad: 3.6e5 N; the stiffest spring on a base: 1e9 N/m over 0.2 mm",
)
WAVE = Range("wave variable", -1e6, 1e6, "sqrt(W)", "1 kN on a line of 1 mN s/m are 2.2e4 sqrt(W)")
ENERGY = Range("energy", -1e12, 1e12, "J", "1 kW at a port for thirty years")
POWER = Range("power", -1e9, 1e9, "W", "the greatest force at the greatest velocity")
DURATION = Range("duration", 0.0, 1e10, "s", "2^63 ns are 9.2e9 s: the most between two time stamps")
TIME = Range("time", -1e10, 1e10, "s", "the same, before or after")
RATE = Range("rate", 0.0, 1e9, "Hz", "one step in each nanosecond of the clock")
PERCENTAGE = Range("percentage", 0.0, 1e6, "%", "ten thousand processors that work for one process")
ANGLE = Range("angle", -1e6, 1e6, "rad", "an unwrapped phase of 1.6e5 turns")
VOLTAGE = Range("voltage", -1e4, 1e4, "V", "ten times the highest voltage that drives a piezo")
QUATERNION = Range("component of a unit quaternion", -1.0, 1.0, "", "that of a rotation by no angle at all")
CHANNEL = Range(
    "measured channel", -1e9, 1e9, "its SI unit", "the greatest rate, as of a frequency shift; others are less"
)
SCALE = Range("value of a scale", -1e9, 1e9, "", "the answer to a question for a number, such as an amount of money")

RANGES = (
    POSITION,
    WAY,
    VELOCITY,
    FORCE,
    WAVE,
    ENERGY,
    POWER,
    DURATION,
    TIME,
    RATE,
    PERCENTAGE,
    ANGLE,
    VOLTAGE,
    QUATERNION,
    CHANNEL,
    SCALE,
)

PositionM = Annotated[float, POSITION]
WayM = Annotated[float, WAY]
VelocityMPerS = Annotated[float, VELOCITY]
ForceN = Annotated[float, FORCE]
WaveSqrtW = Annotated[float, WAVE]
EnergyJ = Annotated[float, ENERGY]
PowerW = Annotated[float, POWER]
DurationS = Annotated[float, DURATION]
TimeS = Annotated[float, TIME]
RateHz = Annotated[float, RATE]
Percent = Annotated[float, PERCENTAGE]
VoltageV = Annotated[float, VOLTAGE]
QuaternionPart = Annotated[float, QUATERNION]
ChannelValue = Annotated[float, CHANNEL]
ScaleValue = Annotated[float, SCALE]

PositionVector = tuple[PositionM, PositionM, PositionM]
WayVector = tuple[WayM, WayM, WayM]
VelocityVector = tuple[VelocityMPerS, VelocityMPerS, VelocityMPerS]
ForceVector = tuple[ForceN, ForceN, ForceN]
WaveVector = tuple[WaveSqrtW, WaveSqrtW, WaveSqrtW]


@dataclass(frozen=True)
class Elements:
    """The range of every element of an array of data."""

    range: Range

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Return the schema of the array, followed by the check of its elements."""
        return core_schema.no_info_after_validator_function(self._checked, handler(source))

    def _checked(self, array: Any) -> Any:
        elements = array.to_numpy()
        for value in (float(elements.min()), float(elements.max())) if elements.size else ():
            if not self.range.low <= value <= self.range.high:
                bound = {"le": self.range.high} if value > 0.0 else {"ge": self.range.low}
                kind = "less_than_equal" if value > 0.0 else "greater_than_equal"
                fault = InitErrorDetails(type=kind, loc=("data",), input=value, ctx=bound)
                raise ValidationError.from_exception_data(type(array).__name__, [fault])
        return array


def is_out_of_range(fault: Mapping[str, Any]) -> bool:
    """Return whether a fault of pydantic's is that a quantity is beyond its range.

    Bounds of quantities are floating point, those of counts are integers: a negative count is another fault.
    """
    if fault["type"] not in ("less_than_equal", "greater_than_equal"):
        return False
    bound = fault["ctx"].get("le", fault["ctx"].get("ge"))
    return isinstance(bound, float)


def any_range(model: type[M], fields: Mapping[str, Any], unknown: Literal["ignore", "forbid"] = "forbid") -> M:
    """Return a message of any finite quantities: for recordings and examples, not for who acts on them.

    Raises:
        pydantic.ValidationError: The fields violate anything but a range, or have others where those are forbidden.
    """
    return _construct(model, _unlimited(model).model_validate(fields, extra=unknown))


def limited(model: type[M], fields: Mapping[str, Any], report: Callable[[str], None] = lambda text: None) -> M:
    """Return a message in which what is beyond its range, or does not fit into a count, is at the nearer end.

    What a node says stays in range whatever it computed: to end instead would take the guard of a device with it.

    Args:
        model: The class of the message.
        fields: The fields of the message by key.
        report: Called with a sentence when a value was limited.

    Raises:
        pydantic.ValidationError: The fields have any other fault, NaN included.
    """
    try:
        return model(**fields)
    except ValidationError as error:
        faults, values, first = error, dict(fields), ""
    for _ in range(_ATTEMPTS):
        for fault in faults.errors(include_url=False):
            bound = _nearest(fault)
            name, *places = fault["loc"]
            if bound is None or isinstance(values[str(name)], BaseModel):
                raise faults
            first = first or f"{'.'.join(map(str, fault['loc']))} = {fault['input']!r}"
            values[str(name)] = _replaced(values[str(name)], places, bound)
        try:
            message = model(**values)
        except ValidationError as error:
            faults = error
        else:
            report(f"{model.__name__}: {first} is out of range and is sent at the end of the range")
            return message
    raise faults


def _nearest(fault: Mapping[str, Any]) -> float | int | None:
    """Return the value to send in the place of one that is refused, None where there is none."""
    context, value = fault.get("ctx", {}), fault["input"]
    if fault["type"] == "finite_number" and isinstance(value, float) and math.isinf(value):
        return math.copysign(sys.float_info.max, value)
    for kind, key, step in (("less_than_equal", "le", 0), ("greater_than_equal", "ge", 0), ("less_than", "lt", 1)):
        if fault["type"] == kind:
            bound: float | int = context[key] - step
            return bound
    return None


def _replaced(value: Any, places: list[int | str], replacement: float) -> Any:
    if not places:
        return replacement
    place, *below = places
    if isinstance(value, Mapping):
        return {**value, place: _replaced(value[place], below, replacement)}
    return tuple(_replaced(part, below, replacement) if at == place else part for at, part in enumerate(value))


@cache
def _unlimited(model: type[BaseModel]) -> type[BaseModel]:
    """Return a model with the same fields, names and rules, but for the ranges."""
    fields: dict[str, Any] = {}
    for name, field in model.model_fields.items():
        default = ... if field.is_required() else field.default
        fields[name] = (_without_range(field.annotation, field.metadata), default)
    return create_model(model.__name__, __base__=model, **fields)


def _without_range(annotation: Any, metadata: Any = ()) -> Any:
    rules: list[Any] = []
    for rule in metadata:
        if isinstance(rule, Range):
            # A quantity that cannot be negative was never allowed to be negative.
            rules += [Ge(0.0)] if rule.low == 0.0 else []
        elif not isinstance(rule, Elements):
            rules.append(rule)
    origin, parts = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return _without_range(parts[0], (*annotation.__metadata__, *metadata))
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        annotation = _unlimited(annotation)
    elif origin in (Union, UnionType):
        annotation = Union[tuple(_without_range(part) for part in parts)]  # noqa: UP007
    elif origin is tuple:
        annotation = tuple[tuple(part if part is Ellipsis else _without_range(part) for part in parts)]  # type: ignore[misc]
    return Annotated[(annotation, *rules)] if rules else annotation


def _construct(model: type[M], found: BaseModel) -> M:
    return model.model_construct(**{name: _converted(value) for name, value in found.__dict__.items()})


def _converted(value: Any) -> Any:
    if isinstance(value, BaseModel):
        return _construct(type(value).__mro__[1], value)
    return tuple(map(_converted, value)) if isinstance(value, tuple) else value
