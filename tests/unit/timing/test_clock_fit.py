"""One way to know another clock: for the link while it runs, for its queues, and for a recording of it."""

import random
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pytest
from telenano_wide_area.datagram.line import Line

from telenano.recording.clock_course import bounds_of, runs
from telenano.recording.site_clock import SiteClock
from telenano.timing.clock_fit import Bounds
from telenano.timing.clock_offset import OffsetFilter

BEGAN_NS, LENGTH_S, SET_S = 1_700_000_000 * 10**9, 240.0, 100.0


class Case(NamedTuple):
    """What the other clock is ahead [s] at a time [s], how fast it gains [s/s], for how long it was away when set."""

    ahead_s: Callable[[float], float]
    drift: float = 0.0
    away_s: float = 0.5


CASES = {
    "0.3 s behind": Case(lambda time_s: -0.3),
    "37 s ahead": Case(lambda time_s: 37.0),
    "500 ppm fast": Case(lambda time_s: 5e-4 * time_s, 5e-4),
    "37 s ahead and 500 ppm slow": Case(lambda time_s: 37.0 - 5e-4 * time_s, -5e-4),
    "set forward by 0.2 s": Case(lambda time_s: 0.2 * (time_s >= SET_S)),
    "set back by 3 s and 500 ppm fast": Case(lambda time_s: 5e-4 * time_s - 3.0 * (time_s >= SET_S), 5e-4, 4.0),
    "set back by an hour and 500 ppm slow": Case(lambda time_s: -5e-4 * time_s - 3600.0 * (time_s >= SET_S), -5e-4),
}


def exchanges(case: Case) -> list[list[int]]:
    """Return ten exchanges a second over ways of 20 ms, with ten times as much jitter there as back."""
    draw, found = random.Random(7), []
    for number in range(round(10 * LENGTH_S)):
        asked_s = 0.1 * number
        if SET_S - case.away_s < asked_s < SET_S:
            continue
        there_s = asked_s + 0.02 + draw.expovariate(500.0)
        back_s = there_s + 1e-4 + 0.02 + draw.expovariate(5000.0)
        stamps = (asked_s, there_s + case.ahead_s(there_s), there_s + 1e-4 + case.ahead_s(there_s), back_s)
        found.append([BEGAN_NS + round(at_s * 1e9) for at_s in stamps])
    return found


@pytest.mark.parametrize("name", CASES)
def test_the_link_knows_the_clock_as_it_runs(name: str) -> None:
    seen = OffsetFilter(64)
    for exchange in exchanges(CASES[name]):
        seen.record(*exchange)
    found, line = seen.estimate(), seen.line()
    assert found is not None and line is not None
    assert found.offset_s == pytest.approx(CASES[name].ahead_s(LENGTH_S), abs=1e-3)
    assert 0.0201 > found.uncertainty_s > abs(found.offset_s - CASES[name].ahead_s(LENGTH_S))
    assert line.drift == pytest.approx(CASES[name].drift, abs=1e-5)


@pytest.mark.parametrize("name", CASES)
def test_another_clock_is_no_queue_of_the_line(name: str) -> None:
    line, most_ns = Line(), 0
    for number, exchange in enumerate(exchanges(CASES[name])):
        line.record(*exchange)
        # A minute after it was set the line is known again.
        if not 10 * SET_S <= number < 10 * (SET_S + 60.0) and number > 50:
            most_ns = max(most_ns, line.there_ns or 0, line.back_ns or 0)
    assert line.drift == pytest.approx(CASES[name].drift, abs=1e-5)
    assert most_ns < 15_000_000


@pytest.mark.parametrize("name", CASES)
def test_a_recording_knows_what_the_clock_was_at_each_time(name: str) -> None:
    of = exchanges(CASES[name])

    def read(first_ns: int, last_ns: int) -> Bounds | None:
        part = [exchange for exchange in of if first_ns <= exchange[0] < last_ns]
        upper = [(sent_ns, there_ns - sent_ns) for sent_ns, there_ns, _, _ in part]
        return bounds_of(upper, [(received_ns, back_ns - received_ns) for _, _, back_ns, received_ns in part])

    pieces = (read(BEGAN_NS + n * 4 * 10**9, BEGAN_NS + (n + 1) * 4 * 10**9) for n in range(round(LENGTH_S / 4.0)))
    found = runs([piece for piece in pieces if piece is not None], read)
    clock = SiteClock(tuple(found), 0.0, True, "", (BEGAN_NS, BEGAN_NS + round(LENGTH_S * 1e9)))
    times_s = np.arange(1.0, LENGTH_S, 0.5)
    times_s = times_s[(times_s < SET_S - CASES[name].away_s) | (times_s > SET_S)]
    ahead_s = np.array([CASES[name].ahead_s(time_s) for time_s in times_s.tolist()])
    stamps = BEGAN_NS + np.rint((times_s + ahead_s) * 1e9).astype(np.int64)
    heard_ns = BEGAN_NS + np.rint((times_s + 0.05) * 1e9).astype(np.int64)
    assert np.abs(clock.ahead_ns(stamps, heard_ns) / 1e9 - ahead_s).max() < 1e-3


@pytest.mark.parametrize("seed", range(20))
def test_the_search_for_a_step_ends_where_the_recorder_was_set_as_well(seed: int) -> None:
    # The recorder's clock is set back as well, so what it records in an interval may be dated before or after that.
    dice = random.Random(seed)
    set_ns, by_ns = BEGAN_NS + round(SET_S * 1e9), round(dice.uniform(-60.0, 60.0) * 1e9)
    of, reads = exchanges(CASES[dice.choice(["set forward by 0.2 s", "set back by 3 s and 500 ppm fast"])]), []

    def read(first_ns: int, last_ns: int) -> Bounds | None:
        reads.append(first_ns)
        assert len(reads) < 200
        part = [one for one in of if first_ns <= one[0] - by_ns * (one[0] >= set_ns) < last_ns]
        upper = [(sent_ns, there_ns - sent_ns) for sent_ns, there_ns, _, _ in part]
        return bounds_of(upper, [(received_ns, back_ns - received_ns) for _, _, back_ns, received_ns in part])

    read_ns = range(BEGAN_NS - 60 * 10**9, BEGAN_NS + round((LENGTH_S + 60.0) * 1e9), 4 * 10**9)
    pieces = [piece for at_ns in read_ns if (piece := read(at_ns, at_ns + 4 * 10**9)) is not None]
    runs(pieces, read)
