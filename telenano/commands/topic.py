"""`telenano topic`: the messages of a running rig."""

import contextlib
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated, Any

import typer

from presets import DEFAULT_SITE_FILE
from recording.tables import json_fields
from services.runtime.main import load_site
from services.runtime.observer import (
    Observer,
    known_name,
    list_topics,
    measure_delay,
    measure_rate,
    messages_of,
)
from telenano.options import CountOption, DurationOption, JsonOption, ListenOption, SiteFileOption, command_group
from telenano.output import print_json, print_rows, report_errors

_LIST_S = 1.5

app = command_group()

TopicArgument = Annotated[
    str, typer.Argument(metavar="TOPIC", help="Topic; topic@site is the copy that left the link at that site.")
]


@app.command("list")
def list_all(
    site_file: SiteFileOption = DEFAULT_SITE_FILE, duration: ListenOption = _LIST_S, as_json: JsonOption = False
) -> None:
    """List every topic: its publishers, its declared rate, and the number of messages received."""
    with report_errors(as_json), open_observer(site_file) as observer:
        rows = list_topics(observer, duration)
    if as_json:
        print_json({"duration_s": duration, "topics": rows})
    else:
        print_rows(rows)


@app.command()
def echo(
    topic: TopicArgument,
    site_file: SiteFileOption = DEFAULT_SITE_FILE,
    count: CountOption = None,
    duration: DurationOption = None,
    as_json: JsonOption = False,
) -> None:
    """Print the messages of a topic, one a line as JSON; with --json as one object at the end."""
    collected: list[dict[str, Any]] = []
    with report_errors(as_json), open_observer(site_file, topic) as observer, contextlib.suppress(KeyboardInterrupt):
        for received in messages_of(observer, topic, duration, count):
            fields = json_fields(received.message)
            if as_json:
                collected.append(fields)
            else:
                typer.echo(json.dumps(fields))
    if as_json:
        print_json({"topic": topic, "messages": collected})


@app.command()
def hz(
    topic: TopicArgument,
    site_file: SiteFileOption = DEFAULT_SITE_FILE,
    count: CountOption = None,
    duration: DurationOption = None,
    as_json: JsonOption = False,
) -> None:
    """Measure the rate of a topic: mean, standard deviation of the interval, gaps in the sequence."""
    _measure(measure_rate, topic, site_file, duration, count, as_json=as_json)


@app.command()
def delay(
    topic: TopicArgument,
    site_file: SiteFileOption = DEFAULT_SITE_FILE,
    count: CountOption = None,
    duration: DurationOption = None,
    as_json: JsonOption = False,
) -> None:
    """Measure the age of the messages of a topic when they arrive here: median, 99th percentile, maximum [ms]."""
    _measure(measure_delay, topic, site_file, duration, count, as_json=as_json)


def _measure(
    measure: Callable[[Observer, str, float | None, int | None], list[dict[str, Any]]],
    topic: str,
    site_file: Path,
    duration_s: float | None,
    count: int | None,
    *,
    as_json: bool,
) -> None:
    with report_errors(as_json), open_observer(site_file, topic) as observer:
        rows = measure(observer, topic, duration_s, count)
    if as_json:
        print_json({"topic": topic, "sources": rows})
    else:
        print_rows(rows)


@contextlib.contextmanager
def open_observer(site_file: Path, topic: str | None = None) -> Iterator[Observer]:
    """Connect to the rig of a site file, for one topic or all of them; ConfigError for an unknown topic."""
    book = load_site(site_file)
    with contextlib.closing(Observer(book, (known_name(topic)[0],)) if topic else Observer(book)) as observer:
        yield observer
