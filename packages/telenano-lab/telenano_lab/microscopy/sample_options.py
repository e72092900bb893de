"""Command-line options that describe the sample under the tip."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Any

import typer

from telenano.afm import SHAPES
from telenano.settings import flag_overrides, permit_code, validate

if TYPE_CHECKING:
    from telenano.sections import SampleConfig

SampleOption = Annotated[
    str,
    typer.Option(
        "--sample",
        metavar="NAME|FILE|MODULE:FUNCTION",
        help=f"{', '.join(SHAPES)}, a height map (.gsf, .npy; others by the readers of packages), or a function of x"
        " and y [m].",
    ),
]
SampleSizeOption = Annotated[
    float | None,
    typer.Option(
        "--size", metavar="NM", help="Side of the sample [nm], for all but files that state it; default: 150."
    ),
]
ChannelOption = Annotated[
    str | None, typer.Option("--channel", metavar="NAME", help="Part of the name of a file's channel; default: height.")
]
SampleSetOption = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="Change a key of the sample, such as dot_count=20 (repeatable)."),
]


def sample_config(
    name: str, size_nm: float | None, channel: str | None, settings: Sequence[str] | None
) -> "SampleConfig":
    """Return the sample that the options describe; ConfigError names the invalid option or key."""
    from telenano.sections import SampleConfig

    if ":" in name:
        # The user named this function on the command line; it does not come from a file of somebody else.
        permit_code()
    settings_of_sample: dict[str, Any] = {"name": name, **flag_overrides(settings or ())}
    if size_nm is not None:
        settings_of_sample["size_m"] = size_nm * 1e-9
    if channel is not None:
        settings_of_sample["channel"] = channel
    return validate(SampleConfig, settings_of_sample, "--sample")
