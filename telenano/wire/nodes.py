"""The table of nodes: the processes on the bus, their sites, and their parts in a rig."""

from collections.abc import Collection
from typing import Literal, NamedTuple

from telenano.wire.patterns import matches

Site = Literal["master", "slave"]


class NodeRow(NamedTuple):
    """One row of the table: a node, with its key `name@site`.

    `part` is one of: `rig`, a process that the launcher starts and stops; `beside`, a process that the launcher also
    keeps running, but for which no session waits or ends; `carrier`, a process started if a rig needs it, which carries
    messages of others and publishes none under its own name; `joint`, a process of several nodes of a site, if a
    scenario asks for it, each of which publishes under its own name; `endpoint`, a further endpoint of another row's
    process; `launcher`, which supervises the others; `visitor`, which comes and goes with a command. An emergency stop
    connects to the nodes, so it needs no endpoint. Rows are in the order in which a rig is started; `stop` is the
    position in the stop order. A session waits for `required` nodes; the others are optional. `no_rerun` is the reason
    why a node cannot be run again from recorded inputs; empty for nodes that keep a journal of their inputs.
    """

    key: str
    part: Literal["rig", "beside", "carrier", "joint", "endpoint", "launcher", "visitor"]
    stop: int = 0
    required: bool = True
    no_rerun: str = ""


_RECORDS = "the recording is what it makes of its inputs: `telenano bag verify` says whether it is whole"
_BY_HAND = "its commands are those that a person typed"
_CARRIES = "it carries messages of others, and has no inputs of its own"
_JOINS = "it is the process of several nodes, each of which is run again by its own name"
_SUPERVISES = "it acts on processes and on time, which are not in a recording, and publishes nothing else"

# Recorders start first and stop last, so that they record the start and stop of the others. Devices stop first, to be
# safe.
NODES = (
    NodeRow("recorder@slave", "rig", stop=8, required=False, no_rerun=_RECORDS),
    NodeRow("recorder@master", "rig", stop=7, no_rerun=_RECORDS),
    NodeRow("delay_node@master", "rig", stop=5),
    NodeRow("delay_node@slave", "endpoint", no_rerun="it is an endpoint of delay_node@master: run that again"),
    NodeRow("afm_node@slave", "rig", stop=4),
    NodeRow("controller@slave", "rig", stop=3),
    NodeRow("controller@master", "rig", stop=2),
    NodeRow("haptic_node@master", "rig", stop=1),
    NodeRow("viz_node@master", "beside", stop=6, required=False, no_rerun="it only shows what the others send"),
    NodeRow("fan_out@master", "carrier", required=False, no_rerun=_CARRIES),
    NodeRow("relay@master", "carrier", required=False, no_rerun=_CARRIES),
    NodeRow("relay@slave", "carrier", required=False, no_rerun=_CARRIES),
    NodeRow("site@master", "joint", required=False, no_rerun=_JOINS),
    NodeRow("site@slave", "joint", required=False, no_rerun=_JOINS),
    NodeRow("launcher@master", "launcher", required=False, no_rerun=_SUPERVISES),
    NodeRow("launcher@slave", "launcher", required=False, no_rerun=_SUPERVISES),
    NodeRow("console@master", "visitor", required=False, no_rerun=_BY_HAND),
    NodeRow("experiment@master", "visitor", required=False, no_rerun=_BY_HAND),
    NodeRow(
        "player@master",
        "visitor",
        required=False,
        no_rerun="it repeats the messages of another recording: `telenano bag diff` compares the two",
    ),
    NodeRow("view@master", "visitor", required=False, no_rerun=_BY_HAND),
    NodeRow("estop@master", "visitor", required=False, no_rerun=_BY_HAND),
    NodeRow("estop@slave", "visitor", required=False, no_rerun=_BY_HAND),
)

HAND = "haptic_node@master"
TIP = "afm_node@slave"
# Nodes that obey an emergency stop.
DEVICES = (HAND, TIP)
LAUNCHER = "launcher@master"
LAUNCHERS = (LAUNCHER, "launcher@slave")
PLAYER = "player@master"
# The process that serves the page, and the publisher of the force of an operator at that page.
PAGE = "viz_node@master"
VIEW = "view@master"
# Subscribes to each node once and serves all observers on one machine.
FAN_OUT = "fan_out@master"
# Name of the process that reaches the other site through a relay, at either site.
RELAY = "relay"
# An experiment, which publishes its cues and trials.
EXPERIMENT = "experiment@master"
RECORDER = "recorder@master"
FAR_RECORDER = "recorder@slave"
# Name of the process between the sites, and of its endpoint at either site.
LINK = "delay_node"
# Nodes that keep an emergency stop in a file until it is obeyed: each device its own, the link the far device's.
KEEPERS = (*DEVICES, f"{LINK}@master")
# The node at the slave's site in which the link ends if messages cross as datagrams.
FAR_END = "controller@slave"

# The nodes that share a process where the scenario gives `realtime.processes: site`, in the order in which they are
# built. The device, or else the half, is the last of a site: where the process is placed follows from it.
JOINED = {
    "site@master": (f"{LINK}@master", "controller@master", HAND),
    "site@slave": ("controller@slave", TIP),
}

_RIG = tuple(row for row in NODES if row.part == "rig")
_PROCESSES = tuple(row for row in NODES if row.part in ("rig", "beside"))
START_ORDER = tuple(row.key for row in _RIG if row.required)
OPTIONAL_NODES = tuple(row.key for row in _RIG if not row.required)
STOP_ORDER = tuple(row.key for row in sorted(_PROCESSES, key=lambda row: row.stop))
# Nodes that keep a journal of their inputs and can be run again from it.
RERUN_NODES = tuple(row.key for row in _RIG if not row.no_rerun)


def name_of(node: str) -> str:
    """Return the name of `name@site`."""
    return node.partition("@")[0]


def site_of(node: str) -> str:
    """Return the site of `name@site`."""
    return node.partition("@")[2]


_NAMES = frozenset(name_of(row.key) for row in NODES)
SERVICES = tuple(dict.fromkeys(name_of(node) for node in STOP_ORDER))


def module_of(name: str) -> str:
    """Return the module of a process, for `python -m`.

    Raises:
        ValueError: The table of nodes has no process of this name.
    """
    if name not in _NAMES:
        raise ValueError(
            f"no process is called {name!r}: it must be a row of the table of nodes (telenano/wire/nodes.py)"
        )
    return f"services.{name}"


def sites_of(name: str) -> tuple[str, ...]:
    """Return the sites at which processes of this name may run, the master's first."""
    return tuple(sorted(site_of(row.key) for row in _PROCESSES if name_of(row.key) == name))


def is_console(node: str) -> bool:
    """Return whether a node is a console: console@site, or console_NAME@site on a further machine."""
    name = name_of(node)
    return name == "console" or name.startswith("console_")


def is_estop(node: str) -> bool:
    """Return whether a node sends emergency stops."""
    return name_of(node) == "estop"


def is_meant(node: str, target: str) -> bool:
    """Return whether a target, which is node@site, a node name or a pattern, includes a node (node@site)."""
    return matches(node, target) or matches(name_of(node), target)


def is_pattern(target: str) -> bool:
    """Return whether a target has wildcards; nodes ignore unknown commands to a pattern instead of refusing them."""
    return any(sign in target for sign in "*?[")


def begins_anew(node: str) -> bool:
    """Return whether each process of a node is there for one command, which it repeats until it is answered.

    Then nothing is lost with the repetitions from before a reader was connected.
    """
    return is_console(node) or name_of(node) == "estop"


def is_visitor(node: str) -> bool:
    """Return whether a node comes and goes, so that its absence from a rig is not reported."""
    return is_console(node) or any(
        name_of(row.key) == name_of(node) and row.part in ("beside", "visitor") for row in NODES
    )


def endpoints_of(node: str) -> tuple[str, ...]:
    """Return the endpoints of the process of a node, its own first."""
    return (node, *(row.key for row in NODES if row.part == "endpoint" and name_of(row.key) == name_of(node)))


def counts_for_process(node: str, shares_with: Collection[str] | None) -> bool:
    """Return whether a sum over nodes counts the process of a node by this one, and not by one that it shares it with.

    Args:
        node: The node.
        shares_with: The others in its process, as node/health has them.
    """
    return all(node < other for other in shares_with or ())


def no_rerun_reason(node: str) -> str:
    """Return the reason why a node cannot be run again from a recording; empty if it can."""
    if is_console(node):
        node = f"console@{site_of(LAUNCHER)}"
    reasons = {row.key: row.no_rerun for row in NODES}
    return reasons.get(node, "it is not in the table of nodes")
