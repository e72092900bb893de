"""An hour of two clocks in virtual time: stamps of the slave are put on the master's clock within a millisecond."""

from pathlib import Path

import numpy as np
import pytest
from drawn_clock_messages import BEGAN_NS, NS, Case, write

from telenano.recording.reader import Recording
from telenano.recording.site_clock import read_site_clock

HOUR_S = 3600.0


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


@pytest.mark.check("takes 2.9 s")
@pytest.mark.drawn(0.3)
@pytest.mark.parametrize("name", CASES)
def test_stamps_of_an_hour_are_within_a_millisecond(tmp_path: Path, name: str) -> None:
    case = CASES[name]
    clock = read_site_clock(Recording(write(case, tmp_path, HOUR_S)))
    assert clock is not None
    times_s = np.arange(1.0, HOUR_S, 0.5)
    away = np.zeros(times_s.size, dtype=bool)
    for begin_s, end_s in case.pauses:
        away |= (times_s >= begin_s) & (times_s < end_s)
    times_s = times_s[~away]
    ahead_s = np.array([case.ahead_s(time_s) for time_s in times_s.tolist()])
    stamps = BEGAN_NS + np.rint((times_s + ahead_s) * NS).astype(np.int64)
    heard_ns = BEGAN_NS + np.rint((times_s + 0.05) * NS).astype(np.int64)
    error_s = clock.ahead_ns(stamps, heard_ns) / NS - ahead_s
    assert np.abs(error_s).max() < 1e-3
