"""What is inside a sealed datagram: a report to the sender of the other direction, and samples, the newest first."""

import struct
from collections.abc import Sequence
from typing import NamedTuple

from proto import TOPICS
from services.runtime.datagram.sealing import MOST_BYTES, OVERHEAD_BYTES, RejectedError

# The order is that of their numbers on the wire, so new topics are added at the end.
DATAGRAM_TOPICS = ("teleop/forward", "teleop/backward", "law/status")
DATAGRAMS_OF = {
    way: tuple(topic for topic in DATAGRAM_TOPICS if TOPICS[topic].bridged == way) for way in ("forward", "backward")
}
NUMBERS = {topic: number for number, topic in enumerate(DATAGRAM_TOPICS)}
_FRAMES = tuple(topic.encode() for topic in DATAGRAM_TOPICS)
REPORT = struct.Struct("!QQQQQ")
SAMPLE = struct.Struct("!BH")
# Times [ns] and counts below this (the year 2116) leave room in 64 bits for the difference of any two of them.
BOUND = 2**62
# A datagram has so much room for samples.
MOST_SAMPLE_BYTES = MOST_BYTES - OVERHEAD_BYTES - REPORT.size


class Report(NamedTuple):
    """What a datagram says beside its samples.

    `sent_ns`: when it was sent, by its sender's clock; `heard_sent_ns`, `heard_ns`: of the newest datagram of the other
    direction its own `sent_ns`, and when it arrived, by this sender's clock (0: none did); `expected`, `arrived`: how
    many datagrams of the other direction had been sent up to the newest that arrived, and how many had arrived.
    """

    sent_ns: int
    heard_sent_ns: int
    heard_ns: int
    expected: int
    arrived: int


def packed(topic: str, payload: bytes) -> bytes:
    """Return a sample as it stands in a body."""
    return SAMPLE.pack(NUMBERS[topic], len(payload)) + payload


def parse(body: bytes) -> tuple[Report, Sequence[tuple[bytes, bytes]]]:
    """Return report and samples (topic, payload) of a body.

    Raises:
        RejectedError: It is no body (`malformed`), or its report has a time (`time`) or a count (`count`) that no
            sender can have. An authentic sender may be wrong as well, and its figures are summed up here.
    """
    if len(body) < REPORT.size:
        raise RejectedError("malformed")
    report = Report(*REPORT.unpack_from(body))
    if max(report.sent_ns, report.heard_sent_ns, report.heard_ns) >= BOUND:
        raise RejectedError("time")
    if not report.arrived <= report.expected < BOUND:
        raise RejectedError("count")
    samples = []
    place = REPORT.size
    while place < len(body):
        if place + SAMPLE.size > len(body):
            raise RejectedError("malformed")
        number, length = SAMPLE.unpack_from(body, place)
        place += SAMPLE.size + length
        if number >= len(DATAGRAM_TOPICS) or place > len(body):
            raise RejectedError("malformed")
        samples.append((_FRAMES[number], body[place - length : place]))
    return report, samples
