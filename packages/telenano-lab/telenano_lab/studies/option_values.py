"""Read lists and ranges from the command line; errors name the option, the given text and the allowed values."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from telenano.sections import LAWS, OWN_LAWS, ControllerConfig
from telenano.settings import LoadedScenario, flag_overrides, flatten, nested, validate
from telenano.wire import ConfigError, known_names

_MOST_VALUES = 10_000
# The hint for a file name instead of numbers.
_OF_A_LINE = (
    "; of a log of a line `telenano link fit` makes a network, and `study advise` and `study validate` run over it"
    " (--network)"
)
# The laws of every comparison: those of telenano, and two of telenano-laws, which this package requires.
COMPARED_LAWS = (*OWN_LAWS, "model_mediated", "smith")
LONGEST_MS = 10_000.0
STIFFEST_N_PER_M = 1e5


@dataclass(frozen=True)
class Jitter:
    """The half-width of the jitter each way: a value in ms, or (`relative`) a share of the one-way delay."""

    value: float = 0.0
    relative: bool = False

    def at_ms(self, round_trip_ms: float) -> float:
        return 0.5 * round_trip_ms * self.value if self.relative else self.value

    def __str__(self) -> str:
        return f"{100.0 * self.value:g}%" if self.relative else f"{self.value:g} ms"


def delays(text: str) -> tuple[float, ...]:
    """Read round trips [ms] from a list or range."""
    return numbers("--delay", text, 0.0, LONGEST_MS, "ms")


def stiffnesses(text: str) -> tuple[float, ...]:
    """Read stiffnesses [N/m] from a list or range."""
    return numbers("--stiffness", text, 1e-3, STIFFEST_N_PER_M, "N/m")


def gains(text: str) -> tuple[float, ...]:
    """Read force gains from a list or range."""
    return numbers("--gain", text, 0.0, 1e6, "")


def chosen(option: str, what: str, text: str, known: Sequence[str]) -> tuple[str, ...]:
    """Read names separated by commas, or `all`; ConfigError names the option and the known names."""
    if text.strip() == "all":
        return tuple(known)
    names = tuple(dict.fromkeys(name.strip() for name in text.split(",")))
    for name in names:
        if name not in known:
            raise ConfigError(f"{option}: unknown {what} {name!r}, {known_names(name, ('all', *known))}")
    return names


def numbers(option: str, text: str, least: float, most: float, unit: str) -> tuple[float, ...]:
    """Read `a,b,c` and `start:stop:step` (stop included), also mixed, into increasing distinct numbers.

    Raises:
        ConfigError: A part is not a number or range, or lies outside [least, most].
    """
    values: list[float] = []
    for part in text.split(","):
        values += _range(option, part, unit) if ":" in part else [number(option, part, unit)]
    for value in values:
        if not least <= value <= most:
            raise ConfigError(f"{option} {text}: {value:g} {unit} is outside {least:g} to {most:g} {unit}".rstrip())
    return tuple(sorted(set(values)))


def number(option: str, text: str, unit: str) -> float:
    """Read one finite number."""
    try:
        value = float(text)
    except ValueError as error:
        raise ConfigError(
            f"{option}: {text!r} is not a number{f' [{unit}]' if unit else ''}: give a value, a list a,b,c or a range"
            f" start:stop:step{_OF_A_LINE if Path(text).exists() else ''}"
        ) from error
    if not math.isfinite(value):
        raise ConfigError(f"{option}: {text} is not finite")
    return value


def _range(option: str, text: str, unit: str) -> list[float]:
    parts = text.split(":")
    if len(parts) != 3:
        raise ConfigError(f"{option} {text}: a range is start:stop:step, such as 0:200:5")
    start, stop, step = (number(option, part, unit) for part in parts)
    if not step > 0.0 or stop < start:
        raise ConfigError(f"{option} {text}: a range needs a step > 0 and a stop that is not below its start")
    count = math.floor((stop - start) / step * (1.0 + 1e-12)) + 1
    if count > _MOST_VALUES:
        raise ConfigError(f"{option} {text}: {count} values are more than {_MOST_VALUES}")
    # The sum is rounded, so that rounding errors as in 0.1 + 0.2 make no delays of their own.
    return [round(start + i * step, 9) for i in range(count)]


def frequencies(text: str) -> tuple[float, ...]:
    """Read frequencies [Hz] from a list or range."""
    return numbers("--frequency", text, 0.05, 50.0, "Hz")


def named_instruments(text: str) -> tuple[str, ...]:
    """Read names of instruments separated by commas; ConfigError for an unknown name."""
    names = tuple(dict.fromkeys(name.strip() for name in text.split(",")))
    for name in names:
        section_of_instrument(name)
    return names


def laws(text: str) -> tuple[str, ...]:
    """Read names of laws; `all` stands for `COMPARED_LAWS`, so that a result does not depend on further packages."""
    return COMPARED_LAWS if text.strip() == "all" else chosen("--law", "law", text, tuple(LAWS))


def jitters(text: str) -> tuple[Jitter, ...]:
    """Read half-widths in ms, or with a % sign in shares of the one-way delay."""
    jitters_read = []
    for part in text.split(","):
        relative = part.strip().endswith("%")
        value = number("--jitter", part.strip().removesuffix("%"), "ms or %")
        if not 0.0 <= value <= (100.0 if relative else 1e5):
            raise ConfigError(f"--jitter {part}: must be 0 ms or more, or 0 to 100 %")
        jitters_read.append(Jitter(0.01 * value if relative else value, relative))
    return tuple(dict.fromkeys(jitters_read))


def losses(text: str) -> tuple[float, ...]:
    """Read shares 0..1, or with a % sign."""
    shares = []
    for part in text.split(","):
        relative = part.strip().endswith("%")
        value = number("--loss", part.strip().removesuffix("%"), "share") * (0.01 if relative else 1.0)
        if not 0.0 <= value <= 1.0:
            raise ConfigError(f"--loss {part}: a share of the messages lies between 0 and 1 (or 0 % and 100 %)")
        shares.append(value)
    return tuple(sorted(set(shares)))


def settings(texts: Sequence[str]) -> tuple[tuple[str, float | int | str | bool], ...]:
    """Read KEY=VALUE of section `controller` into sorted dotted keys; ConfigError if it refuses a key or value."""
    flat = _single_values("--set", texts)
    validate(ControllerConfig, nested(flat, "--set"), "--set")
    return tuple(sorted(flat.items()))


def disturbances(texts: Sequence[str]) -> tuple[tuple[str, float | int | str | bool], ...]:
    """Read names and NAME.KEY=VALUE of section `afm_node.disturbances`; each named disturbance is switched on.

    >>> disturbances(["thermal.temperature_k=77", "drift"])
    (('drift.enabled', True), ('thermal.enabled', True), ('thermal.temperature_k', 77))
    """
    flat = _single_values("--disturb", [text for text in texts if "=" in text])
    names = [text for text in texts if "=" not in text] + [key.partition(".")[0] for key in flat if "." in key]
    return tuple(sorted({**{f"{name}.enabled": True for name in names}, **flat}.items()))


def disturbances_of(instrument: str) -> tuple[tuple[str, float | int | str | bool], ...]:
    """Return the keys of `afm_node.disturbances` of a named instrument, as `disturbances`; ConfigError if unknown.

    >>> disturbances_of("ideal")
    ()
    """
    return tuple(flatten(section_of_instrument(instrument).get("disturbances", {})).items())


def section_of_instrument(instrument: str) -> dict[str, Any]:
    """Return the section `afm_node` of a named instrument; ConfigError if unknown: `section_of_instrument("real")`."""
    named = {"name": "study", "description": "A study.", "duration_s": 1.0, "instrument": instrument}
    return LoadedScenario.of(named, "--instrument").scenario.afm_node


def _single_values(option: str, texts: Sequence[str]) -> dict[str, float | int | str | bool]:
    """Return KEY=VALUE by dotted key; ConfigError, naming the option, for a value that is a list or nothing."""
    flat: dict[str, float | int | str | bool] = {}
    for key, value in flatten(flag_overrides(texts)).items():
        if not isinstance(value, float | int | str | bool):
            raise ConfigError(f"{option} {key}: {value!r} is not a single value")
        flat[key] = value
    return flat
