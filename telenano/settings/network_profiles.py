"""Named networks: partial settings of the link, each with its source and the statistics that a test checks.

A network is a file of `telenano/settings/networks` and is named after it. Its content is a `Profile`: `source` says
which figures were published where, `assumed` what the source leaves open, and `statistics` the delays and losses of
each direction, which `tests/unit/link/test_network_presets.py` measures. The environment variable TELENANO_NETWORKS
names a folder with further networks, such as those that `telenano link fit` writes. Forward is the operator's uplink:
the operator sits at the end of an access line, the instrument near the core of the network.
"""

import os
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from telenano.files.held_files import listed
from telenano.settings.config import Settings, read_yaml, validate
from telenano.settings.included import NETWORK_DIRECTORY
from telenano.wire.errors import ConfigError, known_names
from telenano.wire.printable import quoted

Milliseconds = Annotated[float, Field(ge=0.0)]


class Source(Settings):
    """A publication with the figures taken from it."""

    cite: str = Field(min_length=1, description="Paper, report, or file of a repository with its commit")
    taken: str = Field(min_length=1, description="The figures taken from it, with their place")


class Statistics(Settings):
    """Statistics of the messages of one direction, sent at 1 kHz; None where nothing is stated."""

    mean_ms: Milliseconds | None = Field(default=None, description="Mean delay [ms]")
    deviation_ms: Milliseconds | None = Field(default=None, description="Standard deviation of the delay [ms]")
    percentiles_ms: dict[float, Milliseconds] = Field(default={}, description="Percentile -> delay [ms]")
    lost: float = Field(default=0.0, ge=0.0, le=1.0, description="Share lost")
    lost_in_a_row: float | None = Field(default=None, ge=1.0, description="Mean number of messages lost in a row")
    overtakes: bool = Field(default=False, description="Whether messages overtake each other")


class Profile(Settings):
    """A named network."""

    about: str = Field(min_length=1, description="The network in one line")
    source: tuple[Source, ...] = Field(default=(), description="Published figures; empty: typical figures of our own")
    assumed: tuple[str, ...] = Field(default=(), description="Values that the source leaves open, and the choices made")
    statistics: dict[Literal["forward", "backward"], Statistics] = Field(description="Statistics of the messages")
    link: dict[str, Any] = Field(default={}, description="Settings of the link over their defaults")

    @property
    def settings(self) -> Mapping[str, Any]:
        return self.link

    @property
    def round_trip_ms(self) -> float:
        """The mean delay of both directions together [ms]."""
        return sum(way.mean_ms or 0.0 for way in self.statistics.values())


class _Profiles(Mapping[str, Profile]):
    """The profiles in the folders by name; each file is read when it is first asked for."""

    def __getitem__(self, name: str) -> Profile:
        if name not in self:
            raise KeyError(name)
        return _read(name)

    def __contains__(self, name: object) -> bool:
        return name in _names()

    def __iter__(self) -> Iterator[str]:
        return iter(_names())

    def __len__(self) -> int:
        return len(_names())


@cache
def _names() -> tuple[str, ...]:
    names = sorted(path.stem for folder in _folders() for path in listed(folder, ".yaml"))
    return tuple(dict.fromkeys(("clean", *names)))


def _folders() -> list[Path]:
    """Return the folder of the package, which takes precedence, and that of the environment."""
    return [Path(folder) for folder in (NETWORK_DIRECTORY, os.environ.get("TELENANO_NETWORKS")) if folder]


@cache
def _read(name: str) -> Profile:
    path = next(path for folder in _folders() for path in listed(folder, ".yaml") if path.stem == name)
    return validate(Profile, read_yaml(path), str(path))


PROFILES: Mapping[str, Profile] = _Profiles()


def profile_named(name: str) -> Profile:
    """Return a profile by its name in any case; ConfigError names the profiles that there are."""
    if name.lower() not in PROFILES:
        raise ConfigError(refusal_of(name))
    return PROFILES[name.lower()]


def refusal_of(name: str) -> str:
    """Return why a name is no profile; for a file, how to make a network of it or how to name its folder."""
    path = Path(name)
    if not path.exists():
        return f"unknown profile {name!r}; {known_names(name.lower(), PROFILES)}"
    if path.suffix == ".yaml":
        return f"{name} is a file: set TELENANO_NETWORKS={path.parent} and name it as {path.stem}"
    made = f"`telenano link fit {quoted(name)} --out out/line` makes one of a log or table of delays"
    return f"{name} is not a network: {made}; then set TELENANO_NETWORKS=out/line and name it as profile"
