"""Recordings of what a link says of two clocks, from a course of the slave's clock that the test knows."""

import random
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import msgspec

from telenano.recording.writer import FileSettings, RecordingWriter
from telenano.testing.filled_messages import examples
from telenano.timing.clock_offset import OffsetFilter
from telenano.wire import encode
from telenano.wire.topics import TOPICS

BEGAN_NS, NS = 1_750_000_000_000_000_000, 1_000_000_000
LINK, TIP = "delay_node@master", "afm_node@slave"
Course = Callable[[float], float]


class Case(NamedTuple):
    """What the slave's clock is ahead [s] at a time [s], and the times at which it or the site was away."""

    ahead_s: Course
    pauses: tuple[tuple[float, float], ...] = ()
    queue_s: Course = lambda time_s: 0.0


def write(case: Case, folder: Path, length_s: float) -> Path:
    """Write what a link over ways of 20 ms with asymmetric jitter says of the clocks, four times a second."""
    draw = random.Random(3)
    found = OffsetFilter(64)
    writer = RecordingWriter.create("recorder@master", FileSettings(directory=folder, file_name="clocks.mcap"))
    writer.add_metadata("recording", {"node": "recorder@master"})
    channels = {
        topic: writer.channel(topic, src, src.partition("@")[2])
        for topic, src in (("clock/pong", TIP), ("link/status", LINK))
    }
    pong = examples(TOPICS["clock/pong"])["ordinary"]
    status = examples(TOPICS["link/status"])["ordinary"]
    for seq in range(round(4 * length_s)):
        asked_s = 0.25 * seq
        if any(begin_s <= asked_s < end_s for begin_s, end_s in case.pauses):
            continue
        arrived_s = asked_s + 0.02 + draw.expovariate(200.0) + case.queue_s(asked_s)
        back_s = arrived_s + 1e-4 + 0.02 + 2e-4 * draw.random()
        asked_ns, there_ns = (BEGAN_NS + round(at_s * NS) for at_s in (asked_s, arrived_s + case.ahead_s(arrived_s)))
        back_ns = BEGAN_NS + round(back_s * NS)
        found.record(asked_ns, there_ns, there_ns + 100_000, back_ns)
        rows = [("clock/pong", TIP, there_ns + 100_000, pong, {"ping_t_ns": asked_ns, "received_ns": there_ns})]
        if (seq % 4 == 0 or any(end_s <= asked_s < end_s + 0.25 for _, end_s in case.pauses)) and (
            estimate := found.estimate()
        ) is not None:
            clock = msgspec.structs.replace(status.clock, **estimate._asdict(), valid=True)
        answer = {"answer_sent_ns": there_ns + 100_000, "answer_received_ns": back_ns}
        rows.append(("link/status", LINK, back_ns + 1000, status, {"clock": clock, **answer}))
        for topic, src, t_ns, example, fields in rows:
            message = msgspec.structs.replace(example, seq=seq, t_ns=t_ns, src=src, **fields)
            writer.write(channels[topic], back_ns + 2000, t_ns, seq, encode(message))
    writer.finish()
    return folder / "clocks.mcap"
