"""The bus on real sockets: whatever arrives is taken or counted, and the subscriber lives on."""

import fcntl
import os
import queue
import signal
import socket as plain_socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO

import msgpack
import pytest
import zmq

from telenano.runtime.bus.bus import QUEUE_S, RECEIVE_HIGH_WATER_MARK, Subscriber, ZmqBus, split_frames
from telenano.runtime.bus.publisher import SEND_HIGH_WATER_MARK, NullPublisher, ZmqPublisher
from telenano.testing import VirtualClock
from telenano.testing.filled_messages import examples
from telenano.timing.clock import SystemClock
from telenano.wire import decode, encode
from telenano.wire.codec import MAX_MESSAGE_BYTES, WireError
from telenano.wire.errors import EndpointError
from telenano.wire.messages import AfmState, HapticState, SessionControl
from telenano.wire.nodes import NODES, name_of
from telenano.wire.received import Received
from telenano.wire.sequence import Arrival
from telenano.wire.topics import OWN_TOPICS as TOPICS

Context = zmq.Context[zmq.Socket[bytes]]
MOST_TRACKERS = 1024
BATCH = 256
MOST_FRAMES = 1000
NEWEST_MARK = 256
ENCODED = {topic: encode(examples(row)["ordinary"]) for topic, row in TOPICS.items()}
WAIT_S = 20.0


@pytest.fixture
def context() -> Iterator[Context]:
    with zmq.Context[zmq.Socket[bytes]]() as context:
        yield context
        # a test that failed half-way must not hang here
        context.destroy(linger=0)


@pytest.fixture
def endpoint(tmp_path: Path) -> str:
    return f"ipc://{tmp_path}/bus"


class Sender:
    """A bare socket that sends what no node would send."""

    def __init__(self, context: Context, endpoint: str) -> None:
        self.socket = context.socket(zmq.XPUB)
        self.socket.set(zmq.SNDHWM, 100_000)
        self.socket.set(zmq.LINGER, 0)
        self.socket.bind(endpoint)

    def connected(self, subscriptions: int = 1) -> None:
        """Wait for the subscriptions of a reader."""
        for _ in range(subscriptions):
            assert self.socket.poll(WAIT_S * 1e3), "nobody subscribed"
            self.socket.recv()

    def send(self, *frames: bytes) -> None:
        self.socket.send_multipart(frames)


def until(condition: Callable[[], bool], reader: Subscriber) -> list[Received]:
    """Receive until a condition holds."""
    received: list[Received] = []
    deadline = time.monotonic() + WAIT_S
    while not condition():
        assert time.monotonic() < deadline, f"still waiting, refused so far {reader.rejected}"
        reader.socket.poll(100)
        received += reader.receive()
    return received


def collect(reader: Subscriber, count: int) -> list[Received]:
    """Receive until so many messages came."""
    received: list[Received] = []
    deadline = time.monotonic() + WAIT_S
    while len(received) < count:
        assert time.monotonic() < deadline, f"{len(received)} of {count} came, refused {reader.rejected}"
        reader.socket.poll(100)
        received += reader.receive()
    return received


def fields(topic: str, **changed: object) -> dict[str, object]:
    present: dict[str, object] = msgpack.unpackb(ENCODED[topic], use_list=False)
    return {**present, **changed}


def payload(topic: str, **changed: object) -> bytes:
    raw: bytes = msgpack.packb({**msgpack.unpackb(ENCODED[topic]), **changed})
    return raw


def published(topic: str) -> dict[str, object]:
    return {key: value for key, value in fields(topic).items() if key not in ("seq", "t_ns", "src", "v")}


@pytest.fixture
def sender(context: Context, endpoint: str) -> Iterator[Sender]:
    sender = Sender(context, endpoint)
    yield sender
    sender.socket.close()


@pytest.fixture
def reader(context: Context, sender: Sender, endpoint: str) -> Iterator[Subscriber]:
    reader = Subscriber(context, SystemClock(), {endpoint: ["haptic/state", "session/control"]})
    sender.connected(2)
    yield reader
    reader.close()


@pytest.fixture
def unconnected(context: Context) -> Iterator[Subscriber]:
    """Give a subscriber without connection: its messages are handed to it."""
    reader = Subscriber(context, VirtualClock(epoch_offset_ns=10**9), {})
    yield reader
    reader.close()


def hand(reader: Subscriber, seq: int, t_ns: int, topic: str = "haptic/state", src: str = "a@b") -> Received | None:
    return reader.decode_and_track([topic.encode(), payload(topic, seq=seq, t_ns=t_ns, src=src)], 0)


# --- publishing ---


def test_a_message_is_numbered_stamped_and_arrives_as_it_was_sent(context: Context, endpoint: str) -> None:
    clock = VirtualClock(start_ns=7, epoch_offset_ns=10**18)
    publisher = ZmqPublisher(context, clock, "haptic_node@master", endpoint, kind=zmq.XPUB)
    reader = Subscriber(context, clock, {endpoint: ["haptic/state", "node/health"]})
    try:
        for _ in range(2):
            assert publisher.socket.poll(WAIT_S * 1e3)
            publisher.socket.recv()
        sent = [publisher.publish(topic, **published(topic)) for topic in ("haptic/state", "node/health") * 2]
        received = collect(reader, 4)
    finally:
        reader.close()
        publisher.close()
    assert [r.message for r in received] == sent
    assert [(m.seq, m.t_ns, m.src, m.v) for m in sent] == [
        (seq, 10**18 + 7, "haptic_node@master", 1) for seq in (0, 0, 1, 1)
    ]
    assert [r.topic for r in received] == ["haptic/state", "node/health"] * 2
    assert {(r.arrival, r.received_ns) for r in received} == {(Arrival.NEXT, 10**18 + 7)}
    assert [decode(r.topic, r.payload) for r in received] == sent


def test_a_message_that_is_refused_takes_no_number(context: Context, endpoint: str) -> None:
    publisher = ZmqPublisher(context, VirtualClock(), "haptic_node@master", endpoint)
    try:
        with pytest.raises(ValueError, match="session_s"):
            publisher.publish("haptic/state", **{**published("haptic/state"), "session_s": float("nan")})
        with pytest.raises(ValueError, match="at most 1048576"):
            publisher.publish("session/event", **{**published("session/event"), "data": {"x": "x" * 2**20}})
        assert publisher.publish("haptic/state", **published("haptic/state")).seq == 0
        assert publisher.publish("session/event", **published("session/event")).seq == 0
    finally:
        publisher.close()


def test_a_publisher_that_yields_gives_the_processor_away_behind_each_message(
    context: Context, endpoint: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    publisher = ZmqPublisher(context, VirtualClock(), "delay_node@slave", endpoint)
    sent: list[bytes] = []
    monkeypatch.setattr(publisher, "send_frame", lambda frame, flags=0: sent.append(frame))
    monkeypatch.setattr(os, "sched_yield", lambda: sent.append(b"yield"))
    publisher.send("teleop/forward", b"1")
    assert sent == [b"teleop/forward", b"1"]
    publisher.yields = True
    publisher.send("teleop/forward", b"2")
    assert sent[2:] == [b"teleop/forward", b"2", b"yield"]
    publisher.close()


def test_what_a_node_computes_beyond_a_range_is_sent_as_its_end_and_told(context: Context, endpoint: str) -> None:
    publisher = ZmqPublisher(context, VirtualClock(), "afm_node@slave", endpoint)
    told: list[str] = []
    publisher.on_limited = told.append
    try:
        message = publisher.publish("afm/state", **{**published("afm/state"), "deflection_m": float("inf")})
        publisher.publish("afm/state", **published("afm/state"))
    finally:
        publisher.close()
    assert isinstance(message, AfmState)
    assert message.deflection_m == 10.0
    assert told == ["AfmState: deflection_m = inf is out of range and is sent at the end of the range"]


# --- what is refused ---

GOOD = payload("haptic/state", seq=1)
REFUSED = {
    "frames-1": ("frames", (b"haptic/state",)),
    "frames-3": ("frames", (b"haptic/state", GOOD, b"")),
    "frames-many": ("frames", (b"haptic/state", *[b"x"] * 500)),
    "topic-unknown": ("topic", (b"haptic/stateful", GOOD)),
    "topic-not-utf8": ("topic", (b"haptic/state\xff", GOOD)),
    "malformed-empty": ("malformed", (b"haptic/state", b"")),
    "malformed-cut": ("malformed", (b"haptic/state", GOOD[:-1])),
    "malformed-list": ("malformed", (b"haptic/state", b"\x90")),
    "oversized": ("oversized", (b"haptic/state", bytes(MAX_MESSAGE_BYTES + 1))),
    "oversized-10-MiB": ("oversized", (b"haptic/state", bytes(10 * MAX_MESSAGE_BYTES))),
    "newer": ("newer_version", (b"haptic/state", msgpack.packb({**msgpack.unpackb(GOOD), "v": 5}))),
    "schema": ("schema", (b"haptic/state", msgpack.packb({**msgpack.unpackb(GOOD), "session_s": "1"}))),
    "other-topic": ("schema", (b"session/control", GOOD)),
    "range": ("range", (b"haptic/state", payload("haptic/state", operator_force_n=(0.0, 0.0, 1e308)))),
}


@pytest.mark.parametrize(("reason", "frames"), REFUSED.values(), ids=REFUSED)
def test_what_is_refused_is_counted_and_the_next_message_is_taken(
    sender: Sender, reader: Subscriber, reason: str, frames: tuple[bytes, ...]
) -> None:
    sender.send(*frames)
    sender.send(b"haptic/state", GOOD)
    received = collect(reader, 1)
    assert [r.message.seq for r in received] == [1]
    assert reader.rejected == {reason: 1}
    assert 0 < len(reader.last_error) < 1000


def test_a_frame_beyond_all_measure_costs_its_sender_the_connection_and_nobody_else(
    context: Context, sender: Sender, endpoint: str, tmp_path: Path
) -> None:
    other_endpoint = f"ipc://{tmp_path}/other"
    other = Sender(context, other_endpoint)
    reader = Subscriber(context, SystemClock(), {endpoint: ["haptic/state"], other_endpoint: ["haptic/state"]})
    try:
        sender.connected()
        other.connected()
        sender.send(b"haptic/state", bytes(17 * MAX_MESSAGE_BYTES))
        # the end of the subscription is how the sender sees that it was cut off
        sender.connected()
        other.send(b"haptic/state", payload("haptic/state", seq=1))
        assert [r.message.seq for r in collect(reader, 1)] == [1]
        assert reader.rejected == {}
    finally:
        other.socket.close()
        reader.close()


def test_frames_are_split_or_say_why_not() -> None:
    assert split_frames([b"haptic/state", b"x"]) == ("haptic/state", b"x")
    with pytest.raises(ValueError, match=r"has 2 frames .* this one has 0"):
        split_frames([])
    with pytest.raises(ValueError, match="is not UTF-8"):
        split_frames([b"\xff" * 100, b""])


# --- what is accounted for ---


def test_a_latest_topic_drops_what_was_overtaken_and_a_lossless_one_does_not(unconnected: Subscriber) -> None:
    for topic, late_is_taken in (("haptic/state", False), ("session/event", True), ("session/control", True)):
        arrivals = [hand(unconnected, seq, t_ns=seq, topic=topic) for seq in (0, 1, 4, 2, 2, 4, 5)]
        assert [r.arrival if r else None for r in arrivals] == [
            Arrival.NEXT,
            Arrival.NEXT,
            Arrival.AFTER_GAP,
            Arrival.LATE if late_is_taken else None,
            # a command is known by its id: its number may be that of another console, whose clock is ahead
            Arrival.DUPLICATE if topic == "session/control" else None,
            Arrival.DUPLICATE if topic == "session/control" else None,
            Arrival.NEXT,
        ]
        tracker = unconnected.trackers[topic, "a@b"]
        assert (tracker.received, tracker.lost, tracker.gaps, tracker.late, tracker.duplicates) == (5, 1, 1, 1, 2)


Waiting = list[tuple[list[bytes], int]]


def waiting(*messages: tuple[str, int, int, str], at_ns: int = 0) -> Waiting:
    """Give frames of (topic, seq, t_ns, src) as they are taken from a socket together."""
    return [
        ([topic.encode(), payload(topic, seq=seq, t_ns=t_ns, src=src)], at_ns + place)
        for place, (topic, seq, t_ns, src) in enumerate(messages)
    ]


@pytest.fixture
def newest(context: Context) -> Iterator[Subscriber]:
    """Give a subscriber of a node of the loop, without connection, which has heard one message of a hand."""
    topics = ["haptic/state", "node/health", "session/control"]
    reader = Subscriber(context, VirtualClock(), {"": topics}, connect=False, newest_only=True)
    assert len(reader.take(waiting(("haptic/state", 0, 0, "a@b")))) == 1
    yield reader
    reader.close()


def test_of_what_waits_together_the_newest_is_taken_and_the_rest_counted(newest: Subscriber) -> None:
    received = newest.take(waiting(*(("haptic/state", seq, seq, "a@b") for seq in range(1, 200))))
    assert [(r.message.seq, r.received_ns, r.arrival) for r in received] == [(199, 198, Arrival.NEXT)]
    tracker = newest.trackers["haptic/state", "a@b"]
    assert (tracker.received, tracker.superseded, tracker.lost, tracker.gaps) == (200, 198, 0, 0)
    (health, *_) = newest.input_health()
    assert (health.received, health.lost, health.repeated) == (200, 0, 0)
    assert newest.rejected == {}


def test_one_at_a_time_nothing_is_superseded(newest: Subscriber) -> None:
    for seq in range(1, 50):
        assert [r.message.seq for r in newest.take(waiting(("haptic/state", seq, seq, "a@b")))] == [seq]
    assert newest.trackers["haptic/state", "a@b"].superseded == 0


def test_commands_and_other_sources_are_not_superseded_and_commands_come_first(newest: Subscriber) -> None:
    assert newest.take(waiting(("haptic/state", 0, 0, "c@b")))
    mixed = waiting(
        ("haptic/state", 1, 1, "a@b"),
        ("session/control", 0, 0, "console@b"),
        ("haptic/state", 1, 1, "c@b"),
        ("session/control", 1, 1, "console@b"),
        ("haptic/state", 2, 2, "a@b"),
        ("session/control", 2, 2, "console@b"),
    )
    taken = [(r.topic, r.message.src, r.message.seq) for r in newest.take(mixed)]
    assert taken == [
        ("session/control", "console@b", 0),
        ("session/control", "console@b", 1),
        ("session/control", "console@b", 2),
        ("haptic/state", "c@b", 1),
        ("haptic/state", "a@b", 2),
    ]


def test_a_loss_in_what_is_superseded_stays_a_loss(newest: Subscriber) -> None:
    received = newest.take(waiting(*(("haptic/state", seq, seq, "a@b") for seq in (1, 2, 5, 6))))
    assert [r.message.seq for r in received] == [6]
    tracker = newest.trackers["haptic/state", "a@b"]
    assert (tracker.received, tracker.superseded, tracker.lost, tracker.gaps) == (5, 3, 2, 1)


@pytest.mark.parametrize(
    ("seqs", "taken", "superseded", "duplicates"),
    [
        # repeated, overtaken, and both: the newest is the one of the highest number, wherever it stands
        ((1, 2, 2), [2], 1, 1),
        ((3, 1, 2), [3], 0, 0),
        ((1, 3, 2, 3, 4), [4], 2, 1),
        ((0, 0, 1), [1], 0, 2),
    ],
)
def test_repeated_and_overtaken_messages_do_not_count_as_superseded(
    newest: Subscriber, seqs: tuple[int, ...], taken: list[int], superseded: int, duplicates: int
) -> None:
    received = newest.take(waiting(*(("haptic/state", seq, seq, "a@b") for seq in seqs)))
    assert [r.message.seq for r in received] == taken
    tracker = newest.trackers["haptic/state", "a@b"]
    assert (tracker.superseded, tracker.duplicates, tracker.lost) == (superseded, duplicates, 0)
    assert tracker.last_seq == max(seqs)


def test_the_first_message_after_a_restart_supersedes_those_before_it(newest: Subscriber) -> None:
    received = newest.take(waiting(("haptic/state", 1, 1, "a@b"), ("haptic/state", 0, 10**9, "a@b")))
    assert [(r.message.seq, r.arrival) for r in received] == [(0, Arrival.RESTART)]
    assert newest.trackers["haptic/state", "a@b"].superseded == 1


def test_what_is_wrong_supersedes_nothing_and_is_refused_as_ever(newest: Subscriber) -> None:
    frames = waiting(("haptic/state", 1, 1, "a@b"), ("haptic/state", 2, 2, "a@b"))
    wrong = [[b"haptic/state", b""], [b"haptic/state"], [b"haptic/state", GOOD, b""], [b"haptic/stateful", GOOD]]
    received = newest.take([*frames, *((frame, 9) for frame in wrong)])
    assert [r.message.seq for r in received] == [2]
    assert newest.rejected == {"malformed": 1, "frames": 2, "topic": 1}


def test_a_source_that_may_not_speak_supersedes_nothing(context: Context) -> None:
    def permit(topic: str, src: str) -> None:
        if src != "a@b":
            raise WireError("role", f"{src} may not publish {topic}")

    reader = Subscriber(context, VirtualClock(), {"": ["haptic/state"]}, connect=False, permit=permit, newest_only=True)
    try:
        reader.take(waiting(("haptic/state", 0, 0, "a@b")))
        received = reader.take(waiting(*(("haptic/state", n, n, src) for n in (1, 2) for src in ("a@b", "x@b"))))
    finally:
        reader.close()
    assert [(r.message.src, r.message.seq) for r in received] == [("a@b", 2)]
    assert reader.rejected == {"role": 2}


def test_superseded_messages_are_in_the_report_and_are_no_refusals(newest: Subscriber) -> None:
    bus = ZmqBus(NullPublisher(VirtualClock(), "n@s"), [newest], VirtualClock(), 0)
    newest.take(waiting(*(("haptic/state", seq, seq, "a@b") for seq in range(1, 9))))
    assert bus.rejections() == ({"superseded": 7}, "")
    newest.take(waiting(("haptic/state", 9, 9, "a@b")))
    assert bus.rejections() == ({"superseded": 7}, "")


def test_every_source_has_its_own_account(unconnected: Subscriber) -> None:
    for seq in range(3):
        assert hand(unconnected, seq, seq, src="haptic_node@master")
    received = hand(unconnected, 50, 50, src="haptic_node@slave")
    assert received is not None
    assert received.arrival is Arrival.NEXT
    assert all(tracker.lost == 0 for tracker in unconnected.trackers.values())


def test_the_account_of_every_input_is_reported(context: Context, endpoint: str) -> None:
    clock = VirtualClock(epoch_offset_ns=10**9)
    reader = Subscriber(context, clock, {endpoint: ["haptic/state", "session/control"]})
    try:
        silent = reader.input_health()
        assert [(h.topic, h.src, h.age_valid) for h in silent] == [
            ("haptic/state", "", False),
            ("session/control", "", False),
        ]
        for seq, t_ns in ((0, 1), (3, 2), (2, 1), (2, 1), (0, 10**9)):
            hand(reader, seq, t_ns)
        clock.advance_ns(250_000_000)
        hand_row, still_silent = reader.input_health()
    finally:
        reader.close()
    assert (hand_row.topic, hand_row.src) == ("haptic/state", "a@b")
    assert (hand_row.received, hand_row.lost, hand_row.gaps) == (4, 1, 1)
    assert (hand_row.repeated, hand_row.restarts, hand_row.age_valid, hand_row.age_s) == (2, 1, True, 0.25)
    assert still_silent.topic == "session/control"


def test_invented_numbers_do_not_break_the_report(unconnected: Subscriber) -> None:
    t_ns = 0
    for _ in range(3):
        for seq in (0, 2**63 - 1):
            t_ns += 1
            hand(unconnected, seq, t_ns)
    assert unconnected.input_health()[0].lost == 2**63 - 1
    assert unconnected.trackers["haptic/state", "a@b"].lost == 2**63 - 1


def test_invented_sources_do_not_fill_the_memory(unconnected: Subscriber) -> None:
    for number in range(MOST_TRACKERS + 10):
        hand(unconnected, 0, 0, src=f"n{number}@b")
    assert len(unconnected.trackers) == MOST_TRACKERS
    assert unconnected.rejected == {"source": 10}
    assert f"the {MOST_TRACKERS} that are counted" in unconnected.last_error
    # sources that were there before are still received
    assert hand(unconnected, 1, 1, src="n5@b") is not None


def test_of_many_sources_those_are_told_of_that_sent_most(unconnected: Subscriber) -> None:
    for number in range(MOST_TRACKERS):
        for seq in range(2 if number % 20 == 7 else 1):
            hand(unconnected, seq, seq, src=f"n{number}@b")
    told = [(row.topic, row.src) for row in unconnected.input_health()]
    assert len(told) < 100
    assert told == sorted(told)
    assert {("haptic/state", f"n{number}@b") for number in range(7, MOST_TRACKERS, 20)} <= set(told)


def test_a_flood_is_taken_a_bounded_part_at_a_time(context: Context) -> None:
    # inproc hands messages over at once, so that all are there before the first is read
    flood = Sender(context, "inproc://flood")
    reader = Subscriber(context, SystemClock(), {"inproc://flood": ["haptic/state"]})
    try:
        flood.connected()
        for seq in range(1000):
            flood.send(b"haptic/state", payload("haptic/state", seq=seq))
        parts = [len(reader.receive()) for _ in range(5)]
    finally:
        flood.socket.close()
        reader.close()
    assert parts == [BATCH, BATCH, BATCH, 1000 - 3 * BATCH, 0]


def test_a_message_of_endless_frames_is_taken_a_bounded_part_at_a_time_and_refused_once(context: Context) -> None:
    flood = Sender(context, "inproc://frames")
    reader = Subscriber(context, SystemClock(), {"inproc://frames": ["haptic/state"]})
    try:
        flood.connected()
        parts = 20
        flood.send(b"haptic/state", GOOD, *[b"x"] * (parts * MOST_FRAMES - 2))
        flood.send(b"haptic/state", GOOD)
        taken = []
        while len(taken) < 2 * parts and (not taken or not reader.drained):
            taken.append(reader.receive_raw())
    finally:
        flood.socket.close()
        reader.close()
    # the first part is what is refused, and nothing of the parts after it is kept
    assert [len(part) for part in taken] == [1] + [0] * (parts - 2) + [1]
    assert [len(frames) for part in taken for frames, _ in part] == [MOST_FRAMES, 2]


def test_a_reader_that_stops_for_longer_than_its_mark_counts_what_it_missed(context: Context) -> None:
    sender = context.socket(zmq.XPUB)
    sender.set(zmq.SNDHWM, 10)
    sender.bind("inproc://slow")
    reader = Subscriber(context, SystemClock(), {"inproc://slow": ["haptic/state"]}, newest_only=True, connect=False)
    reader.socket.set(zmq.RCVHWM, NEWEST_MARK)
    reader.socket.connect("inproc://slow")
    sent = 2 * NEWEST_MARK
    try:
        assert sender.poll(WAIT_S * 1e3)
        sender.recv()
        for seq in range(sent):
            sender.send_multipart([b"haptic/state", payload("haptic/state", seq=seq)])
        received = collect(reader, 1)
        while more := reader.receive():
            received += more
        sender.send_multipart([b"haptic/state", payload("haptic/state", seq=sent)])
        received += collect(reader, 1)
    finally:
        sender.close(linger=0)
        reader.close()
    tracker = reader.trackers["haptic/state", "haptic_node@master"]
    # it took all that its queue and the sender's held, acted on a few, and knows of the rest
    assert NEWEST_MARK <= tracker.received < sent
    assert (tracker.received + tracker.lost, tracker.gaps) == (sent + 1, 1)
    assert tracker.received == len(received) + tracker.superseded
    assert received[-1].message.seq == sent


# --- the endpoint ---


def test_an_ipc_endpoint_in_use_names_its_holder(context: Context, endpoint: str) -> None:
    first = ZmqPublisher(context, SystemClock(), "afm_node@slave", endpoint)
    with pytest.raises(EndpointError, match=f"{endpoint} is in use by process {os.getpid()}: stop it"):
        ZmqPublisher(context, SystemClock(), "afm_node@slave", endpoint)
    first.close()
    ZmqPublisher(context, SystemClock(), "afm_node@slave", endpoint).close()


HOLDER = """
import sys, zmq
from telenano.runtime.bus.publisher import ZmqPublisher
from telenano.timing.clock import SystemClock
holder = ZmqPublisher(zmq.Context(), SystemClock(), "afm_node@slave", sys.argv[1])
print("holding", flush=True)
sys.stdin.read()
"""


def test_an_endpoint_is_free_again_when_its_holder_was_killed(context: Context, endpoint: str) -> None:
    command = [sys.executable, "-c", HOLDER, endpoint]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as holder:
        assert holder.stdout is not None
        try:
            assert holder.stdout.readline() == "holding\n"
            with pytest.raises(EndpointError, match=f"in use by process {holder.pid}:"):
                ZmqPublisher(context, SystemClock(), "afm_node@slave", endpoint)
        finally:
            holder.kill()
    ZmqPublisher(context, SystemClock(), "afm_node@slave", endpoint).close()


def test_an_endpoint_that_was_closed_leaves_nothing_behind(context: Context, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    endpoint = f"ipc://{folder}/afm_node@slave"
    publisher = ZmqPublisher(context, SystemClock(), "afm_node@slave", endpoint)
    assert sorted(path.name for path in folder.iterdir()) == ["afm_node@slave", "afm_node@slave.lock"]
    publisher.close()
    assert list(folder.iterdir()) == []
    # closed twice it does not take away what the next one has bound
    following = ZmqPublisher(context, SystemClock(), "afm_node@slave", endpoint)
    publisher.close()
    assert len(list(folder.iterdir())) == 2
    following.close()


def test_a_lock_that_was_removed_while_it_was_waited_for_is_none(
    context: Context, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    endpoint = f"ipc://{tmp_path}/afm_node@slave"
    first = ZmqPublisher(context, SystemClock(), "afm_node@slave", endpoint)
    lock = fcntl.flock
    opened: list[int] = []

    def after_the_end_of_the_first(file: int, operation: int) -> None:
        opened.append(file)
        first.close()
        lock(file, operation)

    monkeypatch.setattr(fcntl, "flock", after_the_end_of_the_first)
    second = ZmqPublisher(context, SystemClock(), "afm_node@slave", endpoint)
    monkeypatch.undo()
    # the file that it opened at first was the one of the first holder, removed before it was locked
    assert len(opened) == 2
    with pytest.raises(EndpointError, match=f"in use by process {os.getpid()}"):
        ZmqPublisher(context, SystemClock(), "afm_node@slave", endpoint)
    second.close()
    assert list(tmp_path.iterdir()) == []


def test_a_link_in_the_place_of_a_lock_is_not_followed(context: Context, tmp_path: Path) -> None:
    target = tmp_path / "target"
    target.write_text("of somebody else")
    (tmp_path / "bus.lock").symlink_to(target)
    with pytest.raises(EndpointError, match=r"bus\.lock cannot be opened: Too many levels of symbolic links"):
        ZmqPublisher(context, SystemClock(), "afm_node@slave", f"ipc://{tmp_path}/bus")
    assert target.read_text() == "of somebody else"


def test_a_tcp_port_in_use_is_named(context: Context) -> None:
    with plain_socket.create_server(("127.0.0.1", 0)) as server:
        endpoint = f"tcp://127.0.0.1:{server.getsockname()[1]}"
        with pytest.raises(EndpointError, match=f"afm_node@slave cannot bind {endpoint}: another process has it"):
            ZmqPublisher(context, SystemClock(), "afm_node@slave", endpoint)


@pytest.mark.parametrize("endpoint", ["tcp://192.0.2.1:5501", "tcp://no-such-interface:5501"])
def test_an_address_of_another_machine_cannot_be_bound(context: Context, endpoint: str) -> None:
    with pytest.raises(EndpointError, match=f"afm_node@slave cannot bind {endpoint}: "):
        ZmqPublisher(context, SystemClock(), "afm_node@slave", endpoint)


def test_a_folder_that_cannot_be_made_is_named(context: Context, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(EndpointError, match=r"file/bus\.lock cannot be opened: "):
        ZmqPublisher(context, SystemClock(), "afm_node@slave", f"ipc://{tmp_path}/file/bus")


def test_an_ipc_path_that_is_too_long_lets_its_lock_go(context: Context, tmp_path: Path) -> None:
    endpoint = f"ipc://{tmp_path}/{'x' * 120}"
    for _ in range(2):
        with pytest.raises(EndpointError, match=r"afm_node@slave cannot bind .*longer than 107"):
            ZmqPublisher(context, SystemClock(), "afm_node@slave", endpoint)


def test_the_folder_of_the_sockets_is_private(context: Context, tmp_path: Path) -> None:
    ZmqPublisher(context, SystemClock(), "afm_node@slave", f"ipc://{tmp_path}/private/bus").close()
    assert (tmp_path / "private").stat().st_mode & 0o077 == 0


# --- waiting ---


@pytest.fixture
def wake() -> Iterator[tuple[int, int]]:
    reading, writing = os.pipe()
    yield reading, writing
    os.close(reading)
    os.close(writing)


def test_a_wait_ends_with_a_message_a_signal_or_its_deadline(
    context: Context, sender: Sender, reader: Subscriber, tmp_path: Path, wake: tuple[int, int]
) -> None:
    clock = SystemClock()
    own = ZmqPublisher(context, clock, "n@master", f"ipc://{tmp_path}/own")
    bus = ZmqBus(own, [reader], clock, wake[0])
    hour_ns = 3_600_000_000_000
    try:
        # a deadline that is over, and one that is near
        bus.wait(clock.monotonic_ns() - 1)
        assert list(bus.receive()) == []
        deadline = clock.monotonic_ns() + 5_000_000
        bus.wait(deadline)
        assert clock.monotonic_ns() >= deadline
        # messages: the wait of an hour ends at the first, and at once while there are more to take
        for seq in range(BATCH + 1):
            sender.send(b"haptic/state", payload("haptic/state", seq=seq))
        taken = 0
        while taken < BATCH + 1:
            bus.wait(clock.monotonic_ns() + hour_ns)
            taken += len(list(bus.receive()))
        # a signal
        os.write(wake[1], b"\x0f")
        bus.wait(clock.monotonic_ns() + hour_ns)
    finally:
        own.close()


def test_the_accounts_of_several_subscribers_are_one(
    context: Context, reader: Subscriber, unconnected: Subscriber, tmp_path: Path, wake: tuple[int, int]
) -> None:
    clock = SystemClock()
    own = ZmqPublisher(context, clock, "n@master", f"ipc://{tmp_path}/own")
    bus = ZmqBus(own, [reader, unconnected], clock, wake[0])
    try:
        assert bus.rejections() == ({}, "")
        reader.decode_and_track([b"one"], 0)
        unconnected.decode_and_track([b"one"], 0)
        unconnected.decode_and_track([b"haptic/state", b""], 0)
        hand(unconnected, 0, 0)
        counts, text = bus.rejections()
        assert counts == {"frames": 2, "malformed": 1}
        assert "not msgpack" in text
        assert [h.topic for h in bus.input_health()] == ["haptic/state", "session/control", "haptic/state"]
        # nobody judges what is sent on change by its age, so that it need not cross to another machine
        bus.is_brief = True
        assert [h.topic for h in bus.input_health()] == ["haptic/state", "haptic/state"]
        hand(reader, 0, 0)
        for seq in (3, 7):
            reader.decode_and_track([b"session/control", payload("session/control", seq=seq)], 0)
        assert [h.topic for h in bus.input_health() if h.gaps] == ["session/control"]
    finally:
        own.close()


def test_what_the_link_forwards_keeps_the_header_of_its_publisher(
    context: Context, endpoint: str, tmp_path: Path
) -> None:
    link = ZmqPublisher(context, SystemClock(), "delay_node@slave", endpoint, kind=zmq.XPUB)
    reader = Subscriber(context, SystemClock(), {endpoint: ["session/control"]})
    try:
        assert link.socket.poll(WAIT_S * 1e3)
        link.socket.recv()
        link.send("session/control", payload("session/control", src="launcher@master", seq=41))
        (received,) = collect(reader, 1)
    finally:
        reader.close()
        link.close()
    assert isinstance(received.message, SessionControl)
    assert (received.message.src, received.message.seq) == ("launcher@master", 41)
    assert not isinstance(received.message, HapticState)


# --- what waits for a reader that stands still ---


def test_ten_seconds_of_the_busiest_publisher_wait_for_its_readers() -> None:
    nodes = [row.key for row in NODES if row.part in ("rig", "endpoint")]
    rates = {
        node: sum(
            row.rate_hz or 0.0 for row in TOPICS.values() if node in row.publishers or name_of(node) in row.publishers
        )
        for node in nodes
    }
    busiest_hz = max(rates.values())
    assert {node for node, rate_hz in rates.items() if rate_hz == busiest_hz} == {
        "controller@master",
        "controller@slave",
    }
    # events, journal and health as well
    assert QUEUE_S * (busiest_hz + 10.0) <= SEND_HIGH_WATER_MARK
    assert RECEIVE_HIGH_WATER_MARK >= SEND_HIGH_WATER_MARK


READER = """
import sys, time, zmq
from telenano.runtime.bus.bus import Subscriber
from telenano.timing.clock import SystemClock
reader = Subscriber(zmq.Context(), SystemClock(), {sys.argv[1]: ["clock/ping"]}, newest_only=True, queue_s=0.2)
while True:
    reader.socket.poll(100)
    for received in reader.receive():
        tracker = reader.trackers["clock/ping", received.message.src]
        print(received.message.seq, tracker.lost, tracker.superseded, flush=True)
"""


def test_a_reader_that_stands_still_for_longer_than_the_queue_goes_on_with_the_newest(
    context: Context, endpoint: str
) -> None:
    publisher = ZmqPublisher(context, SystemClock(), "delay_node@slave", endpoint, kind=zmq.XPUB)
    command = [sys.executable, "-c", READER, endpoint]
    rows: queue.Queue[list[int]] = queue.Queue()

    def read(out: IO[str]) -> None:
        for line in out:
            rows.put([int(word) for word in line.split()])

    def publish_until(condition: Callable[[], bool]) -> None:
        deadline = time.monotonic() + WAIT_S
        while not condition():
            assert time.monotonic() < deadline
            publisher.publish("clock/ping")
            time.sleep(1e-3)

    def subscribed(expected: bytes) -> bool:
        return publisher.socket.poll(0) != 0 and publisher.socket.recv() == expected

    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as reader:
        assert reader.stdout is not None
        thread = threading.Thread(target=read, args=(reader.stdout,))
        thread.start()
        try:
            publish_until(lambda: subscribed(b"\x01clock/ping"))
            # pings have told the publisher how long to wait for this reader
            publish_until(lambda: rows.qsize() > 200)
            os.kill(reader.pid, signal.SIGSTOP)
            # the end of the subscription is the end of the connection
            publish_until(lambda: subscribed(b"\x00clock/ping"))
            before = publisher.sequence_numbers()["clock/ping"]
            publish_until(lambda: publisher.sequence_numbers()["clock/ping"] > before + 100)
            resumed = publisher.sequence_numbers()["clock/ping"]
            os.kill(reader.pid, signal.SIGCONT)
            publish_until(lambda: not rows.empty() and rows.queue[-1][0] > resumed)
        finally:
            reader.kill()
            thread.join()
            publisher.close()
    seq, lost, superseded = rows.queue[-1]
    # what was dropped with the connection is lost, and known to be; what had got through was superseded
    assert lost > 100
    assert lost + superseded + rows.qsize() == seq + 1 - rows.queue[0][0]


HELD_UP = """
import os, signal, sys, time, zmq
from telenano.runtime.bus.bus import Subscriber
from telenano.timing.clock import SystemClock
endpoint, by_a_stop, late_s = sys.argv[1], sys.argv[2] == "stop", float(sys.argv[3])
reader = Subscriber(zmq.Context(), SystemClock(), {endpoint: ["clock/ping"]}, newest_only=True, queue_s=0.2)
print("begun", flush=True)
sys.stdin.readline()
if by_a_stop:
    print("stopped", flush=True)
    os.kill(os.getpid(), signal.SIGSTOP)
# a thread that is busy with something else: what libzmq does meanwhile goes on
time.sleep(late_s)
while not reader.receive():
    reader.socket.poll(50)
while reader.socket.poll(1500):
    reader.receive()
(tracker,) = reader.trackers.values()
print("newest", tracker.last_seq, flush=True)
"""


@pytest.mark.check("takes 0.8 s")
@pytest.mark.drawn(0.4, "telenano/runtime/bus/")
@pytest.mark.parametrize(("how", "late_s"), [("busy", 1.0), ("stop", 0.0), ("stop", 0.3)])
def test_a_reader_that_was_held_up_goes_on_also_when_its_publisher_has_become_silent(
    context: Context, endpoint: str, how: str, late_s: float
) -> None:
    publisher = ZmqPublisher(context, SystemClock(), "delay_node@slave", endpoint, kind=zmq.XPUB)
    command = [sys.executable, "-c", HELD_UP, endpoint, how, str(late_s)]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with subprocess.Popen(command, **pipes) as reader:  # type: ignore[call-overload]
        try:
            assert reader.stdout.readline() == "begun\n"
            assert publisher.socket.poll(WAIT_S * 1e3)
            assert publisher.socket.recv() == b"\x01clock/ping"
            # more than the socket of a reader once had room for
            for _ in range(2000):
                publisher.publish("clock/ping")
            # pings tell the publisher how long to wait for this reader
            time.sleep(0.5)
            reader.stdin.write("\n")
            reader.stdin.flush()
            if how == "stop":
                assert reader.stdout.readline() == "stopped\n"
                # the end of the subscription is the end of the connection, and another one follows
                assert publisher.socket.poll(WAIT_S * 1e3)
                assert publisher.socket.recv() == b"\x00clock/ping"
                os.kill(reader.pid, signal.SIGCONT)
                assert publisher.socket.poll(WAIT_S * 1e3)
                time.sleep(late_s + 0.2)
                publisher.publish("clock/ping")
            out, err = reader.communicate(timeout=WAIT_S)
        finally:
            reader.kill()
            publisher.close()
    assert reader.returncode == 0, err
    assert out == f"newest {publisher.sequence_numbers()['clock/ping'] - 1}\n"
