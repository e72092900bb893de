"""A process that plays recordings on the bus in the place of nodes."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import zmq

from presets import DEFAULT_SITE_FILE
from proto.errors import ConfigError
from proto.nodes import PLAYER
from recording.channel_filter import Selection
from recording.multi_file import open_recordings
from services.player.node import PlayerNode, PlaySettings, ReplayPlan, ReplayPublisher
from services.player.playback import Playback, Span
from services.runtime.main import load_site
from services.runtime.participant import StopSignals, open_participant, run_loop
from services.runtime.realtime import shallow_idle

# at every message the loop would spin through the gap to the next; these few µs are what a sleep is late by
_SPIN_S = 20e-6


@dataclass(frozen=True)
class ReplayRequest:
    """What was asked for on the command line."""

    files: Sequence[Path]
    site_file: Path = DEFAULT_SITE_FILE
    nodes: Sequence[str] = ()
    topics: Sequence[str] = ()
    exclude: Sequence[str] = ()
    remap: Mapping[str, str] = field(default_factory=dict)
    span: Span = field(default_factory=Span)
    settings: PlaySettings = field(default_factory=PlaySettings)


@dataclass(frozen=True)
class Replayed:
    """What came of a replay."""

    nodes: list[str]
    sent: int
    time_s: float


def run_replay(request: ReplayRequest, observe: Callable[[PlayerNode], None] = lambda player: None) -> Replayed:
    """Play recordings into the rig of a site file until they end or the process is stopped.

    Raises RecordingError, ConfigError, and EndpointError when a node that is to be played runs.
    """
    recording = open_recordings(request.files)
    book = load_site(request.site_file)
    if PLAYER not in book.nodes:
        raise ConfigError(f"{request.site_file}: nodes: {PLAYER} is missing, the player needs an endpoint")
    plan = ReplayPlan(recording, book, Selection.of(request.topics, request.exclude, request.nodes), request.remap)
    playback = Playback(recording, plan.plays, request.span)
    signals = StopSignals()
    with open_participant(PLAYER, book, signals.descriptor) as participant, shallow_idle():
        publisher = participant.bind(PLAYER)
        publishers = {node: ReplayPublisher(participant.bind(node, zmq.XPUB)) for node in plan.nodes}
        sources = book.sources(PLAYER, PlayerNode.inputs)
        live = {node: topics for node, topics in sources.items() if node not in publishers}
        bus = participant.bus_of(publisher, participant.subscribers(live))
        player = PlayerNode(participant.context(bus), playback, plan, publishers, request.settings, observe=observe)
        run_loop(player, bus, signals, spin_s=_SPIN_S)
    return Replayed(plan.nodes, player.sent, playback.time_s)
