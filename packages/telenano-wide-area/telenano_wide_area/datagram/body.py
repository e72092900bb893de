"""The content of a sealed datagram: a report to the sender of the other direction, and samples, the newest first.

Samples are deflated with a dictionary of the bytes that they have in common: 60 to 110 bytes instead of 250 to 300. A
short report is the time of sending alone, with its highest bit set.
"""

import struct
import zlib
from collections.abc import Sequence
from typing import NamedTuple

import msgpack

from telenano.wire import TOPICS
from telenano_wide_area.datagram.sealing import OVERHEAD_BYTES
from telenano_wide_area.sealed import MOST_BYTES, RejectedError

# The order is that of their numbers on the wire, so new topics are added at the end.
DATAGRAM_TOPICS = ("teleop/forward", "teleop/backward", "law/status")
DATAGRAMS_OF = {
    way: tuple(topic for topic in DATAGRAM_TOPICS if TOPICS[topic].bridged == way) for way in ("forward", "backward")
}
NUMBERS = {topic: number for number, topic in enumerate(DATAGRAM_TOPICS)}
_FRAMES = tuple(topic.encode() for topic in DATAGRAM_TOPICS)
# A full report, and a short one, which is the time of sending alone.
REPORT = struct.Struct("!QQQQQ")
SHORT_REPORT = struct.Struct("!Q")
SAMPLE = struct.Struct("!BH")
# Times [ns] and counts below this (the year 2116) leave room in 64 bits for the difference of any two of them.
BOUND = 2**62
_SHORT = 2**63
# The room for samples in a datagram.
MOST_SAMPLE_BYTES = MOST_BYTES - OVERHEAD_BYTES - REPORT.size
# The mark of a train, by which the receiver measures the capacity of the line. A mark takes the place of a sample and
# carries no data.
TRAIN = 0xFE
# The mark of a train that asks the receiver for a train in return.
ASKING_TRAIN = 0xFD
# The mark that carries the measured capacity of the line on which the other end sends [bit/s].
CARRIES = 0xFC
# Raw deflate with a window of 4 KiB, which costs little memory and is more than any sample has.
_WINDOW_BITS = -12
_MOST_INFLATED = 4096


def _dictionary() -> bytes:
    """Return the bytes that samples have in common; they are part of the wire format and do not follow the models."""
    head = {"hand_seq": 0, "hand_t_ns": 0, "seq": 0, "t_ns": 0, "src": ""}
    law = "virtual_impedance model_mediated position_force smith tactile wave passivity"
    zeros = [0.0, 0.0, 0.0]
    kinetic = {"position_m": zeros, "velocity_m_per_s": zeros, "force_n": zeros, "wave_sqrt_w": None, "energy_j": 0.0}
    status = {
        **{"seq": 0, "t_ns": 0, "src": "controller@slave", "v": 1, "law": "", "switching": False},
        **{"port_energy_j": 0.0, "port_power_w": 0.0, "net_valid": True, "net_energy_j": 0.0, "left_j": 0.0},
        **{"dissipated_j": 0.0, "passive": True, "saved_percent": 0.0, "round_trip_s": 0.0},
    }
    forward = {**head, "src": "controller@master", "v": 1, "law": law, "active": True, **kinetic, "wave_sqrt_w": zeros}
    tip = {"separation_m": 0.0, "separation_valid": True, "in_contact": True}
    backward = {**head, "src": "controller@slave", "v": 1, "law": "passivity", "active": True, **kinetic, **tip}
    return b"".join(bytes(msgpack.packb(fields)) for fields in (status, forward, backward))


DICTIONARY = _dictionary()


class Report(NamedTuple):
    """The report in a datagram.

    `sent_ns`: the time of sending, by the sender's clock. `heard_sent_ns`, `heard_ns`: the `sent_ns` of the newest
    datagram of the other direction, and the time of its arrival by this sender's clock (0 if none has arrived).
    `expected`, `arrived`: the number of datagrams of the other direction that were sent up to the newest that arrived,
    and the number that arrived.
    """

    sent_ns: int
    heard_sent_ns: int
    heard_ns: int
    expected: int
    arrived: int


class Body(NamedTuple):
    """The content of a datagram: its report, its samples (topic, payload), and the marks among them (such as `TRAIN`).

    `carries` is the capacity of the line from here as the other end measured it [bit/s], 0 if the body does not state
    it.
    """

    report: Report
    samples: Sequence[tuple[bytes, bytes]]
    marks: Sequence[int]
    carries: int = 0


def short_report(sent_ns: int) -> bytes:
    """Return a report with the time of sending alone [ns]."""
    return SHORT_REPORT.pack(_SHORT | sent_ns)


def packed(topic: str, payload: bytes) -> bytes:
    """Return a sample as it stands in a body: number of the topic, length, deflated payload."""
    deflate = zlib.compressobj(1, zlib.DEFLATED, _WINDOW_BITS, 9, zlib.Z_DEFAULT_STRATEGY, DICTIONARY)
    deflated = deflate.compress(payload) + deflate.flush()
    return SAMPLE.pack(NUMBERS[topic], len(deflated)) + deflated


def mark(number: int, content: bytes = b"") -> bytes:
    """Return a mark as it stands in a body, followed by its content or by padding."""
    return SAMPLE.pack(number, len(content)) + content


def _inflated(data: bytes) -> bytes:
    inflate = zlib.decompressobj(_WINDOW_BITS, DICTIONARY)
    try:
        payload = inflate.decompress(data, _MOST_INFLATED)
    except zlib.error:
        raise RejectedError("malformed") from None
    if not inflate.eof or inflate.unused_data:
        # The data is cut short, inflates to more than any sample has, or is followed by further bytes.
        raise RejectedError("malformed")
    return payload


def parse(body: bytes) -> Body:
    """Return the content of a body.

    Raises:
        RejectedError: The bytes are no body (`malformed`), or the report has a time (`time`) or a count (`count`) that
            no sender can have. The check matters because an authentic sender may be wrong too, and its figures are
            added up here.
    """
    if is_short := len(body) >= SHORT_REPORT.size and body[0] >= 0x80:
        report = Report(SHORT_REPORT.unpack_from(body)[0] - _SHORT, 0, 0, 0, 0)
    elif len(body) >= REPORT.size:
        report = Report(*REPORT.unpack_from(body))
    else:
        raise RejectedError("malformed")
    if max(report.sent_ns, report.heard_sent_ns, report.heard_ns) >= BOUND:
        raise RejectedError("time")
    if not report.arrived <= report.expected < BOUND:
        raise RejectedError("count")
    samples: list[tuple[bytes, bytes]] = []
    marks: list[int] = []
    carries = 0
    place = SHORT_REPORT.size if is_short else REPORT.size
    while place < len(body):
        if place + SAMPLE.size > len(body):
            raise RejectedError("malformed")
        number, length = SAMPLE.unpack_from(body, place)
        place += SAMPLE.size + length
        if place > len(body):
            raise RejectedError("malformed")
        if number >= CARRIES:
            marks.append(number)
            content = body[place - length : place]
            if number == CARRIES:
                # Some ends put further figures behind the capacity.
                carries = int.from_bytes(content[:8], "big")
                if carries >= BOUND:
                    raise RejectedError("count")
            continue
        if number >= len(DATAGRAM_TOPICS):
            raise RejectedError("malformed")
        samples.append((_FRAMES[number], _inflated(body[place - length : place])))
    return Body(report, samples, marks, carries)
