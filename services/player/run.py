"""Setup and run of the process that plays recordings on the bus instead of nodes."""

import contextlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import zmq

from services.player.node import PlayerNode, PlaySettings, ReplayPublisher
from services.player.plan import ReplayPlan, node_of
from services.player.playback import Playback, Span
from telenano.recording.channel_filter import Selection
from telenano.recording.messages import RecordedChannel
from telenano.recording.multi_file import RecordingSource, open_recordings
from telenano.runtime.bus.address_book import AddressBook
from telenano.runtime.loop.realtime import on_time, shallow_idle
from telenano.runtime.wiring.participant import Participant, StopSignals
from telenano.settings.included import DEFAULT_SITE_FILE
from telenano.wire import TOPICS
from telenano.wire.errors import ConfigError, RecordingError, RigError
from telenano.wire.nodes import LINK, PLAYER, is_console, name_of

# One message of each channel within this time from the start is test-decoded; most channels have one within a second.
_TRIED_NS = 5_000_000_000
_RIG = "start the rest of the rig beside it, by `telenano up --without NODE --allow-replay`"


@dataclass(frozen=True)
class ReplayRequest:
    """Request of a replay, from the command line."""

    files: Sequence[Path]
    site_file: Path = DEFAULT_SITE_FILE
    nodes: Sequence[str] = ()
    topics: Sequence[str] = ()
    exclude: Sequence[str] = ()
    span: Span = field(default_factory=Span)
    settings: PlaySettings = field(default_factory=PlaySettings)
    # Whether to join files that do not state whether they belong to one session.
    same_session: bool = False


@dataclass(frozen=True)
class ReplayResult:
    """Result of a replay: played nodes, number of messages sent, reached time [s] and warnings."""

    nodes: list[str]
    sent: int
    time_s: float
    warnings: list[str]


def run_replay(
    request: ReplayRequest,
    observe: Callable[[PlayerNode], None] = lambda player: None,
    warn: Callable[[str], None] = lambda text: None,
) -> ReplayResult:
    """Play recordings into the rig of a site file until they end or the process is stopped.

    `warn` is called with each sentence on a limitation of this replay, mostly before the start.
    Raises RecordingError if a file cannot be read or there is nothing to play, ConfigError, EndpointError if a node to
    be played is running, and RigError if no node read the messages.
    """
    # The index lets an hour of recording start at once. Messages in the wrong order are sorted by their times.
    recording = open_recordings(request.files, same_session=request.same_session)
    book = AddressBook.load(request.site_file)
    if PLAYER not in book.nodes:
        raise ConfigError(f"{request.site_file}: nodes: {PLAYER} is missing, the player needs an endpoint")
    selection = Selection.of(request.topics, request.exclude, request.nodes)
    selection.demand_some_of(recording.path, recording.channels)
    plan = ReplayPlan(recording, book, selection)
    playback = Playback(recording, plan.plays, request.span)
    if playback.peek() is None:
        nodes = ", ".join(plan.nodes)
        raise RecordingError(f"{recording.path}: has no message of {nodes} in the selection: nothing can be played")
    warnings = [*refused_messages(recording, playback), *absent_topics(plan, book), *remote_control(plan, book)]
    for text in warnings:
        warn(text)
    signals, messages = StopSignals(), list[str]()
    # Real-time scheduling is of no use at rate 0, and would keep other processes from running.
    scheduling = on_time() if request.settings.rate > 0.0 else contextlib.nullcontext()
    with scheduling, Participant.open(PLAYER, book, signals.descriptor) as participant, shallow_idle():
        publisher = participant.bind(PLAYER)
        publishers = {node: ReplayPublisher(participant.bind(node, zmq.XPUB)) for node in plan.nodes}
        sources = book.sources(PLAYER, PlayerNode.inputs)
        live = {node: topics for node, topics in sources.items() if node not in publishers}
        bus = participant.bus_of(publisher, participant.subscribers(live))

        def watch(player: PlayerNode) -> None:
            if player.started and not messages and not any(publisher.was_read for publisher in publishers.values()):
                messages.append(f"no node reads the played messages: {_RIG}")
                warn(messages[0])
            observe(player)

        player = PlayerNode(
            participant.context(bus), playback, plan, publishers, request.settings, observe=watch, warnings=warnings
        )
        signals.run(player, bus)
    if player.sent and not any(publisher.was_read for publisher in publishers.values()):
        raise RigError(f"{player.sent} messages of {', '.join(plan.nodes)} were played, and no node read them: {_RIG}")
    return ReplayResult(plan.nodes, player.sent, playback.time_s, warnings)


def refused_messages(recording: RecordingSource, playback: Playback) -> Iterator[str]:
    """Yield a sentence for each channel whose messages readers of this version refuse."""
    tried: set[RecordedChannel] = set()
    first_ns = playback.start_ns
    for message in recording.select(playback.channel_filter, first_ns, first_ns + _TRIED_NS):
        if message.channel in tried:
            continue
        tried.add(message.channel)
        try:
            message.decode()
        except RecordingError as error:
            yield f"every reader of this version refuses the played messages of {message.channel_topic}: {error}"


def absent_topics(plan: ReplayPlan, book: AddressBook) -> Iterator[str]:
    """Yield a sentence for each node that is played without topics of a declared rate, for which readers wait."""
    for node in plan.nodes:
        if name_of(node) == LINK:
            continue
        played = {channel.topic for channel in plan.channels if node_of(channel) == node}
        rated = [topic for topic in book.published_by(node) if TOPICS[topic].rate_hz and topic != "node/health"]
        lacking = [topic for topic in rated if topic not in played and plan.chooses(topic)]
        if lacking:
            yield f"{node} is played without {', '.join(lacking)}, which is not in the recording"


def remote_control(plan: ReplayPlan, book: AddressBook) -> Iterator[str]:
    """Yield sentences on remote control: no console can command the player, or recorded commands are left out."""
    consoles = [node for node in book.nodes if is_console(node)]
    if not consoles:
        yield "there is no remote control: the site file has no console; the keys work"
    elif set(consoles) <= set(plan.nodes):
        yield f"there is no remote control: {', '.join(consoles)} is played; the keys work"
    for node in plan.without_place:
        yield f"{node} is not played: it is not in the site file, and only reports on the processes of its site"
    for node in plan.left_out:
        yield f"the commands of {node} are not played, so that it can control the replay: --nodes plays them"
