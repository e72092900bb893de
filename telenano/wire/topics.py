"""The table of topics: message, publishers, rate and delivery of each.

`row_of("afm/state")` returns a row. A package declares rows of its own in the same form (`telenano.topics` in
docs/extending/io.md); a process takes one into the table when a command, a recording or a message names it.
"""

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import msgspec

from telenano.wire import messages as m
from telenano.wire import network_messages as network
from telenano.wire.instrument import AfmProgram
from telenano.wire.journal_messages import NodeJournal
from telenano.wire.nodes import NODES, name_of, site_of
from telenano.wire.patterns import matches
from telenano.wire.refusals import Fault, faults_of
from telenano.wire.schema import json_schema

Delivery = Literal["latest", "lossless"]


@dataclass(frozen=True)
class Topic:
    """One row of the table.

    `rate_hz` is the declared rate, None for topics sent on change. `deadline_s` is how old the newest message may be
    before it counts as stale, None where no deadline applies. `latest`: a reader acts on the newest message only;
    `lossless`: a reader handles every one, and a gap is counted and reported. `bridged` is the direction in which the
    link carries it: `forward` to the slave, `backward` to the master, `both`, or None.
    """

    name: str
    model: type[m.Message]
    publishers: tuple[str, ...]
    delivery: Delivery
    rate_hz: float | None
    deadline_s: float | None
    bridged: Literal["forward", "backward", "both"] | None
    recorded: bool = True

    def faults_in(self, fields: Mapping[str, Any]) -> list[Fault]:
        """Return what is wrong with the fields of a message of this topic, each with key and kind."""
        return faults_of(self.model, fields)

    def is_published_by(self, node: str) -> bool:
        """Return whether a node (node@site) may publish it."""
        return any(matches(node, pattern) or name_of(node) == pattern for pattern in self.publishers)


_COMMANDERS = ("launcher", "console", "console_*", "estop")
_ROWS = (
    Topic("haptic/state", m.HapticState, ("haptic_node",), "latest", 1000.0, 0.05, None),
    # A page sends this at its frame rate while a person pushes. No node waits for it, and none is at fault when it
    # ends.
    Topic("operator/force", m.OperatorForce, ("view",), "lossless", None, None, None),
    Topic("haptic/command", m.HapticCommand, ("controller@master",), "latest", 1000.0, 0.05, None),
    Topic("teleop/forward", m.TeleopForward, ("controller@master",), "latest", 1000.0, 0.05, "forward"),
    Topic("teleop/backward", m.TeleopBackward, ("controller@slave",), "latest", 1000.0, 0.05, "backward"),
    Topic("afm/command", m.AfmCommand, ("controller@slave",), "latest", 1000.0, 0.05, None),
    Topic("afm/state", m.AfmState, ("afm_node",), "latest", 1000.0, 0.05, None),
    Topic("afm/scanline", m.AfmScanline, ("afm_node",), "lossless", None, None, None),
    # It is sent while the instrument runs a program; its readers act on a lack of it after half a second.
    Topic("afm/program", AfmProgram, ("afm_node",), "lossless", None, None, None),
    Topic("law/status", m.LawStatus, ("controller",), "latest", 100.0, 0.2, "backward"),
    Topic("link/status", m.LinkStatus, ("delay_node@master",), "latest", 10.0, 0.5, None),
    Topic("link/delay", m.LinkDelay, ("delay_node",), "lossless", None, None, None),
    Topic("link/fates", m.LinkFates, ("delay_node@master",), "lossless", None, None, None),
    Topic("link/key", network.LinkKey, ("delay_node", "controller"), "lossless", None, None, None),
    Topic("link/network", network.LinkNetwork, ("delay_node", "controller"), "lossless", None, None, "backward"),
    Topic("clock/ping", m.ClockPing, ("delay_node@slave",), "latest", 10.0, 0.5, None),
    Topic("clock/pong", m.ClockPong, ("afm_node",), "latest", 10.0, 0.5, None),
    Topic("session/control", m.SessionControl, _COMMANDERS, "lossless", None, None, "forward"),
    Topic("session/event", m.SessionEvent, ("*",), "lossless", None, None, "backward"),
    Topic("node/health", m.NodeHealth, ("*",), "latest", 2.0, 2.0, "backward"),
    Topic("recording/piece", network.RecordingPiece, ("launcher@slave",), "lossless", None, None, None, recorded=False),
    Topic(
        "node/journal",
        NodeJournal,
        ("haptic_node", "controller", "afm_node", "delay_node@master"),
        "lossless",
        None,
        None,
        None,
    ),
)

# The rows of the core, which are the contract of the wire.
OWN_TOPICS: Mapping[str, Topic] = {row.name: row for row in _ROWS}
# The rows that this process knows: those of the core, and of packages those that were named to it.
TOPICS: dict[str, Topic] = dict(OWN_TOPICS)
NAME = re.compile(r"[a-z]+/[a-z]+")
# A recorder keeps at most this many topics that it does not know.
MOST_UNKNOWN = 64
# A deadline is at least this many periods of the declared rate, so that a lost message makes nothing stale.
_LEAST_PERIODS = 3.0
# A deadline is at most this many periods, so that a publisher that is gone is noticed.
_MOST_PERIODS = 100.0
_finders: list[Callable[[str], Topic | None]] = []


def row_of(name: str) -> Topic | None:
    """Return the row of a topic, for which a package that declares it is imported; None for one that is unknown."""
    return TOPICS.get(name) or next(filter(None, (find(name) for find in _finders)), None)


def find_with(find: Callable[[str], Topic | None]) -> None:
    """Look up the topics that are missing from the table with a function, which takes those it finds into the table."""
    _finders.append(find)


def register_topic(row: Topic) -> Topic:
    """Take the row of a package into the table.

    Raises:
        ValueError: The row breaks a rule of the contract; the text says which, and what would be right.
    """
    if TOPICS.get(row.name) != row and (fault := _fault_of(row)):
        raise ValueError(fault)
    return TOPICS.setdefault(row.name, row)


def keep_unknown(name: str) -> Topic | None:
    """Take a topic whose package is missing into the table, to keep its messages as they come; None for no such name.

    Only the header of its messages is known, so only that is checked.
    """
    taken = sum(row.model is m.Message for row in TOPICS.values()) >= MOST_UNKNOWN
    if taken or not NAME.fullmatch(name) or _overlap(name):
        return None
    return TOPICS.setdefault(name, Topic(name, m.Message, ("*",), "lossless", None, None, None))


def _fault_of(row: Topic) -> str:
    """Return which rule of the contract the row of a package breaks; empty where there is none."""
    if not NAME.fullmatch(row.name):
        return f"topic {row.name!r}: must be two words of lower-case letters with / between them, such as wind/speed"
    if other := _overlap(row.name):
        return f"{row.name}: telenano has the topic {other}, and ZeroMQ subscribes by the beginning of a name"
    if not (isinstance(row.model, type) and issubclass(row.model, m.Message) and row.model is not m.Message):
        return f"{row.name}: its model must be a class that inherits from telenano.wire.Message"
    if row.model.__name__ in {topic.model.__name__ for topic in TOPICS.values()}:
        return f"{row.name}: {row.model.__name__} is the name of another message, which recordings know schemas by"
    nodes = {name for node in NODES if node.part not in ("carrier", "joint") for name in (node.key, name_of(node.key))}
    wrong = [each for each in row.publishers if not _is_of_table(each, nodes)]
    if wrong or not row.publishers:
        return f"{row.name}: publishers: {', '.join(wrong) or 'none'}: must be among {', '.join(sorted(nodes))}"
    if row.bridged is not None:
        return f"{row.name}: bridged: the link carries the topics of telenano only, so it must be None"
    if row.delivery == "latest" and (row.rate_hz is None or row.deadline_s is None):
        return f"{row.name}: a topic that is read as latest needs rate_hz and deadline_s"
    if row.delivery != "latest" and (row.rate_hz, row.deadline_s) != (None, None):
        return f"{row.name}: a topic that is read as lossless has neither rate_hz nor deadline_s"
    if (
        row.delivery == "latest"
        and not _LEAST_PERIODS <= (row.rate_hz or 0.0) * (row.deadline_s or 0.0) <= _MOST_PERIODS
    ):
        return f"{row.name}: deadline_s must be {_LEAST_PERIODS:g} to {_MOST_PERIODS:g} periods of rate_hz"
    return next(_faults_of_fields(row.model), "")


def _overlap(name: str) -> str:
    """Return the topic that begins a name or begins with it; empty where there is none."""
    return next(
        (name_of_table for name_of_table in TOPICS if name_of_table.startswith(name) or name.startswith(name_of_table)),
        "",
    )


def _is_of_table(publisher: str, publishers: set[str]) -> bool:
    return any(matches(name, publisher) for name in publishers) and publisher != "*"


def _faults_of_fields(model: type[m.Message]) -> Iterator[str]:
    """Yield what is wrong with the fields of a message: a key without description, a number without bounds."""
    schema = json_schema(model)
    kinds = {model.__name__: schema, **schema.get("$defs", {})}
    for name, kind in kinds.items():
        for key, part in kind["properties"].items():
            if name != m.Array.__name__ and "description" not in part:
                yield f"{name}.{key} has no description: declare it as Annotated[TYPE, about(TEXT)]"
            if name != m.Array.__name__ and key != "v" and not _is_bounded(part):
                yield f"{name}.{key} is a number without bounds: take a Range of telenano.wire, or Meta(ge=, le=)"
    for field in msgspec.structs.fields(model):
        if not field.required and field.default is not None:
            yield f"{model.__name__}.{field.name}: a key that may be absent has the default None"


def _is_bounded(part: dict[str, Any]) -> bool:
    """Return whether every number in the schema of a field has both bounds; a map of facts may hold any."""
    nested = [part["items"]] if isinstance(part.get("items"), dict) else []
    if part.get("type") in ("number", "integer") and "enum" not in part:
        low = {"minimum", "exclusiveMinimum"} & part.keys()
        return bool(low and {"maximum", "exclusiveMaximum"} & part.keys())
    return all(map(_is_bounded, (*nested, *part.get("anyOf", ()), *part.get("prefixItems", ()))))


def deadline_of(topic: str) -> float:
    """Return how old a message on a topic may be before it counts as stale [s]; ValueError for one without deadline."""
    deadline_s = TOPICS[topic].deadline_s
    if deadline_s is None:
        raise ValueError(f"{topic} has no deadline")
    return deadline_s


def output_name(topic: str, endpoint: str) -> str:
    """Return what a journal calls the messages of an endpoint on a topic: the topic, and the site where that needs it.

    A process with a further endpoint may publish on the same topic at both, with numbers of their own.
    """
    further = any(row.key == endpoint and row.part == "endpoint" for row in NODES)
    return f"{topic}@{site_of(endpoint)}" if further and name_of(endpoint) in TOPICS[topic].publishers else topic


# Nodes do not act on a sample, a command or an answer of the loop that is older than this; the whole loop has one
# deadline.
LOOP_DEADLINE_S = deadline_of("haptic/state")
