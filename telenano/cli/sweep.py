"""`--sweep` of `up` and `simulate`: run sessions one after the other with other values, each in its own folder."""

import itertools
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import typer
from pydantic import BaseModel

from telenano.cli.child_session import run_session
from telenano.cli.lazy_commands import ALIASES
from telenano.cli.model_options import validated
from telenano.cli.option_rules import Keys, Void
from telenano.settings.scenario import SEEDS
from telenano.wire.errors import ConfigError, RigError, probably_meant

R = TypeVar("R", bound=BaseModel)

# The key of a sweep for the delay of the link, which has no single key in a scenario.
_DELAY = "round_trip_ms"
# The delay has an option of its own.
_DELAY_OPTION = "--round-trip-ms"
# The key of a sweep for the seed of the session, which is the seed of everything random in it.
SEED = "seed"
_SEED_OPTION = "--seed"
_MOST_SESSIONS = 100
# What the options of a session state, alone or in a sweep, and which of them are for a sweep alone.
SESSION_RULES = (
    Keys("--duration", "duration_s"),
    Keys("--instrument", "instrument"),
    Keys("--round-trip-ms", f"{_DELAY}, delay_node.forward.delay_s, delay_node.backward.delay_s"),
    Keys("--seeds", ", ".join((SEED, *SEEDS))),
    Keys("--sweep"),
    Void("--table", "whose sessions it compares", unless="--sweep, --seeds"),
    Void("--overwrite", "the folder that it is about; without --out a session has a new one", unless="--out"),
)
# Options of the sweep itself, each with a value, which are not passed on to the sessions.
_OWN = ("--sweep", "--seeds", "--table", "--out")


class Point(NamedTuple):
    """One session of a sweep: its name, which its folder has as well, and its options."""

    name: str
    options: tuple[str, ...]

    def asked_of(self, request: R, folder: Path) -> R:
        """Return the request with these options added and a folder of its own in `folder`."""
        pairs = list(zip(self.options[::2], self.options[1::2], strict=True))
        delays = [_number(option, value) for option, value in pairs if option == _DELAY_OPTION]
        fields: dict[str, Any] = {_DELAY: delays[-1]} if delays else {}
        seeds = [_whole(option, value) for option, value in pairs if option == _SEED_OPTION]
        fields |= {SEED: seeds[-1]} if seeds else {}
        asked = dict(request)
        settings = (*asked["settings"], *(value for option, value in pairs if option == "--set"))
        return validated(type(request), {**asked, **fields, "settings": settings, "out": folder / self.name})


def points_of(sweeps: Sequence[str], seed_option: str = "") -> list[Point]:
    """Return a point for each combination of the values of `KEY=V1,V2,…`; ConfigError says which text is wrong.

    Args:
        sweeps: The texts, each a key with its values.
        seed_option: The option by which the command seeds a session; if empty, the keys of all seeds are set.
    """
    axes = [[(key, value) for value in values] for key, values in map(_axis, sweeps)]
    points = [Point(", ".join(f"{key.rpartition('.')[2]}={value}" for key, value in chosen).replace("/", "-"),
                    tuple(word for key, value in chosen for word in _option(key, value, seed_option)))
              for chosen in itertools.product(*axes)]  # fmt: skip
    if len(points) > _MOST_SESSIONS:
        raise ConfigError(f"--sweep: {len(points)} sessions are more than {_MOST_SESSIONS}")
    if len({point.name for point in points}) < len(points):
        raise ConfigError("--sweep: two sessions would have the same values, or keys with the same last part")
    return points


def without_sweep(words: Sequence[str], command: str = "up") -> list[str]:
    """Return the arguments of a command line that belong to each session of its sweep."""
    kept, skip = [], False
    # The sessions of --no-report have no figure; that which compares them has.
    own = (*_OWN, "--format", "--style") if "--no-report" in words else _OWN
    names = {command, *(alias for alias, meant in ALIASES.items() if meant == command)}
    begin = next(place for place, word in enumerate(words) if word in names)
    for word in words[begin + 1 :]:
        name, sign, _ = word.partition("=")
        if not skip and word != "--json" and name not in own:
            kept.append(word)
        skip = not skip and name in own and not sign
    return kept


def _axis(text: str) -> tuple[str, list[str]]:
    key, sign, values = text.partition("=")
    texts = [value.strip() for value in values.split(",")]
    if not sign or not key or not all(texts):
        raise ConfigError(f"--sweep {text}: is not of the form KEY=V1,V2, such as controller.law=wave,smith")
    if key not in (own := (_DELAY, SEED)) and (near := probably_meant(key, own)):
        raise ConfigError(f"--sweep {text}: no key of a scenario{near}")
    return key.strip(), texts


def _option(key: str, value: str, seed_option: str) -> tuple[str, ...]:
    if key == SEED and seed_option:
        return seed_option, value
    if key == SEED:
        return tuple(word for seed in SEEDS for word in ("--set", f"{seed}={value}"))
    return (_DELAY_OPTION, value) if key == _DELAY else ("--set", f"{key}={value}")


def _number(option: str, value: str) -> float:
    try:
        return float(value)
    except ValueError:
        raise ConfigError(f"{option} = {value}: is not a number of milliseconds") from None


def _whole(option: str, value: str) -> int:
    try:
        return int(value)
    except ValueError:
        raise ConfigError(f"{option} = {value}: is not a whole number") from None


def run_sweep(
    points: Sequence[Point],
    arguments: Sequence[str],
    out: Path,
    *,
    quiet: bool = False,
    name: str = "up",
) -> list[Path]:
    """Run the sessions one after the other, each by its own command (`telenano up`); return their folders.

    Raises:
        RigError: A session failed; the message names the session and quotes its report.
    """
    folders = []
    for number, point in enumerate(points, start=1):
        if not quiet:
            typer.echo(f"{number}/{len(points)}: {point.name}", err=True)
        folder = out / point.name
        command = [sys.executable, "-m", "telenano", name, *arguments, *point.options, "--out", str(folder), "--json"]
        # An incomplete recording is no failure: its summary says so, and the table shows a hold without data.
        try:
            run_session(command)
        except RigError as error:
            raise RigError(f"the session {point.name} failed: {error}") from error
        folders.append(folder)
    return folders
