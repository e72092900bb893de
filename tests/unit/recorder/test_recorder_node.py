import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest
import yaml
import zmq
from recorder_samples import EPOCH_NS, NODE, haptic_state, session_control, teleop_forward

from services.recorder.__main__ import begin, listeners
from services.recorder.intake import Intake
from services.recorder.node import RecorderBus, RecorderNode
from telenano.recording.reader import Recording
from telenano.recording.recorder_config import RecorderConfig
from telenano.recording.writer import RecordingWriter
from telenano.runtime.bus.address_book import AddressBook
from telenano.runtime.bus.bus import ConnectionEvent
from telenano.runtime.bus.publisher import ZmqPublisher
from telenano.runtime.loop.log import StructuredLog
from telenano.runtime.loop.node import NodeContext
from telenano.runtime.loop.node_loop import NodeLoop
from telenano.runtime.loop.realtime import RealtimeStatus
from telenano.runtime.wiring.main import Wiring
from telenano.runtime.wiring.transport import Transport
from telenano.testing import VirtualClock
from telenano.timing.clock import SystemClock
from telenano.wire import Message, compose, encode
from telenano.wire.messages import InputHealth, SessionEvent
from telenano.wire.received import Received
from telenano.wire.sequence import Arrival
from telenano.wire.topics import OWN_TOPICS as TOPICS

PATIENCE_S = 30.0


class QuietBus:
    """A bus on which only the node publishes, and which delivers the commands of the test."""

    def __init__(self, clock: VirtualClock) -> None:
        self.clock = clock
        self.published: list[tuple[str, Message]] = []
        self.waiting: list[Received] = []

    def publish(self, topic: str, **fields: Any) -> Message:
        model = TOPICS[topic].model
        header = {"seq": len(self.published), "t_ns": self.clock.now_ns(), "src": NODE, "v": model.version}
        message, _ = compose(topic, {**header, **fields})
        self.published.append((topic, message))
        return message

    def receive(self) -> Iterator[Received]:
        yield from self.waiting
        self.waiting.clear()

    def wait(self, deadline_ns: int) -> None:
        self.clock.advance_ns(max(0, deadline_ns - self.clock.monotonic_ns()))

    def input_health(self) -> tuple[InputHealth, ...]:
        return ()

    def sequence_numbers(self) -> dict[str, int]:
        return {}

    def rejections(self) -> tuple[dict[str, int], str]:
        return {}, ""

    def process_events(self, *, now: bool = False) -> Sequence[ConnectionEvent]:
        return ()

    def has_arrived(self) -> bool:
        return False

    def close(self) -> None:
        pass

    def events(self) -> list[SessionEvent]:
        return [message for _, message in self.published if isinstance(message, SessionEvent)]


class Rig:
    """A recorder in virtual time."""

    def __init__(self, intake: Intake, config: RecorderConfig) -> None:
        self.clock = VirtualClock(0, EPOCH_NS)
        self.bus = QuietBus(self.clock)
        self.intake = intake
        self.node = RecorderNode(NodeContext(NODE, self.clock, self.bus, StructuredLog(NODE)), config, intake)
        self.loop = NodeLoop(self.node, self.bus, RealtimeStatus(fifo=False, memory_locked=False))

    def command(self, control: Message) -> None:
        payload = encode(control)
        self.bus.waiting.append(Received("session/control", control, payload, self.clock.now_ns(), Arrival.NEXT))


@pytest.fixture
def rig(config: RecorderConfig) -> Iterator[Rig]:
    rig = Rig(Intake(RecordingWriter.create(NODE, config)), config)
    yield rig
    rig.intake.finish()


def test_flushes_come_at_the_interval_of_the_configuration(rig: Rig) -> None:
    flushed_at: list[int] = []
    rig.intake.flush = lambda now_ns: flushed_at.append(rig.clock.monotonic_ns())
    while rig.clock.monotonic_ns() < 1_000_000_000:
        rig.loop.turn()
    assert flushed_at == [200_000_000, 400_000_000, 600_000_000, 800_000_000, 1_000_000_000]


def test_the_start_is_reported_once_after_the_first_flush(rig: Rig, tmp_path: Path) -> None:
    assert rig.bus.events() == []
    for _ in range(4):
        rig.loop.turn()
    (event,) = rig.bus.events()
    assert (event.kind, event.level, event.data["state"]) == ("recording", "info", "started")
    assert event.data["path"] == str(tmp_path / "session.mcap")
    assert rig.node.state == "running"


def test_the_end_completes_the_file_and_says_what_is_in_it(rig: Rig) -> None:
    rig.node.context.request_stop()
    rig.loop.run()
    started, finished, ended = rig.bus.events()
    assert started.data["state"] == "started"
    assert finished.data["state"] == "finished"
    assert finished.data["messages"] == 0
    info = Recording(str(finished.data["path"])).info()
    assert info.complete
    assert info.size_bytes == finished.data["size_bytes"]
    # the last message of all counts those before it
    assert [topic for topic, _ in rig.bus.published[-2:]] == ["node/health", "session/event"]
    assert ended.data["state"] == "ended"


def test_a_folder_that_cannot_be_written_is_an_event_and_the_node_goes_on(config: RecorderConfig) -> None:
    rig = Rig(Intake(None, "/x: cannot be created: Permission denied"), config)
    for _ in range(6):
        rig.loop.turn()
    (event,) = rig.bus.events()
    assert (event.kind, event.level, event.data["state"]) == ("recording", "error", "failed")
    assert "the rig continues: /x: cannot be created: Permission denied" in event.text
    assert rig.node.state == "safe"
    rig.command(session_control(0, id="m1"))
    rig.loop.turn()
    answer = rig.bus.events()[-1]
    assert (answer.id, answer.kind) == ("m1", "refused")
    assert "Permission denied" in answer.text
    rig.node.context.request_stop()
    rig.loop.run()
    assert [event.kind for event in rig.bus.events()] == ["recording", "refused", "node"]


def test_a_disk_that_fails_later_is_one_event(rig: Rig) -> None:
    rig.loop.turn()
    assert rig.intake.writer is not None
    rig.intake.writer._stream.close()
    rig.intake.fault = "session.mcap: cannot be written: No space left on device"
    rig.intake.writer = None
    for _ in range(5):
        rig.loop.turn()
    assert [event.data["state"] for event in rig.bus.events()] == ["started", "failed"]


def test_a_recording_that_has_stopped_is_reported_again_for_who_listens_later(config: RecorderConfig) -> None:
    rig = Rig(Intake(None, "x.mcap: cannot be written: No space left on device"), config)
    while rig.clock.monotonic_ns() < 3_100_000_000:
        rig.loop.turn()
    events = rig.bus.events()
    assert [(event.t_ns - EPOCH_NS) // 100_000_000 for event in events] == [2, 12, 22, 32]
    assert {(event.kind, event.level, event.data["state"]) for event in events} == {("recording", "error", "failed")}


class Backlog:
    """What waits in the sockets of a recorder: a thousand messages every tenth of a second, for a time."""

    def __init__(self, rig: Rig, length_s: float) -> None:
        self._rig = rig
        self._left = round(length_s * 10)
        rig.bus.receive = self._receive

    def _receive(self) -> Iterator[Received]:
        if self._left > 0:
            self._left -= 1
            self._rig.intake.received += 1000
            self._rig.clock.advance_ns(100_000_000)
        return iter(())


def test_a_recorder_that_is_behind_writes_what_waits_and_reports_how_far_it_is(rig: Rig) -> None:
    Backlog(rig, 3.05)
    rig.node.make_safe()
    told = [event for event in rig.bus.events() if event.data["state"] == "draining"]
    assert [event.data["written"] for event in told] == [10_000, 20_000, 30_000]
    assert told[0].text == "writing what still waits: 10000 messages in 1 s, at most 20 s"
    finished = rig.bus.events()[-1]
    assert Recording(str(finished.data["path"])).info().complete


def test_a_recorder_that_gives_up_notes_in_the_file_what_is_missing(rig: Rig) -> None:
    Backlog(rig, 60.0)
    rig.node.make_safe()
    (fault,) = [event for event in rig.bus.events() if event.kind == "fault"]
    info = Recording(str(rig.bus.events()[-1].data["path"])).info()
    assert fault.level == "error"
    assert info.missing == (fault.text,)
    assert (info.complete, info.closed, info.lost) == (False, True, 0)


def test_a_mark_is_acknowledged_and_its_parameters_are_published(rig: Rig) -> None:
    # keys that are also names of arguments within the node must do no harm
    rig.command(session_control(0, id="m1", parameters={"note": "snap-in", "kind": "x", "text": "y", "answer_to": "z"}))
    rig.loop.turn()
    mark, answer = rig.bus.events()[:2]
    assert (mark.kind, mark.data["note"], mark.data["answer_to"]) == ("mark", "snap-in", "z")
    assert (answer.kind, answer.id) == ("ack", "m1")
    assert "session.mcap" in answer.text


def test_a_command_for_others_is_left_to_them_and_another_one_is_refused(rig: Rig) -> None:
    rig.command(session_control(0, command="start", target="*"))
    rig.command(session_control(1, command="start", target="recorder", id="s1"))
    rig.loop.turn()
    (answer,) = [event for event in rig.bus.events() if event.kind != "recording"]
    assert (answer.kind, answer.id) == ("refused", "s1")


def test_lost_commands_and_events_are_a_fault(rig: Rig) -> None:
    rig.intake.lossless_lost = 3
    for _ in range(4):
        rig.loop.turn()
    (fault,) = [event for event in rig.bus.events() if event.kind == "fault"]
    assert fault.data["missing"] == 3


def test_health_counts_the_messages_received(rig: Rig) -> None:
    rig.loop.turn()
    rig.intake.received = 1000
    for _ in range(3):
        rig.loop.turn()
    rates = [message.rate_hz for topic, message in rig.bus.published if topic == "node/health"]
    # the first one is sent at the start
    assert rates == [0.0, pytest.approx(2000.0, rel=1e-9, abs=0)]


NODES = (
    "haptic_node@master",
    "controller@master",
    "delay_node@slave",
    "delay_node@master",
    "launcher@master",
    "recorder@master",
)


@pytest.fixture
def site_file(tmp_path: Path) -> Path:
    path = tmp_path / "site.yaml"
    path.write_text(yaml.safe_dump({"nodes": {node: f"ipc://{tmp_path}/{node}" for node in NODES}}))
    return path


@pytest.fixture
def scenario_file(tmp_path: Path) -> Path:
    path = tmp_path / "scenario.yaml"
    path.write_text(
        yaml.safe_dump(
            {
                "name": "test",
                "description": "A recorder alone",
                "duration_s": 1.0,
                "recorder": {"directory": str(tmp_path / "out"), "flush_interval_s": 0.1},
            }
        )
    )
    return path


class Stage:
    """Every other node of the rig, as far as the recorder can see."""

    def __init__(self, context: zmq.Context, site_file: Path, nodes: Sequence[str]) -> None:
        book = AddressBook.model_validate(yaml.safe_load(site_file.read_text()))
        self.publishers = {node: ZmqPublisher(context, SystemClock(), node, book.endpoint(node)) for node in nodes}
        self.sent = 0

    def publish_all(self) -> None:
        """One message of each kind: at its publisher, and behind the link."""
        forward = encode(teleop_forward(self.sent))
        self.publishers["haptic_node@master"].send("haptic/state", encode(haptic_state(self.sent)))
        self.publishers["controller@master"].send("teleop/forward", forward)
        self.publishers["delay_node@slave"].send("teleop/forward", forward)
        self.sent += 1

    def close(self) -> None:
        for publisher in self.publishers.values():
            publisher.close()


@pytest.fixture
def stage(site_file: Path) -> Iterator[Callable[..., Stage]]:
    made: list[Stage] = []
    with zmq.Context() as context:

        def make(nodes: Sequence[str]) -> Stage:
            made.append(Stage(context, site_file, nodes))
            return made[-1]

        yield make
        for each in made:
            each.close()


Asked = Callable[[str, str], set[tuple[str, str]]]


@pytest.fixture
def asked_by(scenario_file: Path, config: RecorderConfig, monkeypatch: pytest.MonkeyPatch) -> Iterator[Asked]:
    """Return of which node the recorder of a site of two machines asks for which topic."""
    site_file = Path(__file__).resolve().parents[3] / "telenano" / "settings" / "sites" / "two_sites.yaml"
    book = AddressBook.model_validate({**yaml.safe_load(site_file.read_text()), "insecure": True})
    clock, context = SystemClock(), zmq.Context()

    def asked_by(site: str, far: str) -> set[tuple[str, str]]:
        wiring = Wiring(
            key=f"recorder@{site}",
            book=book,
            site_file=site_file,
            scenario_file=scenario_file,
            clock=clock,
            log=StructuredLog(NODE),
            network=Transport(context, clock, book, site),
            wake_descriptor=-1,
        )
        found = listeners(wiring, config.model_copy(update={"far": far}))
        asked = {(each.publisher, topic) for each in found for topic in each.subscriber.topics}
        wiring.resources.close()
        wiring.network.close()
        return asked

    # a socket's path is short by law, pytest's folders are not
    with tempfile.TemporaryDirectory(prefix="tnr-") as folder:
        monkeypatch.setenv("TELENANO_RUNTIME_DIR", folder)
        yield asked_by
    # Also those that a failure has left open, for which the end of a context would wait.
    context.destroy(linger=0)


@pytest.mark.parametrize("far", ["fetch", "stream"])
def test_what_the_link_brings_to_the_master_does_not_cross_a_second_time(asked_by: Asked, far: str) -> None:
    asked = asked_by("master", far)
    assert {("delay_node@master", "node/health"), ("afm_node@slave", "session/event")} <= asked
    assert {("delay_node@master", "link/network"), ("delay_node@slave", "link/delay")} <= asked
    directly = {
        ("afm_node@slave", "node/health"),
        ("controller@slave", "link/network"),
        ("afm_node@slave", "afm/state"),
        ("afm_node@slave", "clock/pong"),
    }
    assert asked & directly == (directly if far == "stream" else set())


@pytest.mark.parametrize("far", ["fetch", "stream"])
def test_the_far_recorder_leaves_what_the_link_says_of_itself_to_the_master(asked_by: Asked, far: str) -> None:
    asked = asked_by("slave", far)
    assert {("delay_node@slave", "session/control"), ("afm_node@slave", "clock/pong")} <= asked
    own = {("delay_node@slave", "link/delay"), ("delay_node@slave", "clock/ping")}
    assert asked & own == (own if far == "stream" else set())


def test_everything_on_real_sockets_is_received_at_its_place(
    site_file: Path, scenario_file: Path, config: RecorderConfig, stage: Callable[..., Stage]
) -> None:
    clock = SystemClock()
    book = AddressBook.model_validate(yaml.safe_load(site_file.read_text()))
    reader, writer = os.pipe()
    with zmq.Context() as context:
        wiring = Wiring(
            key=NODE,
            book=book,
            site_file=site_file,
            scenario_file=scenario_file,
            clock=clock,
            log=StructuredLog(NODE),
            network=Transport(context, clock, book, "master"),
            wake_descriptor=reader,
        )
        intake = begin(wiring, config)
        bus = RecorderBus(wiring.bind(NODE), listeners(wiring, config), intake, clock, reader, wiring.network)
        node = RecorderNode(wiring.context(bus), config, intake)
        loop = NodeLoop(node, bus, RealtimeStatus(fifo=False, memory_locked=False))
        others = stage([key for key in NODES if key != NODE])
        end = time.monotonic() + PATIENCE_S
        few = listeners(wiring, config.model_copy(update={"topics": ("haptic/state",)}))
        asked = {(each.publisher, topic) for each in few for topic in each.subscriber.topics}
        assert ("haptic_node@master", "haptic/state") in asked
        assert {topic for _, topic in asked} == {"haptic/state", "session/control", "session/event"}
        for each in few:
            each.subscriber.close()
        wanted = {"haptic/state", "teleop/forward", "teleop/forward@slave", "node/health", "session/event"}
        found: set[str] = set()
        while not wanted <= found and time.monotonic() < end:
            others.publish_all()
            others.publishers["launcher@master"].send("session/control", encode(session_control(others.sent)))
            loop.turn()
            found = {stream.channel_topic for each in bus._listeners.values() for stream in each.streams.values()}
        rows = {(row.topic, row.src) for row in bus.input_health()}
        bus.is_brief = True
        brief = {(row.topic, row.src) for row in bus.input_health()}
        node.context.request_stop()
        loop.run()
        wiring.resources.close()
        wiring.network.close()
    os.close(reader)
    os.close(writer)
    # What crosses to another machine leaves out what is sent on change, and keeps what readiness is judged by.
    assert brief == {row for row in rows if TOPICS[row[0]].rate_hz}
    assert len(brief) < len(rows)
    recording = Recording(config.directory / config.file_name)
    info = recording.info()
    assert info.complete
    assert wanted <= {channel.channel_topic for channel in info.channels}
    assert {(c.channel_topic, c.src) for c in info.channels} >= {("node/health", NODE), ("session/event", NODE)}
    assert recording.attachments == {
        "site.yaml": site_file.read_bytes(),
        "scenario.yaml": scenario_file.read_bytes(),
    }
    assert recording.metadata["recording"]["node"] == NODE
    assert recording.metadata["versions"]["schema haptic/state"] == "1"
    assert recording.metadata["versions"]["package mcap"]
    for message in recording.messages(["teleop/forward@slave"]):
        assert message.payload == encode(teleop_forward(message.seq))
        assert message.decode() == teleop_forward(message.seq)


def started(site_file: Path, scenario_file: Path) -> "subprocess.Popen[bytes]":
    arguments = ["--site-file", str(site_file), "--scenario", str(scenario_file)]
    return subprocess.Popen([sys.executable, "-m", "services.recorder", *arguments], stderr=subprocess.PIPE)


def publish_until(others: Stage, path: Path, size_bytes: int) -> None:
    """Publish at about 3 kHz until the recording has a size."""
    end = time.monotonic() + PATIENCE_S
    next_s = time.monotonic()
    while not path.exists() or path.stat().st_size < size_bytes:
        assert time.monotonic() < end, f"{path} did not reach {size_bytes} bytes"
        others.publish_all()
        next_s += 1e-3
        while time.monotonic() < next_s:
            pass


def newest_state(path: Path) -> int:
    """Return the newest number of haptic/state in a file that is being written."""
    return [message.seq for message in Recording(path).messages(["haptic/state"])][-1]


@pytest.mark.check("takes 1.9 s")
def test_a_process_that_is_stopped_completes_its_file(
    site_file: Path, scenario_file: Path, tmp_path: Path, stage: Callable[..., Stage]
) -> None:
    others = stage([key for key in NODES if key != NODE])
    path = tmp_path / "out" / "session.mcap"
    with started(site_file, scenario_file) as process:
        publish_until(others, path, 20_000)
        process.send_signal(signal.SIGTERM)
        _, errors = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0, errors
    info = Recording(path).info()
    assert info.complete
    assert {channel.lost for channel in info.channels} == {0}


@pytest.mark.check("takes 3.8 s")
def test_a_killed_process_loses_no_more_than_an_interval(
    site_file: Path, scenario_file: Path, tmp_path: Path, stage: Callable[..., Stage]
) -> None:
    others = stage([key for key in NODES if key != NODE])
    random_source = random.Random(9)
    for name in ("session.mcap", "session_1.mcap", "session_2.mcap"):
        path = tmp_path / "out" / name
        with started(site_file, scenario_file) as process:
            publish_until(others, path, random_source.randrange(20_000, 60_000))
            flushed = reflushed = newest_state(path)
            # What follows comes with the next flush alone; the one before may still have been writing its index.
            while reflushed == flushed:
                publish_until(others, path, path.stat().st_size + 1)
                reflushed = newest_state(path)
            process.kill()
        recording = Recording(path)
        states = list(recording.messages(["haptic/state"]))
        assert not recording.closed
        assert [m.seq for m in states] == list(range(states[0].seq, states[-1].seq + 1))
        # how often it is flushed is tested in virtual time: what was lost is only what came since
        assert states[-1].seq >= reflushed


def test_a_process_that_may_not_write_runs_and_says_so(site_file: Path, scenario_file: Path, tmp_path: Path) -> None:
    (tmp_path / "out").write_text("in the way")
    with started(site_file, scenario_file) as process:
        assert process.stderr is not None
        line = b""
        while b"the rig continues" not in line:
            line = process.stderr.readline()
            assert line, "the recorder ended"
        assert b"out: is not a folder" in line
        process.terminate()
        process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0
