"""The files of a session that a schedule of faults has made, read without the code of the project.

Times are those of the rig since its start [s].
"""

import contextlib
import io
import json
import struct
import zlib
from bisect import bisect_right
from collections import defaultdict
from pathlib import Path
from typing import Any, NamedTuple

import msgpack
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.records import Channel, Chunk, Statistics
from mcap.stream_reader import StreamReader, get_chunk_data_stream
from zstandard import ZstdError

HAND, TIP, LINK = "haptic_node@master", "afm_node@slave", "delay_node@master"
# Tolerance for late turns and ways within a site [s].
LATE_S = 0.0035
# Time after which the link knows a change of the line's delay [s].
KNOWN_S = 3.0
# Heads of a record and of a message in a chunk, and opcodes: the library takes ten times as long for each message.
RECORD, MESSAGE, CHANNEL_RECORD, MESSAGE_RECORD = struct.Struct("<BQ"), struct.Struct("<HIQQ"), 4, 5
Fields = dict[str, Any]


class Seen(NamedTuple):
    """A message of a file: its channel and fields, the time of sending [s], and whether it is unchanged."""

    channel: str
    topic: str
    via: str
    fields: Fields
    sent_s: float
    whole: bool

    @property
    def depth_m(self) -> float:
        return -float(self.fields["base_position_m"][2])


class TipStep(NamedTuple):
    """A step of the instrument: its time [s], the base it was told [m], and what it gave: base [m], force [N], state.

    again: whether the process has made a step before this one.
    """

    at_s: float
    told_m: float
    base_m: float
    force_n: float
    status: str
    valid: bool
    again: bool


class HandStep(NamedTuple):
    """A step of the hand's device: its time [s], the mode (0: off) and reference [m] that it was told, and its reading.

    again: whether the process has made a step before this one.
    """

    at_s: float
    mode: int
    reference_m: float
    position_m: float
    motor_n: float
    again: bool


class Break(NamedTuple):
    """A broken invariant: its name, the time [s], and a sentence."""

    invariant: str
    at_s: float
    text: str


class Session:
    """The files of a session."""

    def __init__(self, folder: Path) -> None:
        self.schedule: Fields = json.loads((folder / "schedule.json").read_text())
        self.history: Fields = json.loads((folder / "history.json").read_text())
        self.verdict: Fields = json.loads((folder / "verdict.json").read_text())
        self.acts: list[Fields] = [{**act, "at_s": act["t_ns"] * 1e-9} for act in self.history["acts"]]
        self.epoch_ns: int = self.history["epoch_ns"]
        # Time of sending and checksum of each message; times, numbers and stamps of each publisher and topic.
        self.ledger: dict[tuple[str, str, int, int], tuple[float, int]] = {}
        self.sent: dict[tuple[str, str], list[tuple[float, int, int]]] = defaultdict(list)
        newest_ns = defaultdict[str, int](int)  # The ledger is in the order of sending; a turn has one time.
        for src, topic, seq, t_ns, sent_ns, crc in msgpack.unpackb((folder / "ledger.msgpack").read_bytes()):
            newest_ns[src] = max(sent_ns, newest_ns[src] + 1)
            self.ledger[src, topic, seq, t_ns] = newest_ns[src] * 1e-9, crc
            self.sent[src, topic].append((newest_ns[src] * 1e-9, seq, t_ns))
        self.tip_steps, self.hand_steps = list[TipStep](), list[HandStep]()
        started = {key: [act["at_s"] for act in self.acts if act.get("node") == key] for key in (HAND, TIP)}
        last_s = {HAND: -1.0, TIP: -1.0}
        for device, t_ns, *told in msgpack.unpackb((folder / "world.msgpack").read_bytes()):
            key, at_s = (HAND if device == "hand" else TIP), t_ns * 1e-9
            again = not any(last_s[key] < one_s <= at_s for one_s in started[key])
            last_s[key] = at_s
            if key == HAND:
                self.hand_steps.append(HandStep(at_s, *told, again))
            else:
                self.tip_steps.append(TipStep(at_s, *told, again))
        self.seen, self.statistics = list[Seen](), list[tuple[str, int, int]]()
        for site, place in (("master", folder), ("slave", folder / "far")):
            for path in sorted(place.glob("session*.mcap")):
                # A cut file is read up to the cut.
                with contextlib.suppress(McapError, EOFError, ValueError, ZstdError, struct.error):
                    self._read(site, path)
        self.direct: dict[tuple[str, str], list[Seen]] = defaultdict(list)
        for one in sorted([one for one in self.seen if one.via == "direct"], key=lambda one: one.sent_s):
            self.direct[one.fields.get("src", ""), one.topic].append(one)
        self.happened = [{**act["event"], "at_s": act["at_s"]} for act in self.acts if act["what"] == "event"]
        self.end_s: float = next(act["at_s"] for act in self.acts if act["what"] == "end")
        self.grain_s: float = 2.0 / self.schedule["rate_hz"] + LATE_S
        self.laws = {self.schedule["law"], *(one["law"] for one in self.events("law"))}

    def _read(self, site: str, path: Path) -> None:
        channels, begun = dict[int, Channel](), len(self.seen)
        for record in StreamReader(io.BytesIO(path.read_bytes()), emit_chunks=True).records:
            if isinstance(record, Statistics):
                self.statistics.append((f"{site} {path.name}", record.message_count, len(self.seen) - begun))
            if not isinstance(record, Chunk):
                continue
            data, end = get_chunk_data_stream(record)[0].read(record.uncompressed_size), 0
            while end < len(data):
                (opcode, size), start = RECORD.unpack_from(data, end), end + RECORD.size
                end = start + size
                if opcode == CHANNEL_RECORD:
                    channel = Channel.read(ReadDataStream(io.BytesIO(data[start:end])))
                    channels[channel.id] = channel
                elif opcode == MESSAGE_RECORD:
                    number, _, log_ns, _ = MESSAGE.unpack_from(data, start)
                    payload, channel = data[start + MESSAGE.size : end], channels[number]
                    fields, topic = msgpack.unpackb(payload), channel.metadata["topic"]
                    key = (fields.get("src"), topic, fields.get("seq"), fields.get("t_ns"))
                    (sent_s, crc), via = self.ledger.get(key, (log_ns * 1e-9, -1)), channel.metadata["via"]
                    self.seen.append(Seen(channel.topic, topic, via, fields, sent_s, crc == zlib.crc32(payload)))

    def events(self, *kinds: str) -> list[Fields]:
        return [event for event in self.happened if event["kind"] in kinds]

    def way_s(self, way: str, at_s: float) -> float:
        """Return the longest delay that the link may know: its own, the line's, and that of a queue that stood [s]."""
        steps = [(e["at_s"], e[f"{way}_s"]) for e in self.events("delay") if e["at_s"] <= at_s]
        # Delays that the link may consider as present: all since the newest one that it must know by now.
        known = sum(begun <= at_s - KNOWN_S for begun, _ in steps)
        line_s = [delay_s for _, delay_s in [(0.0, self.schedule["delay_s"]), *steps][known:]]
        own_s = [self.schedule["link_s"], *(e["delay_s"] for e in self.events("link") if e["at_s"] <= at_s)]
        queues_s = [wait_s for stood_s, wait_s in self.history["stood"][way] if at_s - KNOWN_S <= stood_s <= at_s]
        return float(max(line_s) + max(own_s) + max(queues_s, default=0.0))

    def trip_s(self, at_s: float) -> float:
        return sum(self.way_s(way, at_s) for way in ("forward", "backward"))

    def missing(self, src: str, topic: str) -> list[float]:
        have = {(one.fields["seq"], one.fields["t_ns"]) for one in self.direct[src, topic]}
        return [sent_s for sent_s, seq, t_ns in self.sent[src, topic] if (seq, t_ns) not in have]


class Newest:
    def __init__(self, messages: list[Seen]) -> None:
        self._messages, self._times = messages, [one.sent_s for one in messages]

    def at(self, at_s: float) -> Seen | None:
        return self._messages[place - 1] if (place := bisect_right(self._times, at_s)) else None

    def time_of(self, at_s: float) -> float:
        return -1e9 if (newest := self.at(at_s)) is None else newest.sent_s

    def mode(self, at_s: float, within_s: float) -> str:
        newest = self.at(at_s)
        return "silent" if newest is None or at_s - newest.sent_s > within_s else str(newest.fields["mode"])

    def between(self, from_s: float, to_s: float) -> list[Seen]:
        return self._messages[bisect_right(self._times, from_s) : bisect_right(self._times, to_s)]
