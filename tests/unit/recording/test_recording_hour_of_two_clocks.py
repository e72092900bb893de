"""An hour of two clocks in virtual time: stamps of the slave are put on the master's clock within a millisecond."""

import random
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np
import pytest

from telenano.recording.reader import Recording
from telenano.recording.site_clock import read_site_clock
from telenano.recording.writer import FileSettings, RecordingWriter
from telenano.testing.filled_messages import examples
from telenano.timing.clock_offset import OffsetFilter
from telenano.wire import encode
from telenano.wire.topics import TOPICS

BEGAN_NS, NS = 1_750_000_000_000_000_000, 1_000_000_000
HOUR_S = 3600.0
LINK, TIP = "delay_node@master", "afm_node@slave"
Course = Callable[[float], float]


class Case(NamedTuple):
    """What the slave's clock is ahead [s] at a time [s], and the times at which it or the site was away."""

    ahead_s: Course
    pauses: tuple[tuple[float, float], ...] = ()
    queue_s: Course = lambda time_s: 0.0


def drifting(time_s: float) -> float:
    return 5.0 + 5e-4 * time_s


CASES = {
    "500 ppm": Case(drifting),
    "500 ppm slow": Case(lambda time_s: -5e-4 * time_s),
    "20 ppm that become 24": Case(lambda time_s: 5.0 + 2e-5 * time_s + 0.5 * 4e-6 / HOUR_S * time_s**2),
    "500 ppm and a pause of a minute": Case(drifting, ((1200.0, 1260.0),)),
    "set forward by 0.2 s": Case(lambda time_s: drifting(time_s) + 0.2 * (time_s >= 1777.0), ((1776.0, 1780.0),)),
    "set back by 3 s": Case(lambda time_s: drifting(time_s) - 3.0 * (time_s >= 2010.0), ((2003.0, 2010.0),)),
    "set twice": Case(
        lambda time_s: drifting(time_s) + 0.5 * (time_s >= 800.0) - 0.5 * (time_s >= 900.0),
        ((798.0, 800.0), (898.0, 901.0)),
    ),
    "500 ppm and a queue that fills and empties": Case(drifting, (), lambda time_s: 0.005 * (time_s % 600.0) / 600.0),
}


def write(case: Case, folder: Path) -> Path:
    """Write what a link over ways of 20 ms with asymmetric jitter says of the clocks, ten times a second."""
    draw = random.Random(3)
    found = OffsetFilter(64)
    writer = RecordingWriter.create("recorder@master", FileSettings(directory=folder, file_name="hour.mcap"))
    writer.add_metadata("recording", {"node": "recorder@master"})
    channels = {
        topic: writer.channel(topic, src, src.partition("@")[2])
        for topic, src in (("clock/pong", TIP), ("link/status", LINK))
    }
    pong = examples(TOPICS["clock/pong"])["ordinary"]
    status = examples(TOPICS["link/status"])["ordinary"]
    for seq in range(round(4 * HOUR_S)):
        asked_s = 0.25 * seq
        if any(begin_s <= asked_s < end_s for begin_s, end_s in case.pauses):
            continue
        arrived_s = asked_s + 0.02 + draw.expovariate(200.0) + case.queue_s(asked_s)
        back_s = arrived_s + 1e-4 + 0.02 + 2e-4 * draw.random()
        asked_ns, there_ns = (BEGAN_NS + round(at_s * NS) for at_s in (asked_s, arrived_s + case.ahead_s(arrived_s)))
        back_ns = BEGAN_NS + round(back_s * NS)
        found.record(asked_ns, there_ns, there_ns + 100_000, back_ns)
        rows = [("clock/pong", TIP, there_ns + 100_000, pong, {"ping_t_ns": asked_ns, "received_ns": there_ns})]
        if seq % 4 == 0 and (estimate := found.estimate()) is not None:
            # the link makes it ten times a second
            clock = msgspec.structs.replace(status.clock, **estimate._asdict(), valid=True)
        answer = {"answer_sent_ns": there_ns + 100_000, "answer_received_ns": back_ns}
        rows.append(("link/status", LINK, back_ns + 1000, status, {"clock": clock, **answer}))
        for topic, src, t_ns, example, fields in rows:
            message = msgspec.structs.replace(example, seq=seq, t_ns=t_ns, src=src, **fields)
            writer.write(channels[topic], back_ns + 2000, t_ns, seq, encode(message))
    writer.finish()
    return folder / "hour.mcap"


@pytest.mark.check("takes 2.9 s")
@pytest.mark.drawn(0.3)
@pytest.mark.parametrize("name", CASES)
def test_stamps_of_an_hour_are_within_a_millisecond(tmp_path: Path, name: str) -> None:
    case = CASES[name]
    clock = read_site_clock(Recording(write(case, tmp_path)))
    assert clock is not None
    times_s = np.arange(1.0, HOUR_S, 0.5)
    away = np.zeros(times_s.size, dtype=bool)
    for begin_s, end_s in case.pauses:
        away |= (times_s >= begin_s) & (times_s < end_s)
    times_s = times_s[~away]
    ahead_s = np.array([case.ahead_s(time_s) for time_s in times_s.tolist()])
    stamps = BEGAN_NS + np.rint((times_s + ahead_s) * NS).astype(np.int64)
    error_s = clock.ahead_ns(stamps) / NS - ahead_s
    assert np.abs(error_s).max() < 1e-3
