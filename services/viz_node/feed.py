"""Data for the pages: the changes since the last transmission, and a snapshot for a page that opens later."""

from collections import deque
from collections.abc import Mapping
from typing import Any, NamedTuple

import msgpack

from services.viz_node.streams import BY_SOURCE, LATEST_NS, STREAMS, Batch, LinkLoss
from telenano.extend.advice import ADVICE
from telenano.recording.messages import LeftOut
from telenano.serving.panels import installed_panels
from telenano.wire import Message
from telenano.wire.codec import fields_of
from telenano.wire.ends import read_end
from telenano.wire.nodes import site_of
from telenano.wire.sequence import total

# Most samples sent at once, a second of the loop: more would block the page, and would be old anyway.
_MOST_SAMPLES = 1000
_EVENTS_KEPT = 60
_MOST_LINES = 4096
_MOST_NODES = 64
_MOST_STATES = 64
# Greatest size of the facts of one node, state or event [bytes].
_MOST_BYTES = 1 << 16
# Greatest size of a line of an image [bytes].
_MOST_LINE_BYTES = 1 << 20
# Greatest size of all stored lines together [bytes].
_MOST_IMAGE_BYTES = 1 << 26
HEALTH_KEYS = ("state", "uptime_s", "rate_hz", "overruns", "cpu_percent", "memory_bytes", "replay", "lateness_p99_s")
# Keys in the health of a node whose guard limits the force on the tip, or the travel of the hand.
_GUARD_KEYS = ("force_limit_n", "travel_m")
_STATE_KEYS = {
    "haptic/state": ("mode", "estop", "limited", "session_s"),
    "afm/state": ("mode", "limited", "in_contact", "meniscus"),
    "afm/program": ("program", "state", "text", "done_percent", "line", "lines", "values"),
    "law/status": ("law", "switching", "passive", "heard", "silence_s", "dissipated_j", "left_j"),
}
# Keys that a state may lack: the limit that is acting, and what the hand feels where that is no force.
_KEYS_IF_THERE = ("limited_by", "felt_channel", "felt_clamp")
# Return of a tip that was armed at its place: digits of a resolution that a page can show, 0.1 nm, 1 pm/s and 0.1 s.
_RETURN_DIGITS = {"return_place_m": 10, "return_speed_m_per_s": 12, "return_s": 1, "offset_m": 10}
# Digits of times that change with each sample, so that they are sent only when the shown value changes.
_COARSE = {"session_s": 1, "silence_s": 1, "uptime_s": 0}
# Keys that a message may lack.
_OPTIONAL = frozenset({"values"})
_WAY_KEYS = ("profile", "settings", "queue_depth", "delay_mean_s", "delay_max_s", "delay_valid", "dropped")


class SeenMessage(NamedTuple):
    """A message: topic, publisher, time of sending [ns], and its fields, which were checked against its model."""

    topic: str
    src: str
    t_ns: int
    fields: Mapping[str, Any]


def seen(topic: str, src: str, t_ns: int, message: Message) -> SeenMessage:
    """Return a checked message in the form that a feed records."""
    return SeenMessage(topic, src, t_ns, fields_of(message))


class Feed:
    """Collects messages, and returns the changes since the last call.

    Messages that cannot be shown, such as one with a time that no page can draw, are counted in `left_out`.
    """

    def __init__(self) -> None:
        self.origin_ns = 0
        self.left_out = LeftOut()
        self._batches = {stream.name: Batch(stream, _MOST_SAMPLES) for stream in STREAMS}
        self._nodes: dict[str, dict[str, Any]] = {}
        self._state: dict[str, dict[str, Any]] = {}
        self._events: deque[dict[str, Any]] = deque(maxlen=_EVENTS_KEPT)
        self._lines: dict[tuple[str, int], dict[str, Any]] = {}
        self._line_bytes = 0
        self._changes: dict[str, Any] = {}
        # Offset of the clock of the slave's machine, as measured by the link; positive if it is ahead.
        self._slave_ahead_ns = 0
        # Newest force that the hand is shown, towards the sample [N], and when it was sent [ns]; None before the first.
        self.felt: tuple[float, int] | None = None
        self._loss = LinkLoss()
        self._of_panels = installed_panels().topics

    def record(self, seen: SeenMessage) -> None:
        """Record a message."""
        if self.left_out.guard(self._record, seen) and not self.origin_ns:
            self.origin_ns = self._changes["origin_ns"] = seen.t_ns

    def take(self) -> dict[str, Any]:
        """Return the changes since the last call; empty if there are none."""
        changes, self._changes = self._changes, {}
        streams = {name: taken for name, batch in self._batches.items() if (taken := batch.take(self.origin_ns))}
        return {**changes, "streams": streams} if streams else changes

    def snapshot(self) -> dict[str, Any]:
        """Return the whole state for a new page; its curves begin with the next changes."""
        return {
            "origin_ns": self.origin_ns,
            "nodes": dict(self._nodes),
            "state": dict(self._state),
            "events": list(self._events),
            "lines": list(self._lines.values()),
        }

    def state(self, name: str) -> Mapping[str, Any]:
        """Return the newest facts that pages have of a state; empty before the first message."""
        return self._state.get(name, {})

    def _record(self, seen: SeenMessage) -> None:
        if not 0 <= seen.t_ns < LATEST_NS:
            raise ValueError(f"t_ns {seen.t_ns}: is not a time")
        site = site_of(seen.src)
        stream = BY_SOURCE.get((seen.topic, site))
        if stream is not None:
            ahead_ns = self._slave_ahead_ns if stream.site == "slave" else 0
            fields = self._loss.added(seen.fields) if stream.name == "link" else seen.fields
            self._batches[stream.name].add(seen.t_ns - ahead_ns, fields)
            if stream.name == "command":
                self.felt = float(seen.fields["force_n"][2]), seen.t_ns
        if keys := _STATE_KEYS.get(seen.topic):
            further = {key: value for key in _KEYS_IF_THERE if (value := seen.fields.get(key)) is not None}
            back = {
                key: round(value, n) for key, n in _RETURN_DIGITS.items() if (value := seen.fields.get(key)) is not None
            }
            self._set_state(f"{seen.topic}/{site}", _facts(seen.fields, keys) | further | back)
        elif seen.topic == "link/status":
            ways = {way: _facts(seen.fields[way], _WAY_KEYS) for way in ("forward", "backward")}
            clock = seen.fields["clock"]
            is_apart = clock["valid"] and abs(clock["offset_s"]) > clock["uncertainty_s"]
            self._slave_ahead_ns = round(clock["offset_s"] * 1e9) if is_apart else 0
            self._set_state("link", {**ways, "clock": dict(clock)})
        elif seen.topic == "link/network":
            queue_s, carries = seen.fields.get("queue_s"), seen.fields.get("capacity_bit_per_s")
            facts = {"queue_s": None if queue_s is None else round(queue_s, 3), "capacity_bit_per_s": carries}
            # These two describe the other direction, in which this end sends.
            facts["sends"] = seen.fields.get("line")
            facts["blocked_since_ns"] = seen.fields.get("blocked_since_ns")
            self._set_state(f"line/{seen.fields['direction']}", facts)
        elif seen.topic == "node/health":
            self._record_health(seen)
        elif seen.topic == "session/event":
            self._record_event(seen)
        elif of_panel := self._of_panels.get(seen.topic):
            self._set_state(seen.topic, {key: seen.fields[key] for key in of_panel})
        elif seen.topic == "afm/scanline":
            self._record_line(seen)

    def _set_state(self, name: str, facts: dict[str, Any]) -> None:
        if self._state.get(name) != facts:
            if name not in self._state and len(self._state) >= _MOST_STATES:
                raise ValueError(f"{name}: more than {_MOST_STATES} states are not kept")
            _check({name: facts}, _MOST_BYTES)
            self._state[name] = facts
            self._changes.setdefault("state", {})[name] = facts

    def _record_health(self, seen: SeenMessage) -> None:
        if seen.src not in self._nodes and len(self._nodes) >= _MOST_NODES:
            return
        facts = _facts(seen.fields, HEALTH_KEYS)
        inputs = seen.fields["inputs"]
        facts["lost"] = total(row["lost"] for row in inputs)
        facts["rejected"] = total(n for reason, n in seen.fields["rejected"].items() if reason != "superseded")
        facts["beat"] = seen.t_ns
        if (mates := seen.fields.get("shares_with")) is not None:
            facts["shares_with"] = list(mates)
        facts |= {key: limit for key in _GUARD_KEYS if (limit := seen.fields.get(key)) is not None}
        self._set_node(seen.src, facts)

    def _record_event(self, seen: SeenMessage) -> None:
        event = _facts(seen.fields, ("kind", "level", "text")) | {
            "src": seen.src,
            "t": seen.t_ns,
            "seq": seen.fields["seq"],
        }
        data = seen.fields.get("data", {})
        if data.get(ADVICE) is True:
            # The law concerned, if the adviser names one.
            event["advises"] = str(data.get("law", ""))
        if read_end(seen.fields) is not None and seen.src in self._nodes:
            self._set_node(seen.src, {**self._nodes[seen.src], "state": "ended", "beat": seen.t_ns})
        _check(event, _MOST_BYTES)
        self._events.append(event)
        self._changes.setdefault("events", []).append(event)

    def _set_node(self, src: str, facts: dict[str, Any]) -> None:
        _check({src: facts}, _MOST_BYTES)
        self._nodes[src] = facts
        self._changes.setdefault("nodes", {})[src] = facts

    def _record_line(self, seen: SeenMessage) -> None:
        fields = seen.fields
        line = _facts(fields, ("line", "lines", "direction", "start_m", "end_m"))
        line["height"] = dict(fields["height_m"])
        size = _check(line, _MOST_LINE_BYTES)
        number = int(line["line"])
        if number == 0:
            # A new image begins.
            self._lines = {key: kept for key, kept in self._lines.items() if key[0] != line["direction"]}
            self._line_bytes = sum(_check(kept, _MOST_LINE_BYTES) for kept in self._lines.values())
        if len(self._lines) < _MOST_LINES and self._line_bytes + size <= _MOST_IMAGE_BYTES:
            # A repeated line counts twice, so the sum is never below the size of the stored lines.
            self._lines[str(line["direction"]), number] = line
            self._line_bytes += size
        self._changes.setdefault("lines", []).append(line)


def _check(facts: Mapping[str, Any], most: int) -> int:
    """Return the size of facts for a page [bytes]; raise ValueError if it exceeds `most`."""
    size = len(msgpack.packb(facts))
    if size > most:
        raise ValueError(f"a message has {size} bytes for the page, {most} may be")
    return size


def _facts(fields: Mapping[str, Any], keys: tuple[str, ...]) -> dict[str, Any]:
    facts = {key: fields[key] for key in keys if key not in _OPTIONAL or key in fields}
    for key, digits in _COARSE.items():
        if key in facts:
            facts[key] = round(facts[key], digits)
    return facts
