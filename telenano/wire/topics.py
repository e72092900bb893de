"""The table of topics: message, publishers, rate and delivery of each."""

from dataclasses import dataclass
from typing import Literal

from telenano.wire import experiment_messages as experiment
from telenano.wire import messages as m
from telenano.wire import network_messages as network
from telenano.wire.instrument import AfmParticles, AfmProgram
from telenano.wire.journal_messages import NodeJournal
from telenano.wire.nodes import EXPERIMENT, NODES, name_of, site_of

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


_COMMANDERS = ("launcher", "console", "console_*", "estop")
_EXPERIMENT = (name_of(EXPERIMENT),)
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
    # The truth of a simulation, for recordings: no node reads it, and no link carries it.
    Topic("afm/particles", AfmParticles, ("afm_node",), "lossless", None, None, None),
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
    # A participant's page is told of the first alone; the second is what it answers.
    Topic("experiment/cue", experiment.ExperimentCue, _EXPERIMENT, "lossless", None, None, None),
    Topic("experiment/answer", experiment.ExperimentAnswer, ("view",), "lossless", None, None, None),
    Topic("experiment/trial", experiment.ExperimentTrial, _EXPERIMENT, "lossless", None, None, None),
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

TOPICS: dict[str, Topic] = {row.name: row for row in _ROWS}


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
