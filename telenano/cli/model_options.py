"""Options of a command from a settings model: name, type, unit, bounds and default, each said once, in the model.

A field `dwell_s` is the option `--dwell MS`: the end of its name is its unit, and the option takes the unit that a
person would use. What was given reaches the command as one mapping of fields to SI values; what was not is the model's.
"""

import inspect
from collections.abc import Callable, Collection, Mapping
from enum import StrEnum
from functools import wraps
from typing import Annotated, Any, Literal, NamedTuple, TypeVar, get_args, get_origin

import typer
from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo

from proto.errors import ConfigError
from services.afm_node.programs.program_settings import stated
from services.runtime.settings.config import bounds_of

F = TypeVar("F", bound=Callable[..., Any])

# the parameter of a command that the options take the place of
GIVEN = "given"


class Unit(NamedTuple):
    """Unit of an option as it is written, the SI unit of its field, and what the first is in the second."""

    name: str
    si: str
    scale: float


# by the end of a field's name, the longest first
_UNITS = {
    "_m_per_s": Unit("nm/s", "m/s", 1e-9),
    "_n_per_m": Unit("N/m", "N/m", 1.0),
    "_per_s": Unit("1/s", "1/s", 1.0),
    "_hz": Unit("Hz", "Hz", 1.0),
    "_m": Unit("nm", "m", 1e-9),
    "_n": Unit("nN", "N", 1e-9),
    "_s": Unit("ms", "s", 1e-3),
}
_NO_UNIT = Unit("", "", 1.0)
_PLAIN = (bool, int, float, str)


class ModelOption(NamedTuple):
    """An option: the field that it sets, its name on the command line, its type and its unit."""

    field: str
    flag: str
    kind: Any
    unit: Unit
    about: FieldInfo


def with_options(model: type[BaseModel], leave_out: Collection[str] = ()) -> Callable[[F], F]:
    """Return a decorator that gives a command an option for each field of a model, where its parameter `given` stands.

    Args:
        model: The settings; its fields are numbers, flags, texts and choices.
        leave_out: Fields for which the command has options of its own.
    """
    options = [option for option in options_of(model) if option.field not in leave_out]

    def decorate(command: F) -> F:
        own = list(inspect.signature(command, eval_str=True).parameters.values())
        made = [_parameter(option) for option in options]
        place = [parameter.name for parameter in own].index(GIVEN)

        @wraps(command)
        def called(**arguments: Any) -> Any:
            given = {option.field: arguments.pop(option.field) for option in options}
            in_si = {option.field: _si(option, given[option.field]) for option in options}
            return command(**arguments, given={name: value for name, value in in_si.items() if value is not None})

        parameters = [p.replace(kind=p.KEYWORD_ONLY) for p in (*own[:place], *made, *own[place + 1 :])]
        called.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
        called.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
        return called  # type: ignore[return-value]

    return decorate


def options_of(model: type[BaseModel]) -> list[ModelOption]:
    """Return an option for each field of a model."""
    return [_option(name, field) for name, field in model.model_fields.items()]


def check_options(model: type[BaseModel], given: Mapping[str, Any], flags: Mapping[str, str] | None = None) -> None:
    """Raise ConfigError naming the options whose values a model refuses, and what would be right.

    Args:
        model: The settings.
        given: SI values by field.
        flags: The options of fields for which the command has options of its own.
    """
    try:
        model.model_validate(dict(given))
    except ValidationError as error:
        known = {option.field: option for option in options_of(model)}
        lines = []
        for fault in error.errors(include_url=False, include_context=False):
            option = known.get(str(fault["loc"][0])) if fault["loc"] else None
            lines.append(fault["msg"] if option is None else _fault(option, fault["input"], flags or {}))
        raise ConfigError("\n".join(lines)) from error


def _option(name: str, field: FieldInfo) -> ModelOption:
    end = next((end for end in _UNITS if name.endswith(end)), "")
    kind = _kind_of(name, field.annotation)
    # whole numbers and texts have no unit, whatever they are called
    unit = _UNITS[end] if end and kind is float else _NO_UNIT
    bare = name.removesuffix(end) if unit is not _NO_UNIT else name
    return ModelOption(name, "--" + bare.replace("_", "-"), kind, unit, field)


def _kind_of(name: str, annotation: Any) -> Any:
    """Return the type that a command line has for a field: int, float, bool, str, or a choice of words."""
    if get_origin(annotation) is Literal:
        return StrEnum(name, {word.upper(): word for word in get_args(annotation)})
    if annotation in _PLAIN:
        return annotation
    for part in get_args(annotation):
        if part is not type(None) and (found := _kind_of(name, part)) is not None:
            return found
    return None


def _parameter(option: ModelOption) -> inspect.Parameter:
    flag = f"{option.flag}/--no-{option.flag[2:]}" if option.kind is bool else option.flag
    metavar = {int: "N", float: option.unit.name.upper() or "X"}.get(option.kind)
    made = typer.Option(flag, help=_help(option), metavar=metavar)
    annotation = Annotated[option.kind | None, made]  # type: ignore[name-defined]
    return inspect.Parameter(option.field, inspect.Parameter.KEYWORD_ONLY, default=None, annotation=annotation)


def _si(option: ModelOption, value: Any) -> Any:
    if isinstance(value, StrEnum):
        return value.value
    return value * option.unit.scale if isinstance(value, float) else value


def _help(option: ModelOption) -> str:
    """Return what a field is, its bounds and its defaults, in the unit of the option."""
    about, simulated = stated(option.about)
    words = [about.replace(f"[{option.unit.si}]", f"[{option.unit.name}]").rstrip(".")]
    if bounds := _bounds(option):
        words.append(bounds)
    bus = option.about.default
    if bus is not None and simulated == bus:
        words.append(f"default: {_written(option, bus)}")
    elif bus is not None:
        each = simulated.items() if isinstance(simulated, Mapping) else [("", simulated)]
        shown = ", ".join(_written(option, value) + (f" in {mode}" if mode else "") for mode, value in each)
        words.append(f"default: {shown}; with --live {_written(option, bus)}")
    return "; ".join(words) + "."


def _written(option: ModelOption, value: Any) -> str:
    return f"{value / option.unit.scale:g}" if isinstance(value, int | float) else str(value)


def _bounds(option: ModelOption) -> str:
    limits = {key: f"{value / option.unit.scale:.6g}" for key, value in bounds_of(option.about).items()}
    low = limits.get("ge") or (f"above {limits['gt']}" if "gt" in limits else "")
    high = limits.get("le") or (f"below {limits['lt']}" if "lt" in limits else "")
    return f"{low} to {high}" if low and high else ""


def _fault(option: ModelOption, value: Any, flags: Mapping[str, str]) -> str:
    flag = flags.get(option.field, option.flag)
    shown = f"{value / option.unit.scale:g}" if isinstance(value, int | float) else str(value)
    unit = f" [{option.unit.name}]" if option.unit.name else ""
    needed = _bounds(option)
    return f"{flag} = {shown} must be {needed}{unit}" if needed else f"{flag} = {shown} is not possible"
