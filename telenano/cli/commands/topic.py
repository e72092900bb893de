"""`telenano topic`: the messages of a running rig."""

import contextlib
import json
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import typer

from telenano.cli.options import (
    CountOption,
    DurationOption,
    JsonOption,
    ListenOption,
    SiteFileOption,
    TopicArgument,
    command_group,
)
from telenano.cli.output import print_answer, print_document, print_json, print_rows, report_errors, say
from telenano.launcher.scenario_keys import value_at
from telenano.recording.json_values import json_fields, json_value
from telenano.recording.quantities import quantity
from telenano.runtime.wiring.observer import (
    RIG_HINT,
    Observer,
    known_name,
    list_topics,
    measure,
    messages_of,
)
from telenano.settings.included import DEFAULT_SITE_FILE
from telenano.wire import TOPICS, Message
from telenano.wire.codec import decode_header
from telenano.wire.errors import RigError
from telenano.wire.received import Received

_LIST_S = 1.5
_SILENCE_S = 4.0

app = command_group()


@app.command("list")
def list_all(
    site_file: SiteFileOption = DEFAULT_SITE_FILE, duration: ListenOption = _LIST_S, as_json: JsonOption = False
) -> None:
    """List every topic: its publishers, its declared rate, and the number of messages received."""
    with report_errors(as_json), open_observer(site_file) as observer:
        rows = list_topics(observer, duration)
        if not any(row["heard"] for row in rows):
            raise RigError(f"nothing was received within {duration:g} s: {RIG_HINT}")
    print_answer({"duration_s": duration, "topics": rows}, rows, as_json=as_json)


@app.command()
def echo(
    topic: TopicArgument,
    site_file: SiteFileOption = DEFAULT_SITE_FILE,
    count: CountOption = None,
    duration: DurationOption = None,
    field: Annotated[
        list[str] | None,
        typer.Option("--field", metavar="NAME", help="Only this field, such as tip_force_n.2 (repeatable)."),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Print the messages of a topic, one a line as JSON; with --json as one object at the end."""
    collected: list[dict[str, Any]] = []
    received_any = False
    with report_errors(as_json), open_observer(site_file, topic) as observer:
        with contextlib.suppress(KeyboardInterrupt):
            for received in messages_of(observer, topic, duration, count):
                received_any = True
                fields = _chosen(_fields(received), field)
                if as_json:
                    collected.append(fields)
                else:
                    typer.echo(json.dumps(fields))
        if not received_any:
            raise RigError(f"{topic}: no message was received: {RIG_HINT}")
    if as_json:
        print_json({"topic": topic, "messages": collected})


def _fields(received: Received) -> dict[str, Any]:
    """Return the fields of a message; unchecked, if the package of its topic is not installed."""
    if type(received.message) is Message:
        return {key: json_value(value) for key, value in decode_header(received.topic, received.payload)[1].items()}
    return json_fields(received.message)


def _chosen(fields: dict[str, Any], names: list[str] | None) -> dict[str, Any]:
    """Return the named fields, `position_m.2` for a component; ConfigError lists the fields that exist."""
    if not names:
        return fields
    return {name: value_at(fields, name, "the message") for name in names}


@app.command()
def info(topic: TopicArgument, as_json: JsonOption = False) -> None:
    """Show the facts of a topic: message, publishers, readers, rate, and its fields with unit and description."""
    with report_errors(as_json):
        name, _ = known_name(topic)
        row = TOPICS[name]
        facts: dict[str, Any] = {
            "topic": name,
            "message": row.model.__name__,
            "version": row.model.version,
            "publishers": list(row.publishers),
            "declared rate [Hz]": row.rate_hz,
            "deadline [s]": row.deadline_s,
            "delivery": row.delivery,
            "crosses the link": row.bridged or "no",
        }
        fields = [
            {"field": field, "unit": quantity(name, field).unit, "about": quantity(name, field).description}
            for field in row.model.__struct_fields__
        ]
    if as_json:
        print_json({**facts, "fields": fields})
    else:
        print_document(facts, name, as_json=False)
        print_rows(fields)


@app.command()
def hz(
    topic: TopicArgument,
    site_file: SiteFileOption = DEFAULT_SITE_FILE,
    count: CountOption = None,
    duration: DurationOption = None,
    as_json: JsonOption = False,
) -> None:
    """Measure a topic by source: rate, gaps in the sequence, age of the messages on arrival here, bytes."""
    with report_errors(as_json), open_observer(site_file, topic) as observer:
        rows = measure(observer, topic, duration, count)
    print_answer({"topic": topic, "sources": rows}, rows, as_json=as_json)


@contextlib.contextmanager
def open_observer(site_file: Path, topic: str | None = None) -> Iterator[Observer]:
    """Connect to the rig of a site file, for one topic or all of them; ConfigError for an unknown topic."""
    wanted = (known_name(topic, unknown=True)[0],) if topic else None
    with contextlib.closing(Observer.of_rig(site_file, wanted)) as observer:
        # The sockets of a killed rig, or a machine that is switched off, are noticed only by their silence.
        timer = threading.Timer(_SILENCE_S, _say_silence, (observer, topic or "any topic"))
        timer.daemon = True
        timer.start()
        try:
            yield observer
        finally:
            timer.cancel()


def _say_silence(observer: Observer, topic: str) -> None:
    if observer.silent:
        say(f"nothing was received on {topic} within {_SILENCE_S:g} s: {RIG_HINT}")
