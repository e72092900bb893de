"""`telenano status`: how a running rig is doing, heard for a moment at every socket of it."""

import contextlib
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import typer
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from presets import DEFAULT_SITE_FILE, site_file_named
from proto import TOPICS
from proto.errors import RigError
from proto.messages import (
    AfmState,
    HapticState,
    LawStatus,
    LinkDirection,
    LinkStatus,
    Message,
    NodeHealth,
    SessionEvent,
)
from proto.nodes import START_ORDER, is_visitor, site_of
from services.launcher.readiness import oldest_input_s, unmet
from services.runtime.main import load_site
from services.runtime.observer import Observer
from telenano.output import console, fail, print_json, report_errors

M = TypeVar("M", bound=Message)

_DEFAULT_S = 1.5
# what the law sends at 1 kHz says nothing here, and reading it would cost the rig processor time
NEEDED = ("node/health", "link/status", "law/status", "haptic/state", "afm/state", "session/event")
_LINK = "delay_node@master"
_STATE_STYLES = {"ready": "green", "running": "green", "safe": "yellow", "starting": "yellow"}
_LEVEL_STYLES = {"info": "", "warning": "yellow", "error": "red"}
_COLUMNS: dict[str, Literal["left", "right"]] = {
    "node": "left",
    "state": "left",
    "up": "right",
    "rate Hz": "right",
    "late p99 ms": "right",
    "overruns": "right",
    "input age ms": "right",
    "lost": "right",
    "refused": "left",
    "CPU %": "right",
    "MB": "right",
    "granted": "left",
}


class Picture:
    """What was heard of a rig: of each source the newest message of a kind, of each node the first health too."""

    def __init__(self) -> None:
        self.first: dict[str, NodeHealth] = {}
        self.events: dict[tuple[str, int], SessionEvent] = {}
        self.notices: list[str] = []
        self._newest: dict[tuple[str, type[Message]], Message] = {}

    def enter(self, message: Message) -> None:
        """Enter a message, which may be the copy out of the link of one that is known."""
        key = (message.src, type(message))
        known = self._newest.get(key)
        if known is None or message.t_ns > known.t_ns:
            self._newest[key] = message
        if isinstance(message, NodeHealth):
            self.first.setdefault(message.src, message)
        elif isinstance(message, SessionEvent):
            self.events[message.src, message.seq] = message

    def newest(self, kind: type[M]) -> dict[str, M]:
        """Give by source the newest message of a kind."""
        return {src: message for (src, _), message in self._newest.items() if isinstance(message, kind)}


def status(
    site_file: Annotated[
        Path,
        typer.Option("--site-file", metavar="FILE", callback=site_file_named, help="Address book of the rig (YAML)."),
    ] = DEFAULT_SITE_FILE,
    duration: Annotated[
        float, typer.Option("--duration", min=0.0, metavar="S", help="How long to listen [s].")
    ] = _DEFAULT_S,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout, nothing else.")] = False,
) -> None:
    """Say how a running rig is doing; exit code 1 if a node is not heard or waits for something."""
    with report_errors(as_json):
        book = load_site(site_file)
        with contextlib.closing(Observer(book, NEEDED)) as observer:
            picture = listen(observer, duration)
    tell_status(picture, expected_nodes(book.nodes, observer.subscribers), as_json=as_json)


def expected_nodes(nodes: Iterable[str], reachable: Collection[str]) -> list[str]:
    """Give those of the nodes of a site file that report their health while a rig runs, and can be heard here.

    Parameters: reachable, nodes whose sockets this machine can hear; the link brings the health of the slave's site.
    """
    reporting = [node for node in nodes if node in START_ORDER]
    return [node for node in reporting if node in reachable or (_LINK in reachable and site_of(node) == "slave")]


def listen(observer: Observer, duration_s: float) -> Picture:
    """Listen to a rig for a time [s]; RigError where no node is heard."""
    picture = Picture()
    for heard in observer.listen(duration_s):
        picture.enter(heard.received.message)
    picture.notices = [notice.text for notice in observer.notices]
    if not picture.first:
        raise RigError("no rig is heard, is `telenano up` running with this site file?")
    return picture


def problems_of(picture: Picture, expected: Sequence[str]) -> dict[str, str]:
    """Give for each node with which something is wrong what that is, in words."""
    health = picture.newest(NodeHealth)
    judged = [*expected, *sorted(node for node in health if node not in expected and not is_visitor(node))]
    problems = unmet(judged, health)
    for node in judged:
        if node in problems:
            continue
        if health[node].state == "stopping":
            problems[node] = "is stopping"
        elif stalled := stalled_inputs(picture.first[node], health[node]):
            problems[node] = f"hears no more of {', '.join(stalled)}"
    return problems


def stalled_inputs(first: NodeHealth, newest: NodeHealth) -> list[str]:
    """Give the topics of which a node heard nothing between two reports, for longer than the topic allows.

    Counts are compared and not ages, which would need the clocks of both sites to agree.
    """
    if first.pid != newest.pid:
        return []
    span_s = (newest.t_ns - first.t_ns) * 1e-9
    before, now = _received(first), _received(newest)
    return sorted(topic for topic, count in now.items() if 0 < count == before.get(topic) and _stale(topic, span_s))


def _stale(topic: str, silence_s: float) -> bool:
    row = TOPICS.get(topic)
    return row is not None and row.deadline_s is not None and silence_s > row.deadline_s


def _received(health: NodeHealth) -> dict[str, int]:
    counts: dict[str, int] = {}
    for row in health.inputs:
        counts[row.topic] = counts.get(row.topic, 0) + row.received
    return counts


def _is_unexpected(node: str) -> bool:
    # shown where they are heard; the launcher is then judged, the others are not
    return is_visitor(node) or node.partition("@")[0] == "launcher"


def document_of(picture: Picture, expected: Sequence[str]) -> dict[str, Any]:
    """Give what is known of a rig as JSON can hold it, SI units in the names."""
    problems = problems_of(picture, expected)
    health = picture.newest(NodeHealth)
    shown = [*expected, *sorted(health.keys() - set(expected))]
    links = list(picture.newest(LinkStatus).values())
    return {
        "ok": not problems,
        "problems": [f"{node} {what}" for node, what in problems.items()],
        "nodes": [_node_facts(node, health.get(node), problems.get(node)) for node in shown],
        "link": _link_facts(links[0]) if links else None,
        "laws": [_facts(law, _LAW_FACTS) for _, law in sorted(picture.newest(LawStatus).items())],
        "hand": [_facts(hand, _HAND_FACTS) for hand in picture.newest(HapticState).values()],
        "afm": [_facts(afm, _AFM_FACTS) for afm in picture.newest(AfmState).values()],
        "connections": picture.notices,
        "events": [_facts(event, _EVENT_FACTS) for event in picture.events.values()],
    }


_HEALTH_FACTS = ("state", "uptime_s", "rate_hz", "overruns", "cpu_percent", "memory_bytes", "realtime", "memory_locked")
_LAW_FACTS = ("src", "law", "switching", "passive", "heard", "silence_s", "net_valid", "net_energy_j")
_HAND_FACTS = ("src", "mode", "estop", "limited", "session_s")
_AFM_FACTS = ("src", "mode", "limited", "in_contact", "meniscus")
_EVENT_FACTS = ("src", "kind", "level", "text")


def _facts(message: Message, names: Iterable[str]) -> dict[str, Any]:
    return {name: getattr(message, name) for name in names}


def _node_facts(node: str, health: NodeHealth | None, problem: str | None) -> dict[str, Any]:
    facts: dict[str, Any] = {"node": node, "heard": health is not None, "problem": problem}
    if health is None:
        return facts
    return {
        **facts,
        **_facts(health, (*_HEALTH_FACTS, "replay")),
        "lateness_p99_s": health.lateness_p99_s if health.period_s else None,
        "oldest_input_s": oldest_input_s(health),
        "received": sum(row.received for row in health.inputs),
        "lost": sum(row.lost for row in health.inputs),
        "refused": health.rejected,
    }


def _link_facts(link: LinkStatus) -> dict[str, Any]:
    clock = link.clock
    offset = {"offset_s": clock.offset_s, "uncertainty_s": clock.uncertainty_s} if clock.valid else None
    return {"forward": _way_facts(link.forward), "backward": _way_facts(link.backward), "clock": offset}


def _way_facts(way: LinkDirection) -> dict[str, Any]:
    delay_s = way.delay_mean_s if way.delay_valid else None
    return {"profile": way.profile, "delay_mean_s": delay_s, "dropped": way.dropped, "queue_depth": way.queue_depth}


def tell_status(picture: Picture, expected: Sequence[str], *, as_json: bool) -> None:
    """Print how a rig is doing and leave with 1 if something is wrong."""
    document = document_of(picture, expected)
    if not as_json:
        console().print(status_picture(document))
    if document["problems"]:
        nodes = ", ".join(facts["node"] for facts in document["nodes"] if facts["problem"])
        fail(f"not all is well with {nodes}", as_json=as_json, **document)
    if as_json:
        print_json(document)
    else:
        typer.echo("every node is heard and none waits")


def status_picture(document: Mapping[str, Any]) -> Group:
    """Draw how a rig is doing: the nodes, then a line for each of link, law, device, recorder and event."""
    table = Table()
    for name, justify in _COLUMNS.items():
        # headings may wrap in a narrow terminal, names may not
        table.add_column(name, justify=justify, no_wrap=name == "node")
    for facts in document["nodes"]:
        table.add_row(facts["node"], *(_cells(facts) if facts["heard"] else [Text("not heard", "red")]))
    lines = Table.grid(padding=(0, 2))
    for facts in document["nodes"]:
        if facts["problem"]:
            lines.add_row(Text(facts["node"], "yellow"), Text(facts["problem"], "yellow"))
    for what, text in _lines(document):
        lines.add_row(what, text)
    parts: list[RenderableType] = [table, lines]
    return Group(*parts)


def _cells(facts: Mapping[str, Any]) -> list[Text]:
    state = "replay" if facts["replay"] else facts["state"]
    late_s, age_s = facts["lateness_p99_s"], facts["oldest_input_s"]
    minutes, seconds = divmod(round(facts["uptime_s"]), 60)
    granted = [name for name, key in (("fifo", "realtime"), ("memory", "memory_locked")) if facts[key]]
    return [
        Text(state, _STATE_STYLES.get(state, "red")),
        Text(f"{minutes // 60}:{minutes % 60:02}:{seconds:02}"),
        Text(f"{facts['rate_hz']:.1f}"),
        Text("-" if late_s is None else f"{late_s * 1e3:.3f}"),
        _alarming(facts["overruns"]),
        Text("-" if age_s is None else f"{age_s * 1e3:.1f}"),
        _alarming(facts["lost"]),
        Text(_counts(facts["refused"]), "red" if facts["refused"] else ""),
        Text(f"{facts['cpu_percent']:.0f}"),
        Text(f"{facts['memory_bytes'] / 1e6:.0f}"),
        Text(", ".join(granted) or "nothing"),
    ]


def _alarming(count: int) -> Text:
    return Text(str(count), "red" if count else "")


def _counts(counts: Mapping[str, int]) -> str:
    return ", ".join(f"{reason} {count}" for reason, count in counts.items()) or "0"


def _lines(document: Mapping[str, Any]) -> Iterator[tuple[str, Text]]:
    if link := document["link"]:
        yield from ((f"link {way}", Text(_way_text(link[way]))) for way in ("forward", "backward"))
        if clock := link["clock"]:
            text = f"the slave's is {clock['offset_s'] * 1e3:.3f} ms ahead, ± {clock['uncertainty_s'] * 1e3:.3f} ms"
            yield "clocks", Text(text)
    for law in document["laws"]:
        yield f"law {law['src']}", _law_text(law)
    for hand in document["hand"]:
        session = f"programme at {hand['session_s']:.1f} s" if hand["session_s"] >= 0.0 else "programme not running"
        stopped = " · emergency stop is latched" if hand["estop"] else ""
        limited = " · at a limit" if hand["limited"] else ""
        yield f"hand {hand['src']}", Text(f"{hand['mode']} · {session}{limited}{stopped}", "red" if stopped else "")
    for afm in document["afm"]:
        notes = [text for key, text in _AFM_NOTES.items() if afm[key]]
        yield f"AFM {afm['src']}", Text(" · ".join([afm["mode"], *notes]), "red" if afm["mode"] == "estop" else "")
    for node in document["nodes"]:
        if node["node"].startswith("recorder@") and node["heard"]:
            yield node["node"], Text(f"{node['state']} · {node['received']} messages heard · {node['lost']} lost")
    yield from (("connection", Text(text)) for text in document["connections"])
    for event in document["events"]:
        yield f"event {event['src']}", Text(event["text"], _LEVEL_STYLES[event["level"]])


_AFM_NOTES = {"in_contact": "in contact", "meniscus": "meniscus", "limited": "at a limit"}


def _way_text(way: Mapping[str, Any]) -> str:
    delay = "no message" if way["delay_mean_s"] is None else f"delay {way['delay_mean_s'] * 1e3:.2f} ms"
    return f"{way['profile']} · {delay} · dropped {_counts(way['dropped'])} · {way['queue_depth']} in flight"


def _law_text(law: Mapping[str, Any]) -> Text:
    notes = [law["law"], "passive" if law["passive"] else "not passive"]
    notes += ["waits for the other half to switch"] if law["switching"] else []
    notes += [f"net energy {law['net_energy_j']:.3g} J"] if law["net_valid"] else []
    heard = f"other half heard {law['silence_s'] * 1e3:.0f} ms ago" if law["heard"] else "other half never heard"
    return Text(" · ".join([*notes, heard]), "" if law["passive"] and law["heard"] else "yellow")
