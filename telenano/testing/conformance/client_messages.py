"""Checks of a client's messages: frames, keys, types, numbers and times, without a socket."""

from collections.abc import Sequence
from fnmatch import fnmatchcase
from typing import Any, NamedTuple

import msgpack
import msgspec

from telenano.testing.conformance.rules import Account
from telenano.wire import TOPICS, decode, keys_twice

_S = 1_000_000_000
_CLOCK_NS = _S
_HEADER = ("seq", "t_ns", "src", "v")
# The rule for each reason for which the codec refuses bytes.
_REASONS = {"oversized": "size", "malformed": "msgpack", "newer_version": "version"}
_UNITS = {1: "s", 1_000: "ms", 1_000_000: "us"}
# Topics that say whether the hand was armed in the sample that they descend from.
_BEHIND_THE_HAND = ("teleop/forward", "afm/command")
# Topics of sources that need no loop, because they send only on change.
NO_NODES = ("session/control", "operator/force", "experiment/answer")
# Most observed streams, so that a client with made-up names of sources cannot fill the memory; usual are some tens.
_MOST_STREAMS = 1000
_LONGEST_SOURCE = 100
_RULE_OF_FAULT = {
    "missing": "required keys",
    "unknown": "further keys",
    "type": "types",
    "record": "types",
    "word": "words",
    "bounds": "ranges",
    "range": "ranges",
}
_CONTENT = tuple(dict.fromkeys(_RULE_OF_FAULT.values()))


def required_keys(topic: str) -> set[str]:
    """Return the keys that every message of a topic has; raise KeyError for an unknown topic."""
    return {field.name for field in msgspec.structs.fields(TOPICS[topic].model) if field.required}


class ClientMessage(NamedTuple):
    """A readable message of the client."""

    topic: str
    fields: dict[str, Any]


class _Stream:
    """The messages of a topic from a source."""

    def __init__(self, seq: int, t_ns: int, now_ns: int) -> None:
        self.seq, self.t_ns, self.now_ns, self.count, self.ended = seq, t_ns, now_ns, 1, False


class MessageExaminer:
    """Examines each message on its own, and the sequence of messages of each topic and source.

    Args:
        account: Records the findings.
        is_hand: Whether the client reads only the hand of the kit, which is never armed.
    """

    def __init__(self, account: Account, *, is_hand: bool = False) -> None:
        self._account, self._is_hand = account, is_hand
        # For each hand, whether the newest command that it acknowledged was an arm and not an emergency stop.
        self._is_armed: dict[str, bool] = {}
        # For each hand, whether it last reported itself as armed.
        self._says_armed: dict[str, bool] = {}
        self._streams: dict[tuple[str, str], _Stream] = {}
        self._first_ns: dict[str, int] = {}
        self.received = 0

    def take(self, frames: Sequence[bytes], now_ns: int) -> ClientMessage | None:
        """Examine the frames received at a time [ns since 1970]; return the message, or None if it is unreadable."""
        self.received += 1
        account = self._account
        if len(frames) != 2:
            account.fail("frames", f"a message has {len(frames)} frame{'s' * (len(frames) != 1)}")
            return None
        topic = self._topic(*frames)
        fields = None if topic is None else self._fields(topic, frames[1])
        if topic is None or fields is None:
            return None
        if all(self._header_is_whole(topic, fields)) and self._is_followed(topic, fields["src"]):
            self._publisher(topic, fields["src"])
            self._version(topic, fields)
            self._arming(topic, fields)
            self._course(topic, fields, now_ns)
        return ClientMessage(topic, fields)

    @property
    def has_ended(self) -> bool:
        """Whether each node has sent its last message, which a console or an emergency stop has none of."""
        return all(stream.ended for (topic, _), stream in self._streams.items() if topic not in NO_NODES)

    def _is_followed(self, topic: str, src: str) -> bool:
        """Return whether a stream is observed; the number of streams is limited."""
        if len(src) <= _LONGEST_SOURCE and ((topic, src) in self._streams or len(self._streams) < _MOST_STREAMS):
            return True
        self._account.fail("publisher", f"more than {_MOST_STREAMS} sources send, or one has a name that is too long")
        return False

    def end(self, now_ns: int) -> None:
        """Check at the end of the examination [ns since 1970] that no message is missing."""
        for (topic, src), stream in self._streams.items():
            self._pause(topic, src, now_ns - stream.now_ns, stream)
        for src, armed in self._says_armed.items():
            if self._is_armed.get(src) and not armed:
                text = f"{src} has acknowledged an arm, and does not say that it is armed: no tip follows it"
                self._account.fail("armed hand", text)
        nodes = {src for topic, src in self._streams if topic not in NO_NODES}
        for src in sorted(nodes):
            health = self._streams.get(("node/health", src))
            if health is None and now_ns - self._first_ns[src] > 2 * _S:
                self._account.fail("health", f"{src} sends no node/health")

    def _topic(self, topic: bytes, payload: bytes) -> str | None:
        account = self._account
        try:
            name = topic.decode()
        except UnicodeDecodeError:
            name = ""
        if name in TOPICS:
            account.hold("frames", "topic")
            return name
        if payload in (row.encode() for row in TOPICS):
            account.fail("frames", f"the first frame is the map, and the topic {payload.decode()} comes behind it")
        else:
            account.fail("topic", f"the topic {topic[:40]!r} is not in the table")
        return None

    def _fields(self, topic: str, payload: bytes) -> dict[str, Any] | None:
        account = self._account
        try:
            decode(topic, payload)
        except ValueError as error:
            if (rule := _REASONS.get(getattr(error, "reason", ""))) is not None:
                account.fail(rule, str(error))
                return None
        account.hold("size")
        try:
            fields: dict[str, Any] = msgpack.unpackb(payload, use_list=False)
            twice = keys_twice(payload)
        except ValueError as error:
            account.fail("msgpack", f"{topic}: {error}")
            return None
        if twice:
            account.fail("msgpack", f"{topic}: a map has a key twice, and a reader takes the last")
        else:
            account.hold("msgpack")
        return fields if self._is_meant(topic, fields) else None

    def _is_meant(self, topic: str, fields: dict[str, Any]) -> bool:
        """Record the faults of the fields; return False if they have the keys of another topic."""
        faults = TOPICS[topic].faults_in(fields)
        if not faults:
            self._account.hold(*_CONTENT)
        is_short = any(fault.kind == "missing" and fault.key in required_keys(topic) for fault in faults)
        other = next((name for name in TOPICS if _has_the_keys(name, fields)), "") if is_short else ""
        if other:
            self._account.fail("topic", f"on {topic} comes a message with the keys of {other}")
            return False
        for fault in faults:
            self._account.fail(_RULE_OF_FAULT[fault.kind], f"{topic}: {fault.text}"[:200])
        return True

    def _header_is_whole(self, topic: str, fields: dict[str, Any]) -> list[bool]:
        types = {"seq": int, "t_ns": int, "src": str, "v": int}
        return [type(fields.get(key)) is types[key] for key in _HEADER]

    def _arming(self, topic: str, fields: dict[str, Any]) -> None:
        """Check the statements on an armed hand, which a tip may follow."""
        src, data = fields["src"], fields.get("data")
        if topic == "session/event" and fields.get("kind") == "ack" and isinstance(data, dict):
            if data.get("command") in ("arm", "estop"):
                self._is_armed[src] = data["command"] == "arm"
        elif topic == "haptic/state":
            self._says_armed[src] = armed = fields.get("armed") is True
            if armed and (fields.get("estop") is True or self._is_armed.get(src) is False):
                self._account.fail("armed hand", f"{src} is armed in emergency stop")
            elif armed:
                self._account.hold("armed hand")
        elif topic in _BEHIND_THE_HAND and self._is_hand and fields.get("hand_armed") is True:
            self._account.fail("armed hand", f"{topic} of {src} is of an armed hand, and the hand was never armed")

    def _publisher(self, topic: str, src: str) -> None:
        publishers = TOPICS[topic].publishers
        name = src.partition("@")[0]
        if any(fnmatchcase(src if "@" in pattern else name, pattern) for pattern in publishers):
            self._account.hold("publisher")
        else:
            self._account.fail("publisher", f"{src} sends on {topic}, which is for {', '.join(publishers)}")

    def _version(self, topic: str, fields: dict[str, Any]) -> None:
        right = TOPICS[topic].model.version
        if fields["v"] == right:
            self._account.hold("version")
        else:
            self._account.fail("version", f"{topic}: v is {fields['v']}, and {right} is its version")

    def _course(self, topic: str, fields: dict[str, Any], now_ns: int) -> None:
        account = self._account
        seq, t_ns, src = fields["seq"], fields["t_ns"], fields["src"]
        self._first_ns.setdefault(src, now_ns)
        self._clock(topic, t_ns, now_ns)
        stream = self._streams.get((topic, src))
        if stream is None:
            self._streams[topic, src] = _Stream(seq, t_ns, now_ns)
        else:
            if seq == stream.seq + 1:
                account.hold("sequence")
            elif seq > stream.seq:
                account.fail("sequence", f"{topic}: {seq - stream.seq - 1} missing between {stream.seq} and {seq}")
            else:
                how = "comes again" if seq == stream.seq else f"goes back to {seq}"
                account.fail("sequence", f"{topic}: seq {stream.seq} {how}")
            if t_ns >= stream.t_ns:
                account.hold("order of time")
            else:
                account.fail("order of time", f"{topic}: t_ns goes back by {(stream.t_ns - t_ns) / _S:.6f} s", topic)
            if stream.ended:
                account.fail("last message", f"{topic}: a message of {src} comes after its last one")
            self._pause(topic, src, now_ns - stream.now_ns, stream)
            stream.seq, stream.t_ns, stream.now_ns = seq, t_ns, now_ns
            stream.count += 1
        if topic == "session/event":
            self._last(fields)

    def _clock(self, topic: str, t_ns: int, now_ns: int) -> None:
        for factor, unit in _UNITS.items():
            if abs(t_ns * (_S // factor) - now_ns) < 3600 * _S:
                self._account.fail("clock", f"{topic}: t_ns is {t_ns}, which is a time in {unit}", topic)
                return
        if abs(t_ns - now_ns) <= _CLOCK_NS:
            self._account.hold("clock")
        else:
            off_s = (t_ns - now_ns) / _S
            way = "ahead of" if off_s > 0 else "behind"
            self._account.fail("clock", f"{topic}: t_ns is {abs(off_s):.3f} s {way} the clock of this machine", topic)

    def _pause(self, topic: str, src: str, pause_ns: int, stream: _Stream) -> None:
        stale_s = TOPICS[topic].deadline_s
        if stale_s is None or stream.ended:
            return
        rule = "health" if topic == "node/health" else "rate"
        if pause_ns > stale_s * _S:
            text = f"{topic} of {src} pauses for {pause_ns / _S:.3f} s, and is stale after {stale_s:g} s"
            self._account.fail(rule, text, f"{topic} {src}")
        elif stream.count > 1:
            self._account.hold(rule)

    def _last(self, fields: dict[str, Any]) -> None:
        data = fields.get("data")
        if not isinstance(data, dict) or fields.get("kind") != "node" or data.get("state") != "ended":
            return
        for (topic, src), stream in self._streams.items():
            if src != fields["src"]:
                continue
            stream.ended = True
            last = data.get(f"sent.{topic}")
            if last == stream.seq + 1:
                self._account.hold("last message")
            else:
                self._account.fail("last message", f"sent.{topic} is {last}, and {stream.seq + 1} were sent")


def _has_the_keys(topic: str, fields: dict[str, Any]) -> bool:
    """Return whether a message has the keys of a topic."""
    return required_keys(topic) <= fields.keys() <= set(TOPICS[topic].model.__struct_fields__)
