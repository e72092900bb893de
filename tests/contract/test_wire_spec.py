"""The specification suffices: a client written from it alone reads every message, and its commands are obeyed."""

import ast
import time
from pathlib import Path

import msgpack
import numpy as np
import pytest
import spec_client
import zmq
from hypothesis import given
from hypothesis import strategies as st

from proto import TOPICS, decode, encode
from proto.contract import examples
from proto.messages import AfmScanline, Array, Record, SessionControl
from proto.sequence import Arrival, SequenceTracker
from services.runtime.bus import Subscriber, ZmqPublisher
from services.runtime.clock import SystemClock

ROW_OF = {
    Arrival.NEXT: "next",
    Arrival.AFTER_GAP: "gap",
    Arrival.RESTART: "restart",
    Arrival.LATE: "overtaken",
    Arrival.DUPLICATE: "repetition",
}


def test_the_client_uses_nothing_of_ours() -> None:
    tree = ast.parse(Path(spec_client.__file__).read_text(encoding="utf-8"))
    imported = {alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names}
    imported |= {str(node.module) for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    assert not any(name.startswith(("proto", "services", "studies")) for name in imported)


@pytest.mark.parametrize("topic", TOPICS)
def test_the_client_reads_what_we_write(topic: str) -> None:
    for message in examples(TOPICS[topic]).values():
        name, fields = spec_client.read([topic.encode(), encode(message)])
        assert name == topic
        assert fields == {key: _plain(getattr(message, key)) for key in message.model_dump()}


def test_the_client_reads_the_elements_of_an_array() -> None:
    height = np.array([[1e-9, -2.5e-10, 0.0], [4e-9, 5e-9, 6e-9]])
    line = examples(TOPICS["afm/scanline"])["minimal"].model_copy(update={"height_m": Array.from_numpy(height)})
    assert isinstance(line, AfmScanline)
    _, fields = spec_client.read([b"afm/scanline", encode(line)])
    assert fields["height_m"] == height.tolist()


@pytest.mark.parametrize("topic", TOPICS)
def test_we_read_what_the_client_writes(topic: str) -> None:
    for message in examples(TOPICS[topic]).values():
        # another language keeps its keys in another order
        fields = dict(reversed(msgpack.unpackb(encode(message)).items()))
        assert decode(topic, spec_client.write(topic, **fields)[1]) == message


def test_a_command_of_the_client_is_accepted() -> None:
    topic, payload = spec_client.command(0, "7f3a-01", "set", "controller", stiffness_n_per_m=200.0)
    control = decode(topic.decode(), payload)
    assert isinstance(control, SessionControl)
    assert (control.id, control.command, control.target) == ("7f3a-01", "set", "controller")
    assert control.parameters == {"stiffness_n_per_m": 200.0}


@given(st.lists(st.tuples(st.integers(0, 12), st.integers(0, 6)), max_size=60))
def test_the_sequence_table_is_what_our_readers_do(messages: list[tuple[int, int]]) -> None:
    account, tracker = spec_client.Account(), SequenceTracker()
    for seq, t_ns in messages:
        assert ROW_OF[tracker.accept(seq, t_ns)] == account.record(seq, t_ns)
        assert tracker.lost >= 0
    # a restart forgets what is missing, but not that it was lost
    assert tracker.lost == account.lost


def test_command_and_answer_over_sockets(tmp_path: Path) -> None:
    clock = SystemClock()
    console, node = f"ipc://{tmp_path}/console", f"ipc://{tmp_path}/node"
    with zmq.Context() as context:
        publisher = ZmqPublisher(context, clock, "controller@master", node)
        subscriber = Subscriber(context, clock, {console: ["session/control"]})
        commands, answers = context.socket(zmq.PUB), context.socket(zmq.SUB)
        try:
            commands.bind(console)
            answers.subscribe(b"session/event")
            answers.connect(node)
            answer = _send_until_answered(commands, answers, subscriber, publisher)
        finally:
            for closed in (commands, answers):
                closed.close(linger=0)
            subscriber.close()
            publisher.close()
    assert (answer["id"], answer["kind"], answer["src"]) == ("c-1", "ack", "controller@master")


def _plain(value: object) -> object:
    """Give a field as a language without our classes has it."""
    if isinstance(value, Array):
        return value.to_numpy().tolist()
    if isinstance(value, Record):
        return {key: _plain(part) for key, part in value}
    return [_plain(part) for part in value] if isinstance(value, tuple) else value


def _send_until_answered(
    commands: zmq.Socket[bytes], answers: zmq.Socket[bytes], subscriber: Subscriber, publisher: ZmqPublisher
) -> dict[str, object]:
    deadline = time.monotonic() + 20.0
    seq = 0
    while time.monotonic() < deadline:
        commands.send_multipart(spec_client.command(seq, "c-1", "mark", "*"))
        seq += 1
        subscriber.socket.poll(20)
        for received in subscriber.receive():
            assert isinstance(received.message, SessionControl)
            publisher.publish("session/event", id=received.message.id, kind="ack", level="info", text="marked", data={})
        if answers.poll(20):
            return spec_client.read(answers.recv_multipart())[1]
    raise AssertionError("no answer within 20 s")
