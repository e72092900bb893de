"""The table of topics: message, publishers, rate and delivery of each.

`row_of("afm/state")` returns a row. Packages declare rows in the same form (`telenano.topics` in
docs/extending/io.md); a process adds such a row to its table when a command, a recording or a message names the topic.
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

    `rate_hz`: declared rate [Hz], None for topics sent on change. `deadline_s`: age at which the newest message counts
    as stale [s], None without a deadline. `delivery`: with `latest` a reader acts on the newest message only, with
    `lossless` it handles every message, and gaps are counted and reported. `bridged`: direction in which the link
    carries the topic, `forward` to the slave, `backward` to the master, `both`, or None.
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
        """Return the faults in the fields of a message of this topic, each with key and kind; empty if valid."""
        return faults_of(self.model, fields)

    def is_published_by(self, node: str) -> bool:
        """Return whether a node (node@site) may publish this topic."""
        return any(matches(node, pattern) or name_of(node) == pattern for pattern in self.publishers)


_COMMANDERS = ("launcher", "console", "console_*", "estop")
_ROWS = (
    Topic("haptic/state", m.HapticState, ("haptic_node",), "latest", 1000.0, 0.05, None),
    # A page sends this at its frame rate while a person pushes. It has no deadline, because no node waits for it.
    Topic("operator/force", m.OperatorForce, ("view",), "lossless", None, None, None),
    Topic("haptic/command", m.HapticCommand, ("controller@master",), "latest", 1000.0, 0.05, None),
    Topic("teleop/forward", m.TeleopForward, ("controller@master",), "latest", 1000.0, 0.05, "forward"),
    Topic("teleop/backward", m.TeleopBackward, ("controller@slave",), "latest", 1000.0, 0.05, "backward"),
    Topic("afm/command", m.AfmCommand, ("controller@slave",), "latest", 1000.0, 0.05, None),
    Topic("afm/state", m.AfmState, ("afm_node",), "latest", 1000.0, 0.05, None),
    Topic("afm/scanline", m.AfmScanline, ("afm_node",), "lossless", None, None, None),
    # Sent while the instrument runs a program; readers react if it is absent for half a second.
    Topic("afm/program", AfmProgram, ("afm_node",), "lossless", None, None, None),
    Topic("law/status", m.LawStatus, ("controller",), "latest", 100.0, 0.2, "backward"),
    Topic("link/status", m.LinkStatus, ("delay_node@master",), "latest", 10.0, 0.5, None),
    Topic("link/delay", m.LinkDelay, ("delay_node",), "lossless", None, None, None),
    Topic("link/fates", m.LinkFates, ("delay_node@master",), "lossless", None, None, None),
    Topic("link/key", network.LinkKey, ("delay_node", "controller"), "lossless", None, None, None),
    Topic("link/network", network.LinkNetwork, ("delay_node", "controller"), "lossless", None, None, "backward"),
    Topic("clock/ping", m.ClockPing, ("delay_node@slave",), "latest", 10.0, 0.5, None),
    Topic("clock/pong", m.ClockPong, ("afm_node",), "latest", 10.0, 0.5, None),
    # Commands cross to the slave. Of those of the slave's site only emergency stops cross to the master.
    Topic("session/control", m.SessionControl, _COMMANDERS, "lossless", None, None, "both"),
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

# The rows of the core, which are part of the wire contract.
OWN_TOPICS: Mapping[str, Topic] = {row.name: row for row in _ROWS}
# The rows that this process knows: those of the core, and those of packages that were needed so far.
TOPICS: dict[str, Topic] = dict(OWN_TOPICS)
NAME = re.compile(r"[a-z]+/[a-z]+")
# Most unknown topics that a recorder records.
MOST_UNKNOWN = 64
# Least deadline in periods of the declared rate, so that one lost message makes nothing stale.
_LEAST_PERIODS = 3.0
# Longest deadline in periods, so that a publisher that is gone is noticed.
_MOST_PERIODS = 100.0
_finders: list[Callable[[str], Topic | None]] = []


def row_of(name: str) -> Topic | None:
    """Return the row of a topic, importing the package that declares it if necessary; None for an unknown topic."""
    return TOPICS.get(name) or next(filter(None, (find(name) for find in _finders)), None)


def find_with(find: Callable[[str], Topic | None]) -> None:
    """Register a function that looks up topics missing from the table and adds those that it finds."""
    _finders.append(find)


def register_topic(row: Topic) -> Topic:
    """Add the row of a package to the table and return it.

    Raises:
        ValueError: The row breaks a rule of the contract; the text names the rule and the remedy.
    """
    if TOPICS.get(row.name) != row and (fault := _fault_of(row)):
        raise ValueError(fault)
    return TOPICS.setdefault(row.name, row)


def keep_unknown(name: str) -> Topic | None:
    """Add a topic whose package is missing to the table, so that its messages can be recorded unchanged.

    Only their header is known and checked. Returns None if the name is no valid topic, overlaps another, or
    `MOST_UNKNOWN` is reached.
    """
    taken = sum(row.model is m.Message for row in TOPICS.values()) >= MOST_UNKNOWN
    if taken or not NAME.fullmatch(name) or _overlap(name):
        return None
    return TOPICS.setdefault(name, Topic(name, m.Message, ("*",), "lossless", None, None, None))


def _fault_of(row: Topic) -> str:
    """Return a sentence on the rule of the contract that a package's row breaks; empty if it breaks none."""
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
    """Return a topic of the table that is a prefix of a name or has it as a prefix; empty if there is none."""
    return next(
        (name_of_table for name_of_table in TOPICS if name_of_table.startswith(name) or name.startswith(name_of_table)),
        "",
    )


def _is_of_table(publisher: str, publishers: set[str]) -> bool:
    return any(matches(name, publisher) for name in publishers) and publisher != "*"


def _faults_of_fields(model: type[m.Message]) -> Iterator[str]:
    """Yield sentences on faulty declarations: a key without description, a number without bounds, a wrong default."""
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
    """Return whether every number in the schema of a field has both bounds; the values of maps are not checked."""
    nested = [part["items"]] if isinstance(part.get("items"), dict) else []
    if part.get("type") in ("number", "integer") and "enum" not in part:
        low = {"minimum", "exclusiveMinimum"} & part.keys()
        return bool(low and {"maximum", "exclusiveMaximum"} & part.keys())
    return all(map(_is_bounded, (*nested, *part.get("anyOf", ()), *part.get("prefixItems", ()))))


def deadline_of(topic: str) -> float:
    """Return the age at which a message on a topic counts as stale [s]; raise ValueError if it has no deadline."""
    deadline_s = TOPICS[topic].deadline_s
    if deadline_s is None:
        raise ValueError(f"{topic} has no deadline")
    return deadline_s


def crosses_from(topic: str, site: str) -> Literal["forward", "backward"] | None:
    """Return the direction in which the link carries a topic away from a site; None if it does not."""
    away: Literal["forward", "backward"] = "forward" if site == "master" else "backward"
    return away if TOPICS[topic].bridged in (away, "both") else None


def output_name(topic: str, endpoint: str) -> str:
    """Return the name of an endpoint's messages on a topic in a journal: the topic, with `@site` if it is ambiguous.

    A process with a further endpoint may publish on the same topic at both, each with its own sequence numbers.
    """
    further = any(row.key == endpoint and row.part == "endpoint" for row in NODES)
    return f"{topic}@{site_of(endpoint)}" if further and name_of(endpoint) in TOPICS[topic].publishers else topic


# Nodes do not act on a sample, command or answer of the loop that is older than this [s]; the whole loop has one
# deadline.
LOOP_DEADLINE_S = deadline_of("haptic/state")
