"""The player on real sockets inside one process, in virtual time."""

from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import msgspec
import pytest
import yaml
import zmq
from recorder_samples import EPOCH_NS, MILLISECOND_NS, NODE, haptic_state, sample, session_control, teleop_forward

from services.player.node import PlayerNode, PlaySettings, ReplayPublisher
from services.player.plan import ReplayPlan
from services.player.playback import Playback, Span
from services.player.run import ReplayRequest, absent_topics, refused_messages, remote_control, run_replay
from telenano.recording.channel_filter import Selection
from telenano.recording.reader import Recording
from telenano.recording.recorder_config import RecorderConfig
from telenano.recording.writer import RecordingWriter
from telenano.runtime.bus.address_book import AddressBook
from telenano.runtime.bus.bus import ZmqBus
from telenano.runtime.bus.publisher import ZmqPublisher
from telenano.runtime.loop.log import StructuredLog
from telenano.runtime.loop.node import NodeContext
from telenano.settings import DEFAULT_SITE_FILE
from telenano.testing import VirtualClock
from telenano.wire import decode, encode
from telenano.wire.codec import fields_of
from telenano.wire.errors import ConfigError, RecordingError, RefusedError, RigError
from telenano.wire.messages import HapticState, Message, NodeHealth, SessionControl, SessionEvent
from telenano.wire.nodes import PLAYER

HAND, FAR = "haptic_node@master", "delay_node@slave"
MakeFile = Callable[..., Path]


@pytest.fixture
def book(tmp_path: Path) -> AddressBook:
    nodes = (HAND, FAR, PLAYER, "controller@master", "controller@slave")
    return AddressBook(nodes={node: f"ipc://{tmp_path}/{node}" for node in nodes})


class Stage:
    """A player and one reader of each endpoint."""

    def __init__(
        self, context: "zmq.Context[Any]", book: AddressBook, path: Path, selection: Selection, **given: Any
    ) -> None:
        self.clock = VirtualClock(0, EPOCH_NS + 10**12)
        recording = Recording(path)
        self.plan = ReplayPlan(recording, book, selection)
        self.playback = Playback(recording, self.plan.plays, given.pop("span", Span()))
        publishers = {
            node: ReplayPublisher(ZmqPublisher(context, self.clock, node, book.endpoint(node), kind=zmq.XPUB))
            for node in self.plan.nodes
        }
        self.publishers = publishers
        self.own = ZmqPublisher(context, self.clock, PLAYER, book.endpoint(PLAYER))
        bus = ZmqBus(self.own, [], self.clock, -1)
        self.events: list[SessionEvent] = []
        publish = bus.publish

        def kept(topic: str, **fields: Any) -> Message:
            message = publish(topic, **fields)
            if isinstance(message, SessionEvent):
                self.events.append(message)
            return message

        bus.publish = kept
        node_context = NodeContext(PLAYER, self.clock, bus, StructuredLog(PLAYER))
        self.player = PlayerNode(node_context, self.playback, self.plan, publishers, PlaySettings(**given))
        self.reader = context.socket(zmq.SUB)
        self.reader.set(zmq.RCVTIMEO, 5000)
        self.reader.set(zmq.LINGER, 0)
        self.context = context

    def listen(self, nodes: Sequence[str], topic: str = "") -> None:
        self.reader.subscribe(topic)
        for node in nodes:
            self.reader.connect(self.publishers[node].publisher.socket.get(zmq.LAST_ENDPOINT).decode())
            # the subscription has arrived once the publisher has something to read
            while not self.publishers[node].publisher.socket.poll(1000):
                pass

    def run_ms(self, duration_ms: float) -> None:
        """Let time pass, from deadline to deadline."""
        end = self.clock.monotonic_ns() + round(duration_ms * 1e6)
        while not self.player.finished:
            due = self.player.deadline_ns()
            if due > end:
                break
            self.clock.advance_ns(max(0, due - self.clock.monotonic_ns()))
            self.player.on_deadline(self.clock.monotonic_ns())
        self.clock.advance_ns(max(0, end - self.clock.monotonic_ns()))

    def received(self, count: int) -> list[tuple[str, bytes]]:
        frames = [self.reader.recv_multipart() for _ in range(count)]
        return [(topic.decode(), payload) for topic, payload in frames]

    def received_states(self, count: int) -> list[HapticState]:
        """Return the next `count` states, skipping other messages."""
        found: list[HapticState] = []
        while len(found) < count:
            topic, payload = self.reader.recv_multipart()
            if topic == b"haptic/state":
                message = decode("haptic/state", payload)
                assert isinstance(message, HapticState)
                found.append(message)
        return found

    def command(self, name: str = "set", **parameters: Any) -> str:
        fields = {**fields_of(session_control(0)), "command": name, "target": "player", "parameters": parameters}
        return self.player.on_control(msgspec.convert(fields, SessionControl))

    def close(self) -> None:
        self.reader.close()
        for publisher in self.publishers.values():
            publisher.publisher.socket.set(zmq.LINGER, 0)
            publisher.publisher.close()
        self.own.close()


@pytest.fixture
def stage(book: AddressBook) -> Iterator[Callable[..., Stage]]:
    made: list[Stage] = []
    with zmq.Context() as context:

        def make(path: Path, selection: Selection | None = None, **given: Any) -> Stage:
            chosen = Selection.of(["haptic/state"]) if selection is None else selection
            made.append(Stage(context, book, path, chosen, **given))
            return made[-1]

        yield make
        for each in made:
            each.close()


def test_the_bytes_are_those_of_the_recording_on_the_endpoint_of_their_node(
    stage: Callable[..., Stage], make_file: MakeFile
) -> None:
    path = make_file()
    rig = stage(path, Selection())
    assert rig.plan.nodes == [FAR, HAND]
    rig.listen([HAND], "haptic/state")
    rig.listen([FAR], "teleop/forward")
    rig.reader.subscribe("")
    rig.run_ms(100)
    expected = {(m.topic, m.payload) for m in Recording(path).messages()}
    got: set[tuple[str, bytes]] = set()
    while got != expected:
        topic, payload = rig.received(1)[0]
        if topic != "node/health":
            got.add((topic, payload))
    assert rig.player.sent == 80
    assert rig.player.finished


def test_health_says_that_it_is_a_replay_before_anything_else(stage: Callable[..., Stage], make_file: MakeFile) -> None:
    rig = stage(make_file())
    rig.listen([HAND])
    rig.run_ms(100)
    topic, payload = rig.received(1)[0]
    assert topic == "node/health"
    health = decode(topic, payload)
    assert isinstance(health, NodeHealth)
    assert (health.src, health.replay) == (HAND, True)
    assert rig.player.replay


def test_messages_are_sent_when_they_are_due(stage: Callable[..., Stage], make_file: MakeFile) -> None:
    rig = stage(make_file(), rate=2.0)
    rig.listen([HAND], "haptic/state")
    rig.run_ms(5.2)
    # twice as fast as one a ms, and the first at once
    assert rig.player.sent == 11
    rig.command(**{"player.rate": 1.0})
    rig.run_ms(5.0)
    assert rig.player.sent == 16


def test_what_can_wait_is_done_between_messages_and_makes_none_late(
    stage: Callable[..., Stage], make_file: MakeFile, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = stage(make_file(), wait_s=0.0, rate=0.05)
    calls: list[int] = []

    def observe(player: PlayerNode) -> None:
        calls.append(rig.clock.monotonic_ns())
        rig.clock.advance_ns(200_000)

    sent_ns: list[int] = []
    send = ReplayPublisher.send

    def noted(publisher: ReplayPublisher, topic: bytes, payload: bytes) -> bool:
        sent_ns.append(rig.clock.monotonic_ns())
        return send(publisher, topic, payload)

    monkeypatch.setattr(ReplayPublisher, "send", noted)
    rig.player._observe = observe
    rig.run_ms(850)
    assert rig.player.finished
    # One message every 20 ms, from the first tick on, whose multiples are those of the ticks as well.
    assert {later - earlier for earlier, later in pairwise(sent_ns)} == {20 * MILLISECOND_NS}
    assert len(calls) > 10


@pytest.mark.parametrize("rate", [0.0, 100.0])
def test_what_can_wait_is_done_where_messages_leave_no_gap(
    stage: Callable[..., Stage], make_file: MakeFile, rate: float
) -> None:
    rig = stage(make_file(), wait_s=0.0, rate=rate, span=Span(loop=True))
    calls: list[int] = []
    rig.player._observe = lambda player: calls.append(rig.clock.monotonic_ns())
    for _ in range(100):
        rig.clock.advance_ns(10 * MILLISECOND_NS)
        rig.player.on_deadline(rig.clock.monotonic_ns())
    assert len(calls) >= 19


def test_nothing_is_sent_before_somebody_listens_or_the_wait_is_over(
    stage: Callable[..., Stage], make_file: MakeFile
) -> None:
    rig = stage(make_file(), wait_s=0.2)
    rig.run_ms(190)
    assert rig.player.sent == 0
    assert "waiting for readers" in rig.player.status()
    rig.run_ms(300)
    assert rig.player.sent == 40
    assert any("no reader has subscribed to haptic/state" in event.text for event in rig.events)


def test_pause_and_step(stage: Callable[..., Stage], make_file: MakeFile) -> None:
    rig = stage(make_file(), Selection(), paused=True, wait_s=0.0)
    rig.run_ms(100)
    assert rig.player.sent == 0
    rig.command(**{"player.step": 1})
    rig.run_ms(60)
    assert rig.player.sent == 1
    rig.command(**{"player.step": 4})
    rig.run_ms(60)
    assert rig.player.sent == 5
    rig.command("start")
    rig.run_ms(100)
    assert rig.player.finished


def test_after_a_seek_the_state_is_sent_and_numbers_go_on(stage: Callable[..., Stage], make_file: MakeFile) -> None:
    rig = stage(make_file())
    rig.listen([HAND], "haptic/state")
    rig.run_ms(10.2)
    assert [state.seq for state in rig.received_states(11)] == list(range(11))
    rig.command(**{"player.seek_s": 0.0305, "player.pause": True})
    rig.run_ms(60)
    (state,) = rig.received_states(1)
    # the hand as it was at 30 ms, its own time kept, its number the next that readers expect
    assert (state.seq, state.t_ns) == (11, haptic_state(30).t_ns)
    rig.command(**{"player.pause": False})
    rig.run_ms(5)
    assert [(s.seq, s.t_ns) for s in rig.received_states(2)] == [
        (12, haptic_state(31).t_ns),
        (13, haptic_state(32).t_ns),
    ]
    rig.command(**{"player.skip_s": -0.020})
    rig.run_ms(60)
    times = [state.t_ns for state in rig.received_states(6)]
    assert any(later < earlier for earlier, later in pairwise(times))


def test_a_loop_between_two_points_goes_round_without_a_gap_in_the_numbers(
    stage: Callable[..., Stage], make_file: MakeFile
) -> None:
    rig = stage(make_file(), span=Span(0.010, 0.020, loop=True))
    rig.listen([HAND], "haptic/state")
    rig.run_ms(35)
    states = rig.received_states(30)
    assert [state.seq for state in states] == list(range(states[0].seq, states[0].seq + 30))
    places = {round((state.t_ns - EPOCH_NS) / MILLISECOND_NS) for state in states}
    assert places == set(range(9, 20))
    rig.command(**{"player.loop": False})
    rig.run_ms(50)
    assert rig.player.finished


@pytest.mark.check("takes 1.5 s")
def test_a_slow_reader_holds_the_replay_up_and_loses_nothing(stage: Callable[..., Stage], tmp_path: Path) -> None:
    writer = RecordingWriter.create(NODE, RecorderConfig(directory=tmp_path))
    hand = writer.channel("haptic/state", HAND, "master")
    count = 60_000
    payload = encode(haptic_state(0))
    for seq in range(count):
        writer.write(hand, EPOCH_NS + seq * 1000, EPOCH_NS + seq, seq, payload)
    writer.finish()
    rig = stage(writer.path, rate=0.0)
    rig.reader.set(zmq.RCVHWM, 100)
    rig.listen([HAND], "haptic/state")
    rig.run_ms(1000)
    assert rig.player.blocked
    assert rig.player.sent < count
    assert "waiting for a slow reader" in rig.player.status()
    received = 0
    while received < count:
        while rig.reader.poll(0):
            rig.reader.recv_multipart()
            received += 1
        rig.run_ms(10)
    assert rig.player.sent == received == count


def test_commands_are_answered_and_wrong_ones_refused(stage: Callable[..., Stage], make_file: MakeFile) -> None:
    rig = stage(make_file(), paused=True)
    assert "rate 3" in rig.command(**{"player.rate": 3})
    assert "loop" in rig.command(**{"player.loop": True, "player.a_s": 0.01, "player.b_s": 0.02})
    assert rig.playback.end_ns == rig.playback.at(0.02)
    for parameters, text in (
        ({"player.speed": 1.0}, "player.speed is unknown"),
        ({}, "set needs parameters"),
        ({"player.rate": -1.0}, "must be 0"),
        ({"player.rate": 1e-300}, r"or 1e-06 or more"),
        ({"player.rate": True}, "a float is needed"),
        ({"player.step": 0}, "must be 1 or more"),
        ({"player.next_event": True}, "there is no event"),
    ):
        with pytest.raises(RefusedError, match=text):
            rig.command(**parameters)
    assert "finished" not in [event.data["state"] for event in rig.events]
    # no time is too far away to be named: the nearest that there is is taken
    for time_s in (1e300, -1e300, 2**63 - 1):
        rig.command(**{"player.seek_s": time_s})
        assert rig.playback.origin_ns <= rig.playback.position_ns <= rig.playback.end_ns
        rig.run_ms(1)
    rig.command("stop")
    assert rig.events[-1].data["state"] == "finished"


def test_the_clock_of_the_recording_is_published(stage: Callable[..., Stage], make_file: MakeFile) -> None:
    rig = stage(make_file(), wait_s=0.0, rate=0.01)
    rig.run_ms(3200)
    times = [event.data["time_s"] for event in rig.events if event.data["state"] == "playing"]
    assert len(times) == 3
    assert times == sorted(times)
    assert rig.playback.origin_ns < rig.events[-1].data["time_ns"] <= rig.playback.position_ns


def test_a_recorded_command_is_sent_as_one_of_now(stage: Callable[..., Stage], tmp_path: Path) -> None:
    writer = RecordingWriter.create(NODE, RecorderConfig(directory=tmp_path))
    channel = writer.channel("session/control", "launcher@master", "slave")
    for seq in range(2):
        at_ns = EPOCH_NS + seq * MILLISECOND_NS
        writer.write(channel, at_ns, at_ns, seq, encode(session_control(seq)))
    writer.finish()
    rig = stage(writer.path, Selection())
    rig.listen([FAR], "session/control")
    rig.run_ms(60)
    sent = [decode(topic, payload) for topic, payload in rig.received(2)]
    assert [message.seq for message in sent] == [0, 1]
    # with their own times they would have expired
    assert all(0 <= rig.clock.now_ns() - message.t_ns <= 60 * MILLISECOND_NS for message in sent)
    played = [msgspec.structs.replace(message, t_ns=0) for message in sent]
    assert played == [msgspec.structs.replace(session_control(seq), t_ns=0) for seq in range(2)]


def test_a_recorded_arm_releases_no_emergency_stop_of_now(stage: Callable[..., Stage], tmp_path: Path) -> None:
    writer = RecordingWriter.create(NODE, RecorderConfig(directory=tmp_path))
    channel = writer.channel("session/control", "launcher@master", "slave")
    quoting = msgspec.structs.replace(session_control(0), node_latch={"afm_node@slave": "5d0c-1"})
    writer.write(channel, EPOCH_NS, EPOCH_NS, 0, encode(quoting))
    writer.finish()
    rig = stage(writer.path, Selection())
    rig.listen([FAR], "session/control")
    rig.run_ms(60)
    ((topic, payload),) = rig.received(1)
    sent = decode(topic, payload)
    assert isinstance(sent, SessionControl)
    assert (sent.id, sent.node_latch) == (quoting.id, None)


def test_the_recorders_own_words_and_recorded_health_are_not_played(tmp_path: Path, book: AddressBook) -> None:
    writer = RecordingWriter.create(NODE, RecorderConfig(directory=tmp_path))
    played = {"session/event": NODE, "node/health": HAND, "haptic/state": HAND, "session/control": "estop@master"}
    for topic, src in played.items():
        channel = writer.channel(topic, src, "master")
        writer.write(channel, EPOCH_NS, EPOCH_NS, 0, encode(sample(topic, 0, src=src)))
    writer.finish()
    plan = ReplayPlan(Recording(writer.path), book, Selection())
    assert [channel.topic for channel in plan.channels] == ["haptic/state"]


def test_a_node_that_is_not_in_the_site_file_is_named(make_file: MakeFile, tmp_path: Path) -> None:
    small = AddressBook(nodes={HAND: f"ipc://{tmp_path}/hand"})
    with pytest.raises(ConfigError, match=r"delay_node@slave is not in the site file"):
        ReplayPlan(Recording(make_file()), small, Selection())


def test_a_recording_of_two_sites_is_played_on_one_machine_without_the_launcher_of_the_other(tmp_path: Path) -> None:
    rows = {"haptic/state": HAND, "session/event": "launcher@slave"}
    writer = RecordingWriter.create(NODE, RecorderConfig(directory=tmp_path))
    for topic, src in rows.items():
        channel = writer.channel(topic, src, src.partition("@")[2])
        writer.write(channel, EPOCH_NS, EPOCH_NS, 0, encode(sample(topic, 0, src=src)))
    writer.finish()
    book = AddressBook.load(DEFAULT_SITE_FILE)
    plan = ReplayPlan(Recording(writer.path), book, Selection())
    assert plan.nodes == [HAND]
    assert [channel.topic for channel in plan.channels] == ["haptic/state"]
    assert next(iter(remote_control(plan, book))).startswith("launcher@slave is not played: it is not in the site file")
    # one that is asked for by name is refused, and the refusal says what to type
    with pytest.raises(ConfigError, match=r"launcher@slave is not in the site file.*--site-file"):
        ReplayPlan(Recording(writer.path), book, Selection.of(nodes=["launcher"]))


def test_forwarded_copies_belong_to_the_link(make_file: MakeFile, book: AddressBook) -> None:
    plan = ReplayPlan(Recording(make_file()), book, Selection.of(nodes=["delay_node"]))
    assert plan.nodes == [FAR]
    assert {channel.channel_topic for channel in plan.channels} == {"teleop/forward@slave"}
    assert teleop_forward(0).src == "controller@master"


def commands(folder: Path, *nodes: str) -> Recording:
    """Write a recording of a hand and of a command of each console."""
    writer = RecordingWriter.create(NODE, RecorderConfig(directory=folder))
    hand = writer.channel("haptic/state", HAND, "master")
    for seq in range(10):
        writer.write(hand, EPOCH_NS + seq, EPOCH_NS + seq, seq, encode(haptic_state(seq)))
    for node in nodes:
        channel = writer.channel("session/control", node, "master")
        writer.write(channel, EPOCH_NS, EPOCH_NS, 0, encode(sample("session/control", 0, src=node)))
    writer.finish()
    return Recording(writer.path)


def test_a_full_replay_leaves_the_console_to_who_commands_it(tmp_path: Path) -> None:
    recording = commands(tmp_path, "launcher@master", "console@master")
    nodes = (HAND, PLAYER, "console@master", "launcher@master")
    book = AddressBook(nodes={node: f"ipc://{tmp_path}/{node}" for node in nodes})
    plan = ReplayPlan(recording, book, Selection())
    assert plan.nodes == [HAND, "launcher@master"]
    assert plan.left_out == ["console@master"]
    (text,) = remote_control(plan, book)
    assert text.startswith("the commands of console@master are not played, so that it can control the replay")
    # by its name it is played all the same, and then nobody can command the player
    named = ReplayPlan(recording, book, Selection.of(nodes=["console"]))
    assert (named.nodes, named.left_out) == (["console@master"], [])
    assert list(remote_control(named, book)) == ["there is no remote control: console@master is played; the keys work"]
    without = AddressBook(nodes={HAND: f"ipc://{tmp_path}/hand", "launcher@master": f"ipc://{tmp_path}/launcher"})
    (text, _) = remote_control(ReplayPlan(recording, without, Selection()), without)
    assert text == "there is no remote control: the site file has no console; the keys work"


def test_messages_of_another_version_are_named_before_they_are_played(tmp_path: Path) -> None:
    writer = RecordingWriter.create(NODE, RecorderConfig(directory=tmp_path))
    hand = writer.channel("haptic/state", HAND, "master")
    for seq in range(3):
        newer = msgspec.structs.replace(haptic_state(seq), v=2)
        writer.write(hand, EPOCH_NS + seq, EPOCH_NS + seq, seq, encode(newer))
    writer.finish()
    recording = Recording(writer.path)
    (text,) = refused_messages(recording, Playback(recording, lambda channel: True, Span()))
    assert text.startswith(
        "every reader of this version refuses the played messages of haptic/state: haptic/state, seq 0:"
    )
    assert "schema version 2" in text


def test_what_a_played_node_lacks_is_named(tmp_path: Path, book: AddressBook) -> None:
    assert list(absent_topics(ReplayPlan(commands(tmp_path / "hand"), book, Selection()), book)) == []
    writer = RecordingWriter.create(NODE, RecorderConfig(directory=tmp_path / "law"))
    channel = writer.channel("afm/command", "controller@slave", "slave")
    writer.write(channel, EPOCH_NS, EPOCH_NS, 0, encode(sample("afm/command", 0, src="controller@slave")))
    writer.finish()
    recording = Recording(writer.path)
    (text,) = absent_topics(ReplayPlan(recording, book, Selection()), book)
    assert text == "controller@slave is played without teleop/backward, law/status, which is not in the recording"
    # what was not chosen is not missed
    chosen = ReplayPlan(recording, book, Selection.of(["afm/command"]))
    assert list(absent_topics(chosen, book)) == []


def test_a_replay_of_nothing_is_refused(tmp_path: Path) -> None:
    site_file = tmp_path / "site.yaml"
    site_file.write_text(yaml.safe_dump({"nodes": {node: f"ipc://{tmp_path}/{node}" for node in (HAND, PLAYER)}}))
    writer = RecordingWriter.create(NODE, RecorderConfig(directory=tmp_path))
    writer.channel("haptic/state", HAND, "master")
    event = writer.channel("session/event", NODE, "master")
    writer.write(event, EPOCH_NS, EPOCH_NS, 0, encode(sample("session/event", 0, src=NODE)))
    writer.finish()
    with pytest.raises(RecordingError, match=rf"has no message of {HAND} in the selection: nothing can be played"):
        run_replay(ReplayRequest([writer.path], site_file, nodes=["haptic_node"]))


def test_a_replay_that_nobody_reads_says_so_and_fails(tmp_path: Path) -> None:
    site_file = tmp_path / "site.yaml"
    site_file.write_text(yaml.safe_dump({"nodes": {node: f"ipc://{tmp_path}/{node}" for node in (HAND, PLAYER)}}))
    writer = RecordingWriter.create(NODE, RecorderConfig(directory=tmp_path))
    hand = writer.channel("haptic/state", HAND, "master")
    for number in range(200):
        at_ns = EPOCH_NS + number * 1_000_000
        writer.write(hand, at_ns, at_ns, number, encode(sample("haptic/state", number, src=HAND)))
    writer.finish()
    warned: list[str] = []
    request = ReplayRequest([writer.path], site_file, nodes=["haptic_node"], settings=PlaySettings(wait_s=0.0))
    with pytest.raises(RigError, match=r"200 messages of haptic_node@master were played, and no node read them"):
        run_replay(request, warn=warned.append)
    (text,) = [
        text for text in warned if text.startswith("no node reads the played messages: start the rest of the rig")
    ]
    assert "--without NODE --allow-replay" in text


def test_warnings_are_published_at_the_start(stage: Callable[..., Stage], make_file: MakeFile) -> None:
    rig = stage(make_file(), wait_s=0.0)
    rig.player._warnings = ["something is not played"]
    rig.run_ms(100)
    assert [(event.level, event.text) for event in rig.events if event.data["state"] == "warning"] == [
        ("warning", "something is not played")
    ]
