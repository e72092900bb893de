"""Options and arguments that several commands share, and a function that makes a group of commands."""

from pathlib import Path
from typing import Annotated

import typer

from telenano.cli.completion import node_names, scenario_keys, topic_names
from telenano.cli.lazy_commands import OpenGroup
from telenano.recording.recorded_time import RecordedTime, recorded_time
from telenano.settings.included import SITE_DIRECTORY, site_file_named
from telenano.wire.errors import ConfigError
from telenano.wire.nodes import Site

# ros2 and docker have the same names for help.
HELP_NAMES = {"help_option_names": ["-h", "--help"]}


def _site_file(path: Path | None) -> Path | None:
    """Return the named site file; ConfigError, before the command begins, if it does not exist."""
    file = site_file_named(path)
    if file is not None and not file.exists():
        known = ", ".join(sorted(each.stem for each in SITE_DIRECTORY.glob("*.yaml")))
        raise ConfigError(f"--site-file {path}: no such file; give a .yaml file, or one of {known}")
    return file


SeedsOption = Annotated[
    int | None,
    typer.Option(
        "--seeds",
        min=2,
        max=100,
        metavar="N",
        help="Run a session for each of the seeds 0 to N - 1, and give mean, deviation and interval.",
    ),
]
JobsOption = Annotated[
    int | None, typer.Option("--jobs", min=1, metavar="N", help="How many run at a time; default: one a processor.")
]
AllowCodeOption = Annotated[
    bool,
    typer.Option("--allow-code", help="Run code that the scenario names: the function of a sample, a library."),
]
SiteFileOption = Annotated[
    Path,
    typer.Option(
        "--site-file",
        metavar="FILE",
        callback=_site_file,
        help="Address book of the rig (YAML); default: all on this machine.",
    ),
]
RigFileOption = Annotated[
    Path | None,
    typer.Option(
        "--site-file",
        metavar="FILE",
        callback=_site_file,
        help="Address book of the rig (YAML); default: all on this machine, with --site two of them.",
    ),
]
TopicArgument = Annotated[
    str,
    typer.Argument(
        metavar="TOPIC",
        help="Topic; topic@site is the copy that left the link at that site.",
        autocompletion=topic_names,
    ),
]
TargetOption = Annotated[
    str,
    typer.Option(
        "--target",
        metavar="NODES",
        help="Nodes addressed: node@site, node, or a pattern such as '*'.",
        autocompletion=node_names,
    ),
]
SiteOption = Annotated[
    Site | None,
    typer.Option("--site", help="Site, of two, at which you are; from the slave the command reaches the nodes there."),
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print exactly one JSON object on stdout, nothing else.")]
QuietOption = Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing until the result, and serve no page.")]
SameSessionOption = Annotated[
    bool,
    typer.Option(
        "--same-session",
        help="Join files even if no record says that they are of one session, such as those of earlier versions.",
    ),
]
CountOption = Annotated[
    int | None, typer.Option("--count", min=1, metavar="N", help="End after this number of messages; default: no end.")
]
DurationOption = Annotated[
    float | None, typer.Option("--duration", min=0.0, metavar="S", help="End after this time [s]; default: no end.")
]
TopicsOption = Annotated[
    list[str] | None,
    typer.Option("--topics", metavar="PATTERN", help="Only these channels: glob or /regular expression/ (repeatable)."),
]
ExcludeOption = Annotated[
    list[str] | None, typer.Option("--exclude", metavar="PATTERN", help="Not these channels (repeatable).")
]
SettingsOption = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="SECTION.KEY=VALUE",
        help="Change one key first (SI units); may be repeated.",
        autocompletion=scenario_keys,
    ),
]
StartOption = Annotated[
    RecordedTime | None,
    typer.Option(
        "--start", metavar="TIME", parser=recorded_time, help="From this time on: seconds, or in any form printed."
    ),
]
EndOption = Annotated[
    RecordedTime | None,
    typer.Option("--end", metavar="TIME", parser=recorded_time, help="Up to this time."),
]
_TABLE_FORMATS = ("csv", "parquet", "mat")


def _known_formats(text: str) -> str:
    """Return the text with the formats of figures; ConfigError, before the command begins, for an unknown one."""
    if text != "png":
        from telenano.analysis.figure_style import FigureOptions

        FigureOptions.of(text)
    return text


def _known_style(text: str) -> str:
    if text != "screen":
        from telenano.analysis.figure_style import FigureOptions

        FigureOptions.of(style=text)
    return text


def table_formats(text: str) -> tuple[str, ...]:
    """Read `csv,parquet,mat`; ConfigError lists the known formats."""
    chosen = tuple(dict.fromkeys(part.strip().lower() for part in text.split(",") if part.strip()))
    if not chosen or set(chosen) - set(_TABLE_FORMATS):
        raise ConfigError(f"--table {text}: name one or more of {', '.join(_TABLE_FORMATS)}")
    return chosen


def _known_tables(text: str) -> str:
    table_formats(text)
    return text


FormatOption = Annotated[
    str,
    typer.Option(
        "--format", metavar="png,pdf,svg", help="Formats of the figures, one or several.", callback=_known_formats
    ),
]
StyleOption = Annotated[
    str,
    typer.Option(
        "--style",
        metavar="screen|paper",
        help="paper: one column of a journal, letters of 8 pt, no title.",
        callback=_known_style,
    ),
]
TableOption = Annotated[
    str,
    typer.Option(
        "--table", metavar="csv,parquet,mat", help="Formats of the tables, one or several.", callback=_known_tables
    ),
]
ListenOption = Annotated[float, typer.Option("--duration", min=0.0, metavar="S", help="Time for which to listen [s].")]


def command_group() -> typer.Typer:
    """Return an empty group of commands; its help text is in the table of `lazy_commands`."""
    return typer.Typer(
        cls=OpenGroup,
        no_args_is_help=True,
        context_settings=HELP_NAMES,
        add_completion=False,
        pretty_exceptions_enable=False,
        # markup would swallow the units in brackets
        rich_markup_mode=None,
    )
