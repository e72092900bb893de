"""Make options of a command from a settings model, in which name, type, unit, bounds and default are stated once.

A field `dwell_s` becomes the option `--dwell MS`: the end of the field's name is its unit, and the option takes the
unit that a person would use. A field whose annotation has an `Option` states the form of its option itself. The command
receives the given values as one mapping from fields to values; for all others the defaults of the model hold.
"""

import inspect
import re
from collections.abc import Callable, Collection, Mapping
from functools import partial, wraps
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, Literal, NamedTuple, TypeVar, get_args, get_origin

import typer
from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from telenano.cli.completion import law_names, node_names, scenario_keys, scenario_names
from telenano.settings.config import bounds_of
from telenano.settings.option import Option
from telenano.wire.errors import ConfigError

F = TypeVar("F", bound=Callable[..., Any])
M = TypeVar("M", bound=BaseModel)

# The options replace this parameter of a command, which receives their values by field.
GIVEN = "given"
Given = dict[str, Any]


class Unit(NamedTuple):
    """The unit in which an option is written, the SI unit of its field, and the size of the first in the second."""

    name: str
    si: str
    scale: float


# Units by the end of a field's name; longer ends come before shorter ones that they contain.
_UNITS = {
    "_m_per_s": Unit("nm/s", "m/s", 1e-9),
    "_n_per_m": Unit("N/m", "N/m", 1.0),
    "_per_s": Unit("1/s", "1/s", 1.0),
    "_hz": Unit("Hz", "Hz", 1.0),
    "_m": Unit("nm", "m", 1e-9),
    "_n": Unit("nN", "N", 1e-9),
    "_s": Unit("ms", "s", 1e-3),
    "_bytes": Unit("bytes", "bytes", 1.0),
}
# Sessions and recordings use seconds, because they last longer than a pixel.
SECONDS = {"_s": Unit("s", "s", 1.0)}
_NO_UNIT = Unit("", "", 1.0)
_PLAIN = (bool, int, float, str, Path)
_COMPLETIONS = {"--law": law_names, "--without": node_names, "--scenario": scenario_names}
# Completions by metavar, because options of one name may take different texts.
_TEXTS = {"SECTION.KEY=VALUE": scenario_keys}


class ModelOption(NamedTuple):
    """An option: the field that it sets, its names on the command line, its type and its unit."""

    field: str
    flags: tuple[str, ...]
    kind: Any
    unit: Unit
    about: FieldInfo
    own: Option | None = None
    default: str | None = None

    @property
    def flag(self) -> str:
        """The name of the option in messages."""
        return self.flags[0]


def with_options(
    model: type[BaseModel],
    leave_out: Collection[str] = (),
    defaults: Mapping[str, str] = MappingProxyType({}),
    units: Mapping[str, Unit] = MappingProxyType({}),
) -> Callable[[F], F]:
    """Return a decorator that replaces the parameter `given` of a command by an option for each field of a model.

    Args:
        model: The settings; its fields are numbers, flags, texts and choices.
        leave_out: Fields for which the command has options of its own, or none.
        defaults: Defaults of this command instead of those of the model, as a person would write them.
        units: Units of this command instead of the usual ones, by the end of a field's name.
    """
    options = [
        option._replace(default=defaults.get(option.field))
        for option in options_of(model, units)
        if option.field not in leave_out
    ]

    def decorate(command: F) -> F:
        own = list(inspect.signature(command, eval_str=True).parameters.values())
        made = [_parameter(option) for option in options]
        place = [parameter.name for parameter in own].index(GIVEN)

        @wraps(command)
        def called(**arguments: Any) -> Any:
            values = {option.field: arguments.pop(option.field) for option in options}
            stated = {
                option.field: value * option.unit.scale if isinstance(value, float) else value
                for option in options
                if (value := values[option.field]) is not None
            }
            return command(**arguments, given={**defaults, **stated})

        parameters = [p.replace(kind=p.KEYWORD_ONLY) for p in (*own[:place], *made, *own[place + 1 :])]
        called.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
        called.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
        return called  # type: ignore[return-value]

    return decorate


def options_of(model: type[BaseModel], units: Mapping[str, Unit] = MappingProxyType({})) -> list[ModelOption]:
    """Return an option for each field of a model."""
    return [_option(name, field, {**_UNITS, **units}) for name, field in model.model_fields.items()]


def validated(model: type[M], given: Mapping[str, Any], flags: Mapping[str, str] | None = None) -> M:
    """Return the settings with the given values; the other fields have their defaults.

    Args:
        model: The class of the settings.
        given: Values by field, as `with_options` passes them on.
        flags: For fields that have an option of the command's own, the name of that option.

    Raises:
        ConfigError: The model refuses a value; the message names the option and the allowed values.
    """
    option_of = {option.field: option for option in options_of(model)}
    read = {name: option.own.read for name, option in option_of.items() if option.own and option.own.read}
    values = {name: read[name](value) if name in read else value for name, value in given.items()}
    try:
        return model.model_validate(values)
    except ValidationError as error:
        lines = []
        for fault in error.errors(include_url=False, include_context=False):
            option = option_of.get(str(fault["loc"][0])) if fault["loc"] else None
            lines.append(fault["msg"] if option is None else _fault(option, fault["input"], flags or {}))
        raise ConfigError(*lines) from error


def _option(name: str, field: FieldInfo, units: Mapping[str, Unit]) -> ModelOption:
    own = next((rule for rule in field.metadata if isinstance(rule, Option)), None)
    kind = _kind_of(field.annotation)
    if own is not None:
        if own.read is not None and kind is not Path:
            kind = list[str] if own.many else str
        return ModelOption(name, own.flags, kind, _NO_UNIT, field, own)
    end = next((end for end in units if name.endswith(end)), "")
    # Texts have no unit, nor have whole numbers except bytes, whatever their names end in.
    unit = units[end] if end and (kind is float or end == "_bytes") else _NO_UNIT
    bare = name.removesuffix(end) if unit is not _NO_UNIT else name
    return ModelOption(name, ("--" + bare.replace("_", "-"),), kind, unit, field)


def _kind_of(annotation: Any) -> Any:
    """Return the type of a field on the command line: int, float, bool, str, a choice, list[str]; None for others."""
    if get_origin(annotation) is Literal or annotation in _PLAIN:
        return annotation
    if get_origin(annotation) is tuple:
        return list[str]
    for part in get_args(annotation):
        if part is not type(None) and (kind := _kind_of(part)) is not None:
            return kind
    return None


def _words(annotation: Any) -> tuple[str, ...]:
    """Return the words that the parts of a list are chosen from; empty where any text is allowed."""
    if get_origin(annotation) is Literal:
        return get_args(annotation)
    return next(filter(None, map(_words, get_args(annotation))), ())


def _parameter(option: ModelOption) -> inspect.Parameter:
    unit = option.unit.name.upper()
    plain = {
        int: unit or "N",
        float: unit or "X",
        list[str]: "|".join(_words(option.about.annotation)) or "TEXT",
    }
    flags, metavar = option.flags, plain.get(option.kind)
    if option.own is not None:
        metavar = option.own.metavar or metavar
    elif option.kind is bool:
        flags = (f"{option.flag}/--no-{option.flag[2:]}",)
    complete = _TEXTS.get(metavar or "", _COMPLETIONS.get(option.flag))
    unit_name = option.unit.name or ("ms" if option.field.endswith("_ms") else "")
    reader = partial(_number, unit_name) if option.kind is float else None
    made = typer.Option(
        *flags, help=_help(option), metavar=metavar, autocompletion=complete, show_default=False, parser=reader
    )
    required = option.about.is_required() and option.default is None
    kind = option.kind if required else option.kind | None
    annotation: Any = Annotated[kind, made]
    default = inspect.Parameter.empty if required else None
    return inspect.Parameter(option.field, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation)


# The units in which a number may be written, one table for each quantity, with their size in its SI unit.
_WRITTEN: tuple[Mapping[str, float], ...] = (
    {"s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "min": 60.0, "h": 3600.0},
    {"m": 1.0, "mm": 1e-3, "um": 1e-6, "µm": 1e-6, "nm": 1e-9, "pm": 1e-12},
    {"N": 1.0, "mN": 1e-3, "uN": 1e-6, "µN": 1e-6, "nN": 1e-9, "pN": 1e-12},
    {"Hz": 1.0, "kHz": 1e3, "MHz": 1e6},
)


def _number(unit: str, text: str) -> float:
    """Read a number in the unit of an option, or with another unit of the same kind, such as 0.04s for 40 [ms]."""
    number, written = re.fullmatch(r"(.*?)\s*([A-Za-zµ/]*)", text.strip(), re.DOTALL).groups()  # type: ignore[union-attr]
    try:
        return float(text)
    except ValueError:
        scales = next((scales for scales in _WRITTEN if unit in scales), {unit: 1.0} if unit else {})
        try:
            return float(number) * scales[written] / scales[unit]
        except (KeyError, ValueError):
            # typer adds the name of the option to the message.
            raise ValueError(f"{text!r} is not a valid float" + (f" [{unit}]" if unit else "")) from None


def _help(option: ModelOption) -> str:
    """Return the help of an option: the description of its field, bounds and default, in the unit of the option."""
    about, default = option.about.description or "", option.about.default
    words = [about.replace(f"[{option.unit.si}]", f"[{option.unit.name}]").rstrip(".")]
    # Many descriptions state the bounds themselves.
    if (bounds := _bounds(option)) and bounds not in about:
        words.append(bounds)
    if option.default is not None:
        words = [words[0].partition("; default:")[0], *words[1:], f"default: {option.default}"]
    elif option.own is not None:
        # An option that reads its text states its default as text.
        shown = option.own.written or ("" if option.own.read or not _is_shown(default) else _written(option, default))
        words += [f"default: {shown}"] if shown else []
    elif _is_shown(default):
        words.append(f"default: {_written(option, default)}")
    return "; ".join(words) + "."


def _is_shown(default: Any) -> bool:
    return default not in (None, ()) and default is not False and default is not PydanticUndefined


def _written(option: ModelOption, value: Any) -> str:
    return f"{value / option.unit.scale:g}" if isinstance(value, int | float) else str(value)


def _bounds(option: ModelOption) -> str:
    limits = {key: f"{value / option.unit.scale:.6g}" for key, value in bounds_of(option.about).items()}
    low = limits.get("ge") or (f"above {limits['gt']}" if "gt" in limits else "")
    high = limits.get("le") or (f"below {limits['lt']}" if "lt" in limits else "")
    if low and not high:
        return low if low.startswith("above") else f"{low} or more"
    return f"{low} to {high}" if low and high else ""


def _fault(option: ModelOption, value: Any, flags: Mapping[str, str]) -> str:
    flag = flags.get(option.field, option.flag)
    shown = f"{value / option.unit.scale:g}" if isinstance(value, int | float) else str(value)
    unit = f" [{option.unit.name}]" if option.unit.name else ""
    needed = _bounds(option)
    return f"{flag} = {shown} must be {needed}{unit}" if needed else f"{flag} = {shown} is not possible"
