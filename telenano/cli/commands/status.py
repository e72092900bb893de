"""`telenano status`: the state of a running rig, from the messages that each of its sockets sends in a short time."""

import contextlib
import os
import shlex
from collections.abc import Iterator, Mapping, Sequence
from datetime import datetime
from typing import Annotated, Any

import typer
from rich.console import Group
from rich.table import Column, Table
from rich.text import Text

from telenano.cli.option_rules import Void, rules
from telenano.cli.options import JsonOption, ListenOption, SiteFileOption
from telenano.cli.output import NO_ROOM, console, fail, print_answer, print_json, report_errors
from telenano.cli.tables import LEVEL_STYLES, counts_text, figures
from telenano.launcher.processors import fits_text, held, shared_folder
from telenano.launcher.rig_status import NEEDED, RigStatus, document_of, expected_nodes, listen
from telenano.launcher.rigs import RigFacts, about_rig, lists_all_folders, rigs_elsewhere, running_rigs
from telenano.runtime.bus.address_book import AddressBook
from telenano.runtime.bus.holders import look
from telenano.runtime.bus.local_endpoint import FIRST_RIG, RIG_VARIABLE, RUNTIME_DIRECTORY_VARIABLE, base_directory
from telenano.runtime.wiring.observer import Observer
from telenano.settings.included import DEFAULT_SITE_FILE
from telenano.signals.children import permitted
from telenano.timing.loop_age import Part, in_words

_DEFAULT_S = 1.5
# A node that makes less than this share of its steps runs on a machine that is too busy.
_LEAST_SHARE = 0.95
# Parts of the age of the loop that are shorter than this are not named [s].
_LEAST_PART_S = 5e-6
_AFM_NOTES = {"in_contact": "in contact", "meniscus": "meniscus", "limited": "at a limit"}


@rules(Void("*", "which lists every rig, and listens to none", beside="--all", but="--json"))
def status(
    site_file: SiteFileOption = DEFAULT_SITE_FILE,
    duration: ListenOption = _DEFAULT_S,
    show_all: Annotated[bool, typer.Option("--all", help="List the rigs of this user on this machine.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Show the state of a running rig; exit code 1 if a node does not report or waits for something."""
    if show_all:
        print_rigs(running_rigs(), [] if lists_all_folders() else rigs_elsewhere(), as_json=as_json)
        return
    with report_errors(as_json):
        book = AddressBook.load(site_file)
        with contextlib.closing(Observer(book, NEEDED)) as observer:
            rig_status = listen(observer, duration)
    about = about_rig(os.environ.get(RIG_VARIABLE) or FIRST_RIG) if book.uses_runtime_directory else {}
    print_status(rig_status, expected_nodes(book.nodes, observer.subscribers), about, as_json=as_json)


def print_rigs(rigs: Sequence[RigFacts], elsewhere: Sequence[RigFacts] = (), *, as_json: bool) -> None:
    """Print a row for each rig, the other folders with rigs of this user, and the processors that are free."""
    usable = permitted()
    taken = held(usable, shared_folder())
    free = sorted(usable - set(taken))
    rows, others = ([_row(rig) for rig in each] for each in (rigs, elsewhere))
    blind = look().blind
    if as_json:
        document = {"rigs": rows, "elsewhere": others, "unknown": blind}
        print_json({**document, "processors": {"free": free, "held": taken}})
        return
    if not rigs:
        typer.echo(f"no rig of this user was found in {base_directory()}, nor a process that holds its name")
    if blind:
        typer.echo(f"whether others run is not known here: {blind}")
    for rig in elsewhere:
        process = f"process {rig.about['process']}" if "process" in rig.about else "starting"
        given = f"{RUNTIME_DIRECTORY_VARIABLE}={shlex.quote(rig.folder)}"
        typer.echo(f"a rig of this user runs in {rig.folder} ({process}): {given} reaches it")
    table = Table("rig", "process", "scenario", "since", "processors", "results")
    for rig in rigs:
        about = rig.about
        begun = datetime.fromtimestamp(about["begun_s"]).strftime("%H:%M:%S") if "begun_s" in about else ""
        name = rig.name if rig.site == "master" else f"{rig.name}@{rig.site}"
        name = f"{rig.folder}: {name}" if rig.folder else name
        process = str(about.get("process", ""))
        table.add_row(name, process, about.get("scenario", ""), begun, processors_text(about), about.get("out", ""))
    if rigs:
        console().print(table)
    typer.echo(f"processors: {fits_text(len(free))}")


def _row(rig: RigFacts) -> dict[str, Any]:
    return {"rig": rig.name, "site": rig.site, **rig.about, **({"folder": rig.folder} if rig.folder else {})}


def processors_text(about: Mapping[str, Any]) -> str:
    """Return a text with the processors that are reserved for a rig."""
    if about.get("behind"):
        return "none of its own: other rigs have them"
    return ", ".join(map(str, about.get("processors", ()))) or "any"


def print_status(
    rig_status: RigStatus, expected: Sequence[str], about: Mapping[str, Any] | None = None, *, as_json: bool
) -> None:
    """Print the state of a rig and exit with 1 if a node has a problem."""
    document = {**document_of(rig_status, expected), "rig": dict(about) if about else None}
    if not as_json:
        console().print(status_tables(document))
    if document["problems"]:
        nodes = ", ".join(facts["node"] for facts in document["nodes"] if facts["problem"])
        fail(f"nodes with a problem: {nodes}", as_json=as_json, **document)
    print_answer(document, "every node reports and none waits for anything", as_json=as_json)


def status_tables(document: Mapping[str, Any]) -> Group:
    """Draw the state of a rig: the nodes, then a line for each of link, law, device, recorder and event."""
    # Headings may wrap in a narrow terminal, names may not.
    table = Table(Column("node", no_wrap=True))
    for heading, figure in figures().items():
        table.add_column(heading, justify="left" if figure.is_text else "right")
    for facts in document["nodes"]:
        cells = [figure.cell(facts) for figure in figures().values()] if facts["heard"] else [Text("no report", "red")]
        table.add_row(facts["node"], *cells)
    lines = Table.grid(padding=(0, 2))
    for facts in document["nodes"]:
        if facts["problem"]:
            lines.add_row(Text(facts["node"], "yellow"), Text(facts["problem"], "yellow"))
    for what, text in _lines(document):
        lines.add_row(what, text)
    return Group(table, lines)


def _lines(document: Mapping[str, Any]) -> Iterator[tuple[str, Text]]:
    if link := document["link"]:
        yield from ((f"link {way}", Text(_way_text(link[way]))) for way in ("forward", "backward"))
        if clock := link["clock"]:
            ahead_ms, uncertainty_ms = clock["offset_s"] * 1e3, clock["uncertainty_s"] * 1e3
            yield "clocks", Text(f"the slave's clock is {ahead_ms:.3f} ms ahead, ± {uncertainty_ms:.3f} ms")
    if age := [Part(**facts) for facts in document["age"]]:
        rest = ", ".join(f"{one.name} {1e3 * one.p50_s:.3g}" for one in age[:-1] if one.p50_s > _LEAST_PART_S)
        yield "age of the loop", Text(f"{in_words(age)} ({1e3 * age[-1].p99_s:.3g} ms at 99 %); in ms: {rest}")
    if about := document.get("rig"):
        yield "processors", Text(processors_text(about), "yellow" if about.get("behind") else "")
    if felt := (document.get("rig") or {}).get("felt"):
        yield "the hand feels", Text(str(felt))
    heard = [facts for facts in document["nodes"] if facts["heard"]]
    slow = [facts for facts in heard if 0.0 < facts["rate_hz"] * facts["period_s"] < _LEAST_SHARE]
    if slow:
        reached = (f"{facts['node']} {facts['rate_hz']:.0f} of {1.0 / facts['period_s']:.0f} Hz" for facts in slow)
        yield "machine", Text(f"{', '.join(reached)}: {NO_ROOM}", "yellow")
    for law in document["laws"]:
        yield f"law {law['src']}", _law_text(law)
    for hand in document["hand"]:
        session = (
            f"force profile at {hand['session_s']:.1f} s" if hand["session_s"] >= 0.0 else "force profile not running"
        )
        stopped = " · emergency stop is latched" if hand["estop"] else ""
        limited = " · at a limit" if hand["limited"] else ""
        yield f"hand {hand['src']}", Text(f"{hand['mode']} · {session}{limited}{stopped}", "red" if stopped else "")
    for afm in document["afm"]:
        notes = [text for key, text in _AFM_NOTES.items() if afm[key]]
        yield f"AFM {afm['src']}", Text(" · ".join([afm["mode"], *notes]), "red" if afm["mode"] == "estop" else "")
    for node in document["nodes"]:
        if node["node"].startswith("recorder@") and node["heard"]:
            text = f"{node['state']} · {node['received']} messages received · {node['lost']} lost"
            if node["state"] == "safe":
                text = f"nothing is written · {node['received']} messages received"
            yield node["node"], Text(text, "red" if node["state"] == "safe" else "")
    yield from (("connection", Text(text)) for text in document["connections"])
    for event in document["events"]:
        yield f"event {event['src']}", Text(event["text"], LEVEL_STYLES[event["level"]])


def _way_text(way: Mapping[str, Any]) -> str:
    delay = "no message" if way["delay_mean_s"] is None else f"delay {way['delay_mean_s'] * 1e3:.2f} ms"
    return f"{way['profile']} · {delay} · dropped {counts_text(way['dropped'])} · {way['queue_depth']} in flight"


def _law_text(law: Mapping[str, Any]) -> Text:
    notes = [law["law"], "passive" if law["passive"] else "not passive"]
    notes += ["waits for the other half to switch"] if law["switching"] else []
    notes += [f"net energy {law['net_energy_j']:.3g} J"] if law["net_valid"] else []
    ago = f"last signal received {law['silence_s'] * 1e3:.0f} ms ago"
    notes.append(ago if law["heard"] else "no signal received yet")
    return Text(" · ".join(notes), "" if law["passive"] and law["heard"] else "yellow")
