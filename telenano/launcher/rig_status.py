"""State of a running rig for `telenano status`: summaries and problems of its nodes, from received messages."""

from collections.abc import Collection, Iterable, Sequence
from typing import Any, TypeVar

import msgspec

from telenano.launcher.readiness import oldest_input_s, unmet
from telenano.runtime.wiring.observer import Observer
from telenano.settings.package_topics import row_of
from telenano.timing.loop_age import STAGES, LoopAge
from telenano.wire.errors import RigError
from telenano.wire.messages import (
    AfmState,
    HapticState,
    LawStatus,
    LinkDirection,
    LinkStatus,
    Message,
    NodeHealth,
    SessionEvent,
)
from telenano.wire.nodes import RECORDER, START_ORDER, is_visitor, name_of, site_of
from telenano.wire.sequence import total

M = TypeVar("M", bound=Message)

# The topics of the loop (STAGES) serve to split the age of the loop into its parts.
NEEDED = ("node/health", "link/status", "law/status", "haptic/state", "session/event", "link/delay", *STAGES)
_LINK = "delay_node@master"
# Fields of node/health that are no facts of `node_facts`: the header, and what it gives as sums or by another name.
_NO_FACTS = (*Message.__struct_fields__, "inputs", "rejected")
# Share of the files that a process may open from which on it is warned of.
_NEARLY_ALL = 0.8
_LAW_FACTS = ("src", "law", "switching", "passive", "heard", "silence_s", "net_valid", "net_energy_j")
_HAND_FACTS = ("src", "mode", "estop", "limited", "session_s")
_AFM_FACTS = ("src", "mode", "limited", "in_contact", "meniscus")
_EVENT_FACTS = ("src", "kind", "level", "text")


class RigStatus:
    """Messages received from a rig: the newest of each source and kind, all events, and each node's first health."""

    def __init__(self) -> None:
        self.first: dict[str, NodeHealth] = {}
        self.events: dict[tuple[str, int], SessionEvent] = {}
        self.notices: list[str] = []
        self.age = LoopAge()
        self._newest: dict[tuple[str, type[Message]], Message] = {}

    def record(self, message: Message) -> None:
        """Record a message; an older one, such as a copy that the link brings, does not replace a newer one."""
        key = (message.src, type(message))
        newest = self._newest.get(key)
        if newest is None or message.t_ns > newest.t_ns:
            self._newest[key] = message
        if isinstance(message, NodeHealth):
            self.first.setdefault(message.src, message)
        elif isinstance(message, SessionEvent):
            self.events[message.src, message.seq] = message

    def newest(self, kind: type[M]) -> dict[str, M]:
        """Return the newest messages of a kind, by source."""
        return {src: message for (src, _), message in self._newest.items() if isinstance(message, kind)}


def expected_nodes(nodes: Iterable[str], reachable: Collection[str]) -> list[str]:
    """Return the nodes of a site file that report their health while a rig runs, and whose reports reach this machine.

    Args:
        nodes: The nodes of the site file.
        reachable: The nodes that this machine can connect to; the link brings the health of the slave's site.
    """
    reporting = [node for node in nodes if node in START_ORDER]
    return [node for node in reporting if node in reachable or (_LINK in reachable and site_of(node) == "slave")]


def listen(observer: Observer, duration_s: float) -> RigStatus:
    """Listen to a rig for `duration_s` [s]; RigError if no node reports, with the known facts on its processes."""
    status = RigStatus()
    for observed in observer.listen(duration_s):
        message = observed.received.message
        status.record(message)
        status.age.take(observed.received.topic, message.src, message.t_ns, msgspec.structs.asdict(message))
    status.notices = [notice.text for notice in observer.notices]
    if not status.first:
        raise RigError(f"no node reports: {observer.why_silent()}")
    return status


def problems_of(status: RigStatus, expected: Sequence[str]) -> dict[str, str]:
    """Return the problem of each node that has one, in words."""
    health = status.newest(NodeHealth)
    judged = [*expected, *sorted(node for node in health if node not in expected and not is_visitor(node))]
    problems = unmet(judged, health)
    for node in judged:
        if node in problems:
            continue
        if fault := recording_fault(status, health[node]):
            problems[node] = fault
        elif deaf_s := health[node].deaf_s:
            problems[node] = ", ".join(
                f"has received nothing from {peer} for {lasts_s:.1f} s" for peer, lasts_s in deaf_s.items()
            )
        elif fault := open_files_fault(health[node]):
            problems[node] = fault
        elif health[node].state == "stopping":
            problems[node] = "is stopping"
        elif stalled := stalled_inputs(status.first[node], health[node]):
            problems[node] = f"no longer receives {', '.join(stalled)}"
    return problems


def recording_fault(status: RigStatus, health: NodeHealth) -> str:
    """Return the reason why a recorder does not record or soon will not; empty for other nodes and without a fault.

    A recorder repeats its fault every second, so its newest event is sufficient.
    """
    if name_of(health.src) != name_of(RECORDER):
        return ""
    reported = [event for event in status.events.values() if event.src == health.src and event.kind == "recording"]
    newest = max(reported, key=lambda event: event.seq, default=None)
    if newest is not None and newest.data.get("state") in ("failed", "disk_low", "removed"):
        return newest.text
    if health.state == "safe":
        return "records nothing: `telenano session set record.status=true --target recorder` shows why"
    return ""


def open_files_fault(health: NodeHealth) -> str:
    """Return that a process has nearly as many files open as it may; empty if it has fewer, or that is not known."""
    count, most = health.open_files, health.most_open_files
    if not count or not most or count < _NEARLY_ALL * most:
        return ""
    return f"has {count} of at most {most} files and sockets open: `ulimit -n` raises the limit before a start"


def stalled_inputs(first: NodeHealth, newest: NodeHealth) -> list[str]:
    """Return the topics of which a node received nothing between two reports that lie further apart than the deadline.

    Counts are compared, because ages would need the clocks of both sites to agree.
    """
    if first.pid != newest.pid:
        return []
    span_s = (newest.t_ns - first.t_ns) * 1e-9
    before, now = _received(first), _received(newest)
    return sorted(topic for topic, count in now.items() if 0 < count == before.get(topic) and _stale(topic, span_s))


def _stale(topic: str, silence_s: float) -> bool:
    row = row_of(topic)
    return row is not None and row.deadline_s is not None and silence_s > row.deadline_s


def _received(health: NodeHealth) -> dict[str, int]:
    counts: dict[str, int] = {}
    for row in health.inputs:
        counts[row.topic] = counts.get(row.topic, 0) + row.received
    return counts


def document_of(status: RigStatus, expected: Sequence[str]) -> dict[str, Any]:
    """Return the state of a rig as values for JSON, with SI units in the names."""
    problems = problems_of(status, expected)
    health = status.newest(NodeHealth)
    shown = [*expected, *sorted(health.keys() - set(expected))]
    links = list(status.newest(LinkStatus).values())
    return {
        "ok": not problems,
        "problems": [f"{node} {what}" for node, what in problems.items()],
        "nodes": [node_facts(node, health.get(node), problems.get(node)) for node in shown],
        "link": _link_facts(links[0]) if links else None,
        "laws": [_facts(law, _LAW_FACTS) for _, law in sorted(status.newest(LawStatus).items())],
        "hand": [_facts(hand, _HAND_FACTS) for hand in status.newest(HapticState).values()],
        "afm": [_facts(afm, _AFM_FACTS) for afm in status.newest(AfmState).values()],
        "age": [part._asdict() for part in status.age.parts()],
        "connections": status.notices,
        "events": [_facts(event, _EVENT_FACTS) for event in status.events.values()],
    }


def _facts(message: Message, names: Iterable[str]) -> dict[str, Any]:
    return {name: getattr(message, name) for name in names}


def node_facts(node: str, health: NodeHealth | None, problem: str | None) -> dict[str, Any]:
    """Return the health of a node as values for JSON; only name and problem, with `heard` false, if there is none.

    It has every field of node/health, and the counts of the inputs as sums.
    """
    facts: dict[str, Any] = {"node": node, "heard": health is not None, "problem": problem}
    if health is None:
        return facts
    return {
        **facts,
        **_facts(health, (name for name in health.__struct_fields__ if name not in _NO_FACTS)),
        "lateness_p99_s": health.lateness_p99_s if health.period_s else None,
        "oldest_input_s": oldest_input_s(health),
        "received": total(row.received for row in health.inputs),
        "lost": total(row.lost for row in health.inputs),
        "refused": health.rejected,
        "deaf_s": health.deaf_s or {},
        "shares_with": list(health.shares_with or ()),
    }


def _link_facts(link: LinkStatus) -> dict[str, Any]:
    clock = link.clock
    offset = {"offset_s": clock.offset_s, "uncertainty_s": clock.uncertainty_s} if clock.valid else None
    return {"forward": _way_facts(link.forward), "backward": _way_facts(link.backward), "clock": offset}


def _way_facts(way: LinkDirection) -> dict[str, Any]:
    delay_s = way.delay_mean_s if way.delay_valid else None
    return {"profile": way.profile, "delay_mean_s": delay_s, "dropped": way.dropped, "queue_depth": way.queue_depth}
