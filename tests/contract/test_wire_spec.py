"""The specification suffices: a client written from it alone reads every message, and its commands are obeyed."""

import ast
import socket as plain_socket
import time
from pathlib import Path

import msgpack
import msgspec
import numpy as np
import pytest
import spec_client
import zmq
from hypothesis import given
from hypothesis import strategies as st

from telenano.runtime.bus.address_book import AddressBook
from telenano.runtime.bus.bus import Subscriber
from telenano.runtime.bus.publisher import ZmqPublisher
from telenano.runtime.security.keyring import Keyring
from telenano.runtime.wiring.transport import Transport
from telenano.settings import DEFAULT_SITE_FILE, TWO_SITES_FILE
from telenano.settings.included import SITE_DIRECTORY
from telenano.testing.filled_messages import examples
from telenano.timing.clock import SystemClock
from telenano.wire import decode, encode
from telenano.wire.messages import AfmScanline, Array, Record, SessionControl
from telenano.wire.sequence import Arrival, SequenceTracker
from telenano.wire.topics import OWN_TOPICS as TOPICS

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
    assert not any(name.startswith(("services", "telenano")) for name in imported)


@pytest.mark.parametrize("topic", TOPICS)
def test_the_client_reads_what_we_write(topic: str) -> None:
    for message in examples(TOPICS[topic]).values():
        name, fields = spec_client.read([topic.encode(), encode(message)])
        assert name == topic
        assert fields == _fields(message)


def test_the_client_reads_the_elements_of_an_array() -> None:
    height = np.array([[1e-9, -2.5e-10, 0.0], [4e-9, 5e-9, 6e-9]])
    line = msgspec.structs.replace(examples(TOPICS["afm/scanline"])["minimal"], height_m=Array.from_numpy(height))
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


@given(
    st.lists(
        st.tuples(st.integers(0, 12), st.integers(0, 6), st.sampled_from((None, None, None, 1, 1, 2, 3))), max_size=60
    )
)
def test_the_sequence_table_is_what_our_readers_do(messages: list[tuple[int, int, int | None]]) -> None:
    account, tracker = spec_client.Account(), SequenceTracker()
    for seq, t_ns, run in messages:
        assert ROW_OF[tracker.accept(seq, t_ns, run)] == account.record(seq, t_ns, run)
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


SITE_FILE = """
machines: {{master: 127.0.0.1, slave: 127.0.0.1, desk: 127.0.0.1}}
nodes:
  afm_node@slave: {{local: "ipc://{{runtime}}/afm_node@slave", network: "tcp://{{slave}}:{port}"}}
  console_desk@master: {{network: "tcp://{{desk}}:1", machine: desk}}
"""


@pytest.mark.parametrize("reader", ["slave", "desk"])
def test_the_client_reads_a_node_of_its_own_machine_and_of_another_one(
    reader: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TELENANO_RUNTIME_DIR", str(tmp_path / "run"))
    with plain_socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    site_file = tmp_path / "site.yaml"
    site_file.write_text(SITE_FILE.format(port=port))
    rings = {name: Keyring(tmp_path / name) for name in ("slave", "desk")}
    keys = {name: ring.create(name).public.decode() for name, ring in rings.items()}
    rings["slave"].allow("desk", keys["desk"], ["observe"])
    rings["desk"].allow("slave", keys["slave"], ["data"])
    clock = SystemClock()
    with zmq.Context() as context:
        transport = Transport(context, clock, AddressBook.load(site_file), "slave", rings["slave"])
        publisher = transport.publisher("afm_node@slave")
        client = context.socket(zmq.SUB)
        client.subscribe(b"session/event")
        try:
            spec_client.connect(client, site_file, "afm_node@slave", tmp_path / reader, reader)
            deadline = time.monotonic() + 20.0
            while not client.poll(10):
                assert time.monotonic() < deadline, transport.last_error
                transport.process_events()
                publisher.publish("session/event", id="", kind="mode", level="info", text="hold", data={})
            topic, fields = spec_client.read(client.recv_multipart())
            assert client.get(zmq.MECHANISM) == (zmq.NULL if reader == "slave" else zmq.CURVE)
        finally:
            client.close(linger=0)
            publisher.close()
            transport.close()
    assert (topic, fields["src"], fields["text"]) == ("session/event", "afm_node@slave", "hold")


@pytest.mark.parametrize("reader", ["master", "slave", "desk"])
@pytest.mark.parametrize("site_file", [DEFAULT_SITE_FILE, TWO_SITES_FILE], ids=lambda path: path.stem)
def test_the_client_finds_the_endpoints_that_our_readers_find(
    site_file: Path, reader: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TELENANO_RUNTIME_DIR", str(tmp_path))
    monkeypatch.setenv("TELENANO_HOST_SLAVE", "10.1.2.3")
    book = AddressBook.load(site_file)
    assert site_file.parent == SITE_DIRECTORY
    for node in book.nodes:
        assert spec_client.endpoint(site_file, node, reader) == (book.endpoint(node, reader), book.machine_of(node))


def _plain(value: object) -> object:
    """Give a field as a language without our classes has it."""
    if isinstance(value, Array):
        return value.to_numpy().tolist()
    if isinstance(value, Record):
        return _fields(value)
    return [_plain(part) for part in value] if isinstance(value, tuple) else value


def _fields(record: Record) -> dict[str, object]:
    return {key: _plain(getattr(record, key)) for key in msgspec.to_builtins(record, builtin_types=(bytes,))}


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
