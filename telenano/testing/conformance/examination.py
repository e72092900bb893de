"""The examination of a client that is connected over ZeroMQ for some seconds."""

import time
from pathlib import Path
from typing import Any, NamedTuple

import msgpack
import zmq
import zmq.auth
from zmq.utils.monitor import recv_monitor_message

from telenano.files import open_regular
from telenano.testing.conformance.answers_of_client import AnswersOfClient
from telenano.testing.conformance.client_messages import NO_NODES, MessageExaminer
from telenano.testing.conformance.commands_of_client import CommandsOfClient
from telenano.testing.conformance.rules import Account, Finding
from telenano.wire import TOPICS, ConfigError, encode, example

_HANDSHAKE_S = 5.0
_TICK_MS = 10
_STATES_S = 0.02
_SETTLED_S = 0.3
# Most messages that wait to be read.
_MOST_WAITING = 2000
# Messages larger than this end the connection; the largest message of the wire has half of it [bytes].
_LARGEST_BYTES = 1 << 21
# Most events of the connection, or subscriptions, that are processed in a turn.
_MOST_A_TURN = 1000
# A client sends too fast if this processor time is not enough to read all its waiting messages [s].
_BEHIND_S = 1.0
# Sources of the messages of the kit.
_COMMANDER = "console@master"
_NODE = "afm_node@slave"
_FAILED = (
    zmq.EVENT_HANDSHAKE_FAILED_AUTH,
    zmq.EVENT_HANDSHAKE_FAILED_NO_DETAIL,
    zmq.EVENT_HANDSHAKE_FAILED_PROTOCOL,
)


class Keys(NamedTuple):
    """The public key of the client's machine, and the own pair, in Z85."""

    server: bytes
    public: bytes
    secret: bytes

    @classmethod
    def of(cls, server: str, own: Path) -> "Keys":
        """Return the keys, with the own pair from a file; raise ConfigError if that file is unusable."""
        try:
            open_regular(own).close()
        except OSError as error:
            raise ConfigError(f"{own}: cannot be read: {error.strerror}") from error
        try:
            public, secret = zmq.auth.load_certificate(own)
        except (OSError, ValueError, IndexError) as error:
            # The reader of ZeroMQ expects a value in every line that begins with the name of a key.
            reason = "a line of a key has no value" if isinstance(error, IndexError) else error
            raise ConfigError(
                f"{own}: is not a file with a pair of keys, as `telenano keys new` makes: {reason}"
            ) from error
        if secret is None:
            raise ConfigError(f"{own}: has no secret-key; name the file that ends with .key_secret")
        return cls(server.encode(), public, secret)


class _Rig:
    """Publishes the messages of the kit for the client: states, commands to it, and answers to its own commands."""

    def __init__(self, socket: "zmq.Socket[bytes]") -> None:
        self._socket = socket
        self._numbers: dict[tuple[str, str], int] = {}
        self.topics: set[str] = set()
        self._due_s, self._subscribed_s = 0.0, time.monotonic()
        states = {"haptic/state": "haptic_node@master", "afm/state": _NODE}
        self._states = {topic: (src, _content(topic)) for topic, src in states.items()}

    def send(self, topic: str, src: str, fields: dict[str, Any], age_ns: int = 0) -> int:
        """Send a message with the next number of its source; return its t_ns."""
        seq = self._numbers.get((topic, src), 0)
        self._numbers[topic, src] = seq + 1
        t_ns = time.time_ns() - age_ns
        whole = {"seq": seq, "t_ns": t_ns, "src": src, "v": 1} | fields
        self._socket.send_multipart([topic.encode(), msgpack.packb(whole)])
        return t_ns

    def answer(self, node: str, fields: dict[str, Any]) -> int:
        return self.send("session/event", node, fields)

    def command(self, fields: dict[str, Any], age_ns: int) -> None:
        self.send("session/control", _COMMANDER, fields, age_ns)

    def read_subscriptions(self) -> None:
        """Process the subscriptions of the client."""
        for _ in range(_MOST_A_TURN):
            if not self._socket.poll(0):
                return
            subscription = self._socket.recv()
            if subscription[:1] == b"\x01":
                self._subscribed_s = time.monotonic()
                self.topics |= {topic for topic in TOPICS if topic.encode().startswith(subscription[1:])}

    def is_heard(self) -> bool:
        """Return whether the client hears commands: it has subscribed, and no further subscription came just now."""
        return "session/control" in self.topics and time.monotonic() - self._subscribed_s > _SETTLED_S

    def send_states(self) -> None:
        """Send the states of a rig fifty times a second, with a key that no client knows."""
        now_s = time.monotonic()
        if now_s < self._due_s:
            return
        self._due_s = now_s + _STATES_S
        for topic, (src, content) in self._states.items():
            self.send(topic, src, content)

    def disturb(self) -> None:
        """Send messages that break the rules, and one of a later version, on every topic that the client reads."""
        for topic in sorted(self.topics):
            name = topic.encode()
            for frames in (
                [name],
                [name, b"", b""],
                [name, b"\xc1"],
                [name, msgpack.packb([1])],
                [name + b"/x", b"\x80"],
            ):
                self._socket.send_multipart(frames)
            src = _COMMANDER if topic == "session/control" else _NODE
            later = {"seq": 1 << 40, "t_ns": time.time_ns(), "src": src, "v": TOPICS[topic].model.version + 1}
            self._socket.send_multipart([name, msgpack.packb(later)])


def _content(topic: str) -> dict[str, Any]:
    """Return the fields of an example message without `seq`, `t_ns` and `src`, with a key that no client knows."""
    fields = msgpack.unpackb(encode(example(topic)))
    return {key: value for key, value in fields.items() if key not in ("seq", "t_ns", "src")} | {"further_k": 295.0}


def examine(
    client: str, rig: str | None = None, *, duration_s: float = 10.0, keys: Keys | None = None, insecure: bool = False
) -> list[Finding]:
    """Connect to a client, examine it, and return the finding on each rule.

    Args:
        client: The endpoint at which the client's PUB socket is bound.
        rig: The endpoint that the kit binds, as a console and a node, for the client to read; None for none.
        duration_s: The duration of the examination [s].
        keys: The keys for CURVE, None for a plain connection.
        insecure: Whether a plain connection over the network is intended.

    Raises:
        ConfigError: An endpoint cannot be used, or is on the network without keys or `insecure`.
    """
    for address in (client, rig or ""):
        if address.startswith("tcp://") and not insecure and (keys is None or address == rig):
            raise ConfigError(
                f"{address}: is not encrypted: give --server-key, the key of the client's machine, or --insecure"
            )
    account = Account()
    with zmq.Context() as context:
        reader, monitor = _reader(context, client, keys)
        stranger = None if keys is None else _reader(context, client, keys._replace(**_own_pair()))
        server = context.socket(zmq.XPUB)
        try:
            if rig is not None:
                _bind(server, rig)
            _run(account, reader, monitor, _Rig(server) if rig else None, duration_s)
            _connection(account, client, duration_s)
            if stranger is not None and "connection" in account.held:
                account.hold("encryption")
                _stranger(account, stranger[1])
        finally:
            for socket in (reader, server, *((stranger[0],) if stranger else ())):
                socket.disable_monitor()
                socket.close(linger=0)
            monitor.close(linger=0)
            if stranger is not None:
                stranger[1].close(linger=0)
    return account.findings()


def _own_pair() -> dict[str, bytes]:
    public, secret = zmq.curve_keypair()
    return {"public": public, "secret": secret}


def _bind(socket: "zmq.Socket[bytes]", address: str) -> None:
    try:
        socket.bind(address)
    except zmq.ZMQError as error:
        raise ConfigError(f"{address}: cannot be bound: {error}") from error


def _reader(
    context: "zmq.Context[zmq.Socket[bytes]]", client: str, keys: Keys | None
) -> tuple["zmq.Socket[bytes]", "zmq.Socket[bytes]"]:
    """Return a socket that reads all messages of a client, and a monitor socket with the events of its connection."""
    socket = context.socket(zmq.SUB)
    socket.set_hwm(_MOST_WAITING)
    socket.set(zmq.MAXMSGSIZE, _LARGEST_BYTES)
    socket.subscribe(b"")
    monitor = socket.get_monitor_socket()
    if keys is not None:
        socket.curve_serverkey, socket.curve_publickey, socket.curve_secretkey = keys
    try:
        socket.connect(client)
    except zmq.ZMQError as error:
        socket.disable_monitor()
        for each in (socket, monitor):
            each.close(linger=0)
        raise ConfigError(f"{client}: is not an endpoint, such as ipc:///run/x or tcp://host:5700: {error}") from error
    return socket, monitor


def _run(
    account: Account,
    reader: "zmq.Socket[bytes]",
    monitor: "zmq.Socket[bytes]",
    rig: _Rig | None,
    duration_s: float,
) -> None:
    messages = MessageExaminer(account, is_hand=rig is not None)
    commands = CommandsOfClient(account, None if rig is None else rig.answer)
    answers = None if rig is None else AnswersOfClient(account, rig.command, rig.disturb)
    start_s, disturbed, before = time.monotonic(), False, 0
    pace, gone_s = _Pace(), 0.0
    while (passed_s := time.monotonic() - start_s) < duration_s and not pace.is_beyond:
        reader.poll(_TICK_MS)
        turn_ends_s = time.monotonic() + 1e-3 * _TICK_MS
        while pace.is_waiting(reader) and time.monotonic() < turn_ends_s:
            frames = reader.recv_multipart()
            sent = messages.take(frames, time.time_ns())
            if sent is None:
                continue
            if sent.topic == "session/control":
                commands.take(sent.fields, time.time_ns())
            elif answers is not None and rig is not None and sent.topic == "session/event":
                answers.take(sent.fields)
            if answers is not None and rig is not None and sent.topic not in NO_NODES and rig.is_heard():
                answers.begin(str(sent.fields.get("src")), time.time_ns())
        gone_s = _connection_events(account, monitor, passed_s, gone_s)
        commands.tick(time.time_ns())
        if rig is None or answers is None:
            continue
        rig.read_subscriptions()
        rig.send_states()
        answers.tick(time.time_ns())
        if rig.topics and messages.received and not disturbed and passed_s > 0.6 * duration_s:
            rig.disturb()
            disturbed, before = True, messages.received
    if disturbed:
        if messages.received > before:
            account.hold("robustness")
        else:
            account.fail("robustness", "nothing more comes after messages that break the rules")
    if gone_s and not (messages.received and messages.has_ended):
        text = f"the client was gone after {gone_s:.1f} of {duration_s:g} s, and sent no last message"
        account.fail("connection", text)
    if pace.is_beyond:
        text = f"the client sends faster than it can be read: it was read for {_BEHIND_S:g} s of the processor's time, "
        account.fail("pace", f"{text}{messages.received} messages, and more waited all the while; the examination ends")
    elif messages.received:
        account.hold("pace")
    messages.end(time.time_ns())
    if not messages.received:
        account.fail("frames", f"nothing came within {duration_s:g} s")


class _Pace:
    """Checks that the messages of a client can be read as fast as they come, by the processor time of this thread."""

    def __init__(self) -> None:
        self._emptied_s = time.thread_time()
        self.is_beyond = False

    def is_waiting(self, reader: "zmq.Socket[bytes]") -> bool:
        """Return whether a message waits to be read; set `is_beyond` if messages have waited for too long."""
        now_s = time.thread_time()
        if is_waiting := bool(reader.poll(0)):
            self.is_beyond = now_s - self._emptied_s > _BEHIND_S
        else:
            self._emptied_s = now_s
        return is_waiting


def _connection_events(account: Account, monitor: "zmq.Socket[bytes]", now_s: float, gone_s: float) -> float:
    """Record the events of the connection; return the time at which it was lost [s], 0 while it stands."""
    for _ in range(_MOST_A_TURN):
        if not monitor.poll(0):
            break
        event = recv_monitor_message(monitor)["event"]
        if event == zmq.EVENT_HANDSHAKE_SUCCEEDED:
            account.hold("connection")
            gone_s = 0.0
        elif event == zmq.EVENT_DISCONNECTED and "connection" in account.held:
            gone_s = now_s
        elif event in _FAILED:
            account.fail("connection", "the handshake failed: a plain and a CURVE socket meet, or a key is not allowed")
    return gone_s


def _connection(account: Account, client: str, duration_s: float) -> None:
    if "connection" not in account.held:
        account.fail("connection", f"no client at {client} ended a handshake within {duration_s:g} s")


def _stranger(account: Account, monitor: "zmq.Socket[bytes]") -> None:
    """Judge the result of a connection with an unknown key."""
    deadline_s = time.monotonic() + _HANDSHAKE_S
    while monitor.poll(max(0, round(1e3 * (deadline_s - time.monotonic())))):
        event = recv_monitor_message(monitor)["event"]
        if event == zmq.EVENT_HANDSHAKE_SUCCEEDED:
            account.fail("strangers", "a key that was just made is let in")
            return
        if event in _FAILED:
            account.hold("strangers")
            return
