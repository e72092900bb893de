"""Options that the studies share.

What imports numba is not imported here, so that `telenano study --help` answers at once.
"""

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, get_args

import typer

from presets.plugins import installed
from proto.errors import ConfigError
from telenano.cli.completion import law_names

# those of `studies.loops.cells`, which imports numba
Environment = str
Hand = Literal["force", "soft", "ordinary", "stiff"]


if TYPE_CHECKING:

    class EnvironmentName(StrEnum):
        """The environment that the tip touches."""

        SPRING = "spring"
        WALL = "wall"
        CONTACT = "contact"
        BODY = "body"

else:
    _ENVIRONMENTS = ("spring", "wall", "contact", "body", *installed("samples"))
    EnvironmentName = StrEnum("EnvironmentName", {name.upper(): name for name in _ENVIRONMENTS})


class HandName(StrEnum):
    """What presses: a constant force, or an arm on its way along a path."""

    FORCE = "force"
    SOFT = "soft"
    ORDINARY = "ordinary"
    STIFF = "stiff"


class SampleName(StrEnum):
    """A sample in words, and its stiffness."""

    SOFT = "soft"
    ORDINARY = "ordinary"
    STIFF = "stiff"


LawOption = Annotated[
    str, typer.Option("--law", metavar="LAW[,LAW]|all", help="Laws to study.", autocompletion=law_names)
]
EnvironmentOption = Annotated[
    EnvironmentName,
    typer.Option(
        "--environment",
        help="spring: F = K (x_s - L); wall: the same, but only pushing; contact: the tip-sample force of Table 2;"
        " body: mass, damper and spring K, touched through the cantilever; or a sample of an installed package.",
    ),
]
HandOption = Annotated[
    HandName,
    typer.Option(
        "--hand", "--arm", help="force: a constant force whatever the device does; else an arm of 50, 300 or 1000 N/m."
    ),
]
MassOption = Annotated[
    float | None, typer.Option("--mass", metavar="KG", help="Mass of the body, at the tip; default 0.01 kg.")
]
BodyDampingOption = Annotated[
    float | None,
    typer.Option("--body-damping", metavar="N*S/M", help="Damper of the body, at the tip; default 0.02 N s/m."),
]
FrequencyOption = Annotated[
    str, typer.Option("--frequency", metavar="LIST", help="Sines of the hand [Hz], of a whole number of ms each.")
]
StiffnessOption = Annotated[
    str | None,
    typer.Option(
        "--stiffness",
        metavar="LIST|RANGE",
        help="K of the spring, or k of the cantilever [N/m]; default: 10,20,38 for spring, 40 for contact.",
    ),
]
JitterOption = Annotated[
    str,
    typer.Option("--jitter", metavar="LIST", help="Half-width of uniform jitter each way [ms], or n% of the delay."),
]
LossOption = Annotated[
    str, typer.Option("--loss", metavar="LIST", help="Share of messages lost each way, 0 to 1, or n%.")
]
DeviceLatencyOption = Annotated[
    float,
    typer.Option(
        "--device-latency",
        metavar="MS",
        min=0.0,
        max=1000.0,
        help="What real devices add to the round trip [ms]: the sum of device_latency_s in node/health.",
    ),
]
SeedOption = Annotated[int, typer.Option("--seed", min=0, help="Seed of the link's random streams.")]
LengthOption = Annotated[
    float | None,
    typer.Option("--duration", metavar="S", help="Length of each session [s]; default: grows with the delay."),
]
SetOption = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="LAW.KEY=VALUE", help="Change a parameter of a law (SI units); may be repeated."),
]
DisturbOption = Annotated[
    list[str] | None,
    typer.Option(
        "--disturb",
        metavar="NAME|NAME.KEY=VALUE",
        help="Switch on a disturbance of the instrument, or set a key of it, as in afm_node.disturbances (repeatable).",
    ),
]
WorkersOption = Annotated[
    int | None, typer.Option("--workers", min=1, metavar="N", help="Processes on this machine; default: one a core.")
]
SchedulerOption = Annotated[
    str | None,
    typer.Option("--scheduler", metavar="ADDRESS", help="Dask scheduler to run on, such as tcp://host:8786."),
]
OutOption = Annotated[
    Path,
    typer.Option("--out", metavar="DIR", help="Folder for page, figures, table and journal; resumes a journal."),
]


def hands(text_given: str) -> tuple[Hand, ...]:
    """Read names of hands, or `all`."""
    names: tuple[Hand, ...] = get_args(Hand)
    if text_given.strip() == "all":
        return names
    given = [name.strip() for name in text_given.split(",")]
    for name in given:
        if name not in names:
            raise ConfigError(f"--hand: unknown hand {name!r}, known are all, {', '.join(names)}")
    return tuple(name for name in names if name in given)
