"""Options of the commands that put a sample under the tip."""

import contextlib
import os
from collections.abc import Iterator, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from telenano.files.atomic_files import whole_results
from telenano.settings.config import ALLOW_CODE_VARIABLE, flag_overrides, validate
from telenano.wire.errors import ConfigError, TelenanoError
from telenano.wire.extras import how_to_install

if TYPE_CHECKING:
    from telenano.afm.made_samples import SampleConfig

SampleOption = Annotated[
    str,
    typer.Option(
        "--sample",
        metavar="NAME|FILE|MODULE:FUNCTION",
        help="flat, dots, grating, a height map (.gsf, .npy; others by the readers of packages), or a function of x and"
        " y [m].",
    ),
]
SampleSizeOption = Annotated[
    float | None,
    typer.Option("--size", metavar="NM", help="Side of the sample [nm], for all but files that say it; default: 150."),
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
    """Return the sample that the options describe; ConfigError names the option or key."""
    from telenano.afm.made_samples import SampleConfig

    if ":" in name:
        # a person has named this function here, and no file of somebody else
        os.environ[ALLOW_CODE_VARIABLE] = "1"
    settings_of_sample: dict[str, Any] = {"name": name, **flag_overrides(settings or ())}
    if size_nm is not None:
        settings_of_sample["size_m"] = size_nm * 1e-9
    if channel is not None:
        settings_of_sample["channel"] = channel
    return validate(SampleConfig, settings_of_sample, "--sample")


def require(*modules: str) -> None:
    """Raise ConfigError naming what is not installed, before anything takes its time."""
    missing = [name for name in modules if find_spec(name) is None]
    if missing:
        verb = "are" if len(missing) > 1 else "is"
        raise ConfigError(f"{', '.join(missing)} {verb} not installed: {how_to_install('instrument')}")


@contextlib.contextmanager
def results_in(out: Path) -> Iterator[Path]:
    """Yield a temporary folder whose files go into `out` when the block ends, and nowhere if it fails.

    Raises:
        TelenanoError: The folder cannot be made.
    """
    with contextlib.ExitStack() as results:
        try:
            folder = results.enter_context(whole_results(out))
        except OSError as error:
            raise TelenanoError(f"--out {out}: cannot be made: {error.strerror}") from error
        yield folder
