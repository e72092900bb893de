"""The queue of a line and the rate that follows from it, in virtual time: queues, TCP beside us, drift, jitter."""

import random
from collections.abc import Callable

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from line_bench import MS, Bottleneck, Jitter, even, normal, pareto, run, stalls
from telenano_wide_area.datagram.line import Line
from telenano_wide_area.datagram.outgoing import LEAST_HZ
from telenano_wide_area.datagram.rate import FULL_NS, Delivery, PathEstimate, RateControl

from telenano.timing import OffsetFilter

MBIT = 125_000.0
FIXED_NS = 20 * MS
SECOND_NS = 1_000_000_000
AHEAD_NS = 37 * SECOND_NS


def exchange(t_ns: int, there_ms: float, back_ms: float, drift: float = 0.0, ahead_ns: int = AHEAD_NS) -> list[int]:
    """Return an exchange that ends at a time, over a line of 20 ms and queues each way, with a clock that drifts."""
    back_ns, there_ns = FIXED_NS + round(back_ms * MS), FIXED_NS + round(there_ms * MS)
    there_at = t_ns - back_ns
    stamp = there_at + ahead_ns + round(drift * there_at)
    return [there_at - there_ns, stamp, stamp, t_ns]


def queues(line: Line) -> tuple[float, float]:
    assert line.there_ns is not None
    assert line.back_ns is not None
    return line.there_ns / MS, line.back_ns / MS


def told_ms(line: Line) -> float:
    """Return the queue that is told of what arrives [ms], which is within its interval."""
    told = line.take_back()
    assert told is not None
    assert 0 <= told.low_ns <= told.queue_ns <= told.high_ns
    return told.queue_ns / MS


# --- the queue ---


@pytest.mark.parametrize("drift", [5e-4, -5e-5])
def test_a_queue_is_told_from_drift_and_jitter_over_an_hour(drift: float) -> None:
    draw, line, worst = random.Random(1), Line(), 0.0
    for tick in range(3600 * 10):
        at_s = tick / 10
        standing = 30.0 if 1000.0 <= at_s < 1100.0 else 0.0
        jitter = (abs(draw.gauss(0.0, 1.0)), abs(draw.gauss(0.0, 1.0)))
        line.record(*exchange((tick + 10) * 100 * MS, standing + jitter[0], jitter[1], drift))
        if at_s > 10.0 and tick % 10 == 9:
            there, back = queues(line)
            expected = 30.0 if 1001.0 < at_s < 1100.0 else 0.0 if not 999.0 < at_s < 1101.0 else there
            worst = max(worst, abs(there - expected), abs(back))
    # one exchange in 100 ms leaves the jitter of one or two of them
    assert worst < 5.0
    assert line.drift == pytest.approx(drift, abs=2e-6)


def test_a_queue_that_grows_slowly_in_one_direction_is_no_drift() -> None:
    line = Line()
    for tick in range(60_00):
        at_s = tick / 100
        line.record(*exchange((tick + 100) * 10 * MS, max(0.0, at_s - 10.0), 0.0))
    there, back = queues(line)
    assert there == pytest.approx(50.0, abs=1.0)
    assert back < 1.0
    assert abs(line.drift) < 2e-6


def test_a_peak_within_a_tenth_of_a_second_is_no_standing_queue() -> None:
    line = Line()
    for tick in range(3000):
        line.record(*exchange((tick + 100) * MS, 40.0 if tick % 100 < 40 else 0.0, 0.0))
        if tick > 300:
            assert queues(line)[0] < 0.5


def test_the_queue_that_is_told_is_the_greatest_since_the_last_report_and_not_the_one_of_its_moment() -> None:
    line = Line()
    for tick in range(2000):
        # A burst of messages fills the line for a third of a second, and is gone when the report is made.
        line.record(*exchange((tick + 100) * MS, 0.0, max(0.0, 126.0 - 0.4 * (tick - 1000)) if tick >= 1000 else 0.0))
        if tick == 999:
            assert told_ms(line) == pytest.approx(0.0, abs=0.1)
    assert queues(line)[1] < 1.0
    assert 80.0 < told_ms(line) <= 126.0
    assert told_ms(line) == pytest.approx(0.0, abs=0.1)


@pytest.mark.parametrize("step_s", [-1000.0, -0.05, 0.05, 1000.0])
def test_a_clock_that_is_set_makes_no_queue_for_longer_than_the_line_needs_to_be_seen_anew(step_s: float) -> None:
    line = Line()
    for tick in range(2000):
        line.record(*exchange((tick + 100) * 10 * MS, 0.0, 0.0))
    for tick in range(2000, 4000):
        line.record(*exchange((tick + 100) * 10 * MS, 0.0, 0.0, ahead_ns=AHEAD_NS + round(step_s * 1e9)))
        # the round trip is as short as ever, and so is every queue
        assert max(queues(line)) < 0.5


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(*(st.integers(0, 2**62 - 1) for _ in range(4))), min_size=1, max_size=200))
def test_no_exchange_that_can_be_read_makes_a_negative_queue_or_an_error(stamps: list[tuple[int, ...]]) -> None:
    line = Line()
    for stamp in stamps:
        line.record(*stamp)
        for queue_ns in (line.there_ns, line.back_ns):
            assert queue_ns is None or queue_ns >= -1


# Delays that no load has made: a route that becomes longer one way or both, datagrams that are held back while others
# overtake them, and jitter. `load` is a queue that does fill.
KINDS = ("longer both ways", "longer to here", "overtaken", "jitter", "load")


def drawn_way(kind: str, dice: random.Random) -> tuple[Callable[[float], float], Callable[[float], float], float]:
    """Return the delays beyond 10 ms there and back at a time [s] in ms, and the greatest queue [ms]."""
    size_ms, at_s = dice.uniform(5.0, 150.0), dice.uniform(3.0, 6.0)
    share, held_ms, jitter_ms = dice.uniform(0.05, 0.5), dice.uniform(5.0, 40.0), dice.choice([0.0, 0.1, 0.5])

    def jitter() -> float:
        return dice.uniform(0.0, jitter_ms)

    if kind.startswith("longer"):
        there = 1.0 if kind == "longer both ways" else 0.0
        return lambda t: jitter() + there * size_ms * (t > at_s), lambda t: jitter() + size_ms * (t > at_s), 0.0
    if kind == "overtaken":

        def held(time_s: float) -> float:
            return jitter() + held_ms * (dice.random() < share)

        return held, held, 0.0
    if kind == "jitter":
        return lambda t: abs(dice.gauss(0.0, size_ms / 10)), lambda t: abs(dice.gauss(0.0, size_ms / 10)), 0.0
    rises_s, stands_s = dice.uniform(0.5, 2.0), dice.uniform(0.5, 2.0)

    def queue_ms(t: float) -> float:
        filled = min(1.0, (t - at_s) / rises_s, (at_s + 2.0 * rises_s + stands_s - t) / rises_s)
        return size_ms * max(0.0, filled)

    return lambda t: jitter(), lambda t: jitter() + queue_ms(t), size_ms


def greatest_told_ms(kind: str, seed: int) -> tuple[float, float]:
    """Return the greatest queue to here that is told, and the true one [ms], as an end sees exchanges at 250 Hz."""
    dice = random.Random(f"{kind} {seed}")
    there_ms, back_ms, truth_ms = drawn_way(kind, dice)
    line, offset, told = Line(), OffsetFilter(64), 0.0
    arrivals: list[tuple[float, float, float]] = []
    for tick in range(10 * 250):
        asked_s = 1.0 + tick / 250
        heard_s = asked_s + 1e-3 * (10.0 + there_ms(asked_s))
        arrivals.append((heard_s + 1e-3 * (10.0 + back_ms(heard_s)), asked_s, heard_s))
    for number, times_s in enumerate(sorted(arrivals)):
        received, asked, heard = (round(1e9 * time_s) for time_s in times_s)
        stamps = (asked, heard + AHEAD_NS, heard + AHEAD_NS, received)
        line.record(*stamps)
        if offset.record(*stamps):
            line.jump(received, *offset.present.jumped_ns)
        if number % 25 == 0 and (standing := line.take_back()) is not None:
            told = max(told, standing.queue_ns * 1e-6)
    return told, truth_ms


@pytest.mark.parametrize("kind", KINDS)
def test_a_queue_is_told_only_where_the_load_has_filled_one(kind: str) -> None:
    found = [greatest_told_ms(kind, seed) for seed in range(12)]
    wrong = [one for one in found if (one[0] > 5.0 if one[1] == 0.0 else not 0.7 < one[0] / one[1] < 1.2)]
    assert len(wrong) <= 1, wrong


# --- the rate ---


def test_a_line_with_room_is_used_in_full() -> None:
    for loss in (0.0, 0.1):
        found = run(Bottleneck(10 * MBIT), 10.0, loss=loss)
        assert found.control.mode == "free"
        assert min(found.rate_hz) >= 990


@pytest.mark.parametrize(("fair", "drift"), [(False, 0.0), (True, 5e-4)])
def test_a_full_line_is_left_without_a_queue(fair: bool, drift: float) -> None:
    found = run(Bottleneck(MBIT, fair=fair), 25.0, drift=drift)
    steady = found.queue_ms[4:]
    assert max(steady) < 20.0
    # of the longest waits of each second
    assert sum(steady) / len(steady) < 10.0
    # the line carries 718 datagrams of 174 bytes in a second
    assert sum(found.rate_hz[4:]) / len(steady) > 0.8 * 718
    assert found.control.mode == "full"


def test_the_first_second_of_a_line_of_a_quarter_megabit_is_the_only_one_with_a_long_queue() -> None:
    found = run(Bottleneck(0.256 * MBIT), 30.0)
    assert max(found.queue_ms[5:]) < 30.0
    assert min(found.rate_hz) >= LEAST_HZ


def test_samples_are_evenly_spaced_over_a_full_line() -> None:
    # The spacing is what the laws bear: evenly thinned samples hold where as many random losses do not.
    found = run(Bottleneck(MBIT), 20.0)
    gaps = [second - first for first, second in zip(found.sent_ns[10_000:], found.sent_ns[10_001:], strict=False)]
    assert max(gaps) <= 2 * MS


def test_beside_a_tcp_transfer_a_fair_queue_gives_a_share_without_a_long_queue() -> None:
    found = run(Bottleneck(MBIT, fair=True), 30.0, tcp_from=5.0)
    # Two segments of TCP are 24 ms of this line, and as much again passes for jitter.
    assert max(found.queue_ms[10:]) < 65.0
    assert sum(found.queue_ms[10:]) / len(found.queue_ms[10:]) < 35.0
    assert sum(found.rate_hz[10:]) / len(found.rate_hz[10:]) > 200
    assert found.tcp_bytes > 0.3 * 20 * MBIT


def test_beside_a_tcp_transfer_in_the_same_buffer_the_loop_keeps_a_share_and_takes_the_line_back() -> None:
    found = run(Bottleneck(MBIT), 70.0, tcp_from=5.0, tcp_until=40.0)
    beside = found.rate_hz[12:38]
    # nobody else can empty that queue, and to give way further would not either
    assert sum(beside) / len(beside) > 100
    assert found.tcp_bytes > 0.2 * 35 * MBIT
    assert max(found.queue_ms[55:]) < 25.0
    assert sum(found.rate_hz[55:]) / len(found.rate_hz[55:]) > 0.7 * 718


def test_a_line_that_becomes_narrow_and_wide_again_is_followed() -> None:
    def change(at_s: float, line: Bottleneck) -> None:
        line.bytes_per_s = MBIT if 8.0 <= at_s < 25.0 else 10 * MBIT

    found = run(Bottleneck(10 * MBIT), 60.0, change=change)
    assert max(found.queue_ms[11:23]) < 20.0
    assert min(found.rate_hz[-10:]) >= 990
    assert found.control.mode == "free"


# What the nodes of the slave send to the master by TCP, each message with the headers of its segments: the health
# of the recorder, of both nodes of the loop and of the launcher, the link's report, answers to the clock, and
# acknowledgements. Periods [s] and sizes [bytes].
TO_MASTER = ((0.52, 1370), (0.52, 1080), (0.48, 690), (0.52, 960), (0.48, 710), (0.1, 200), (0.0083, 52))
# and what the link sends to the nodes of the slave's site: its delay and its questions
TO_SLAVE = (*((0.1, 240),) * 3, *((0.1, 170),) * 2, (0.0125, 52))


@pytest.mark.parametrize(("beside", "each"), [(TO_MASTER, 580), (TO_SLAVE, 680)])
def test_beside_the_messages_of_all_nodes_1_mbit_carries_almost_every_second_sample(
    beside: tuple[tuple[float, int], ...], each: int
) -> None:
    # 60 to 110 bytes of sample, 28 to seal it, 8 to 40 of report, 28 of the network: see test_runtime_line_ends.py
    found = run(Bottleneck(MBIT), 25.0, size=142, beside=beside)
    assert sum(found.rate_hz[6:]) / len(found.rate_hz[6:]) > each
    # a message of a node is 11 ms of this line, and comes behind what stands there
    assert sum(found.queue_ms[6:]) / len(found.queue_ms[6:]) < 20.0


def test_jitter_alone_leaves_out_nothing() -> None:
    found = run(Bottleneck(10 * MBIT), 15.0, jitter=normal(10.0), drift=2e-4)
    assert sum(found.rate_hz) >= 0.99 * 1000 * len(found.rate_hz)


ORDERED = {
    "normal, 3 ms": normal(3.0),
    "normal, 10 ms": normal(10.0),
    "even, 3 ms": even(3.0),
    "even, 10 ms": even(10.0),
    "even, 30 ms": even(30.0),
    "Pareto, 3 ms": pareto(3.0),
    "30 ms of stall, five a second": stalls(30.0, 0.2),
    "100 ms of stall each second": stalls(100.0, 1.0),
    "300 ms of stall each 3 s": stalls(300.0, 3.0),
}
# Here a datagram takes a third of a second at times.
WILD = {"Pareto, 10 ms": pareto(10.0), "normal, 30 ms": normal(30.0), "Pareto, 30 ms": pareto(30.0)}


@pytest.mark.check("a quarter of a minute of each line")
@pytest.mark.drawn(0.4)
@pytest.mark.parametrize("loss", [0.0, 0.02, 0.15])
@pytest.mark.parametrize("name", ORDERED)
def test_a_line_that_jitters_in_order_is_not_full(name: str, loss: float) -> None:
    found = run(Bottleneck(10 * MBIT), 15.0, jitter=ORDERED[name], in_order=True, loss=loss)
    assert sum(found.rate_hz) >= 0.95 * 1000 * len(found.rate_hz)


@pytest.mark.parametrize("name", WILD)
def test_over_a_line_that_jitters_wildly_most_samples_go(name: str) -> None:
    found = run(Bottleneck(10 * MBIT), 15.0, jitter=WILD[name], in_order=True)
    assert sum(found.rate_hz) >= 0.85 * 1000 * len(found.rate_hz)


@pytest.mark.parametrize("jitter", [even(3.0), even(10.0)], ids=["3 ms", "10 ms"])
def test_a_narrow_line_that_jitters_is_left_without_a_long_queue(jitter: Jitter) -> None:
    found = run(Bottleneck(MBIT), 25.0, jitter=jitter, in_order=True)
    steady = found.rate_hz[4:]
    assert sum(steady) / len(steady) > 0.8 * 718
    assert sum(found.queue_ms[4:]) / len(steady) < 40.0


def test_a_line_that_jitters_and_becomes_narrow_and_wide_again_is_followed() -> None:
    def change(at_s: float, line: Bottleneck) -> None:
        line.bytes_per_s = MBIT if 8.0 <= at_s < 20.0 else 10 * MBIT

    found = run(Bottleneck(10 * MBIT), 30.0, change=change, jitter=even(10.0), in_order=True)
    assert min(found.rate_hz[:7]) >= 950
    # the jitter itself is 20 ms
    assert max(found.queue_ms[11:19]) < 90.0
    assert found.control.carried_bytes_per_s == pytest.approx(MBIT, rel=0.25)
    assert min(found.rate_hz[25:]) >= 950


@pytest.mark.parametrize("until_s", [8.0, 18.0])
def test_a_line_that_has_become_narrow_is_named_with_what_it_carries_now_and_its_queue_goes(until_s: float) -> None:
    def change(at_s: float, line: Bottleneck) -> None:
        line.bytes_per_s = (10.0 if at_s < 5.0 else 0.256) * MBIT

    found = run(Bottleneck(10 * MBIT), until_s, change=change)
    assert 8.0 * found.control.carried_bytes_per_s == pytest.approx(256_000, rel=0.05)
    # The whole buffer of 2 s has filled; what was sent before a reduction goes first.
    assert max(found.queue_ms[15:], default=0.0) < 50.0


def test_after_jitter_that_ends_all_samples_go_within_two_seconds() -> None:
    wild = pareto(30.0)
    found = run(
        Bottleneck(10 * MBIT),
        14.0,
        jitter=lambda draw, at_s: wild(draw, at_s) if 2.0 <= at_s < 10.0 else 0.0,
        in_order=True,
    )
    assert min(found.rate_hz[-2:]) >= 990


def test_an_hour_of_a_full_line_with_a_clock_that_drifts() -> None:
    # a twentieth of the rates, and so a twentieth of the work
    found = run(Bottleneck(0.05 * MBIT), 3600.0, hz=50, drift=5e-4, least_hz=2.5)
    assert sum(queue < 120.0 for queue in found.queue_ms[10:]) > 0.95 * len(found.queue_ms[10:])
    assert sum(found.rate_hz) / len(found.rate_hz) > 0.7 * 35.9


# --- what another end can make of it ---


@settings(max_examples=60, deadline=None)
@given(
    st.lists(
        st.builds(
            PathEstimate, st.integers(-1, 2**62), st.floats(0.0, 1e30), st.floats(0.0, 1.0), st.integers(0, 2**62)
        ),
        max_size=100,
    )
)
def test_whatever_the_other_end_reports_the_rate_stays_between_the_least_and_the_budget(
    reports: list[PathEstimate],
) -> None:
    control = RateControl(750_000.0)
    for tick, seen in enumerate(reports):
        control.update(tick * 50 * MS, seen, 8_700.0)
        assert 8_700.0 <= control.bytes_per_s <= 750_000.0


def test_no_more_is_delivered_than_was_sent_whatever_the_other_end_says() -> None:
    delivery = Delivery()
    for tick in range(10):
        delivery.record(tick * 100 * MS, tick * 2**50, tick * 2**50)
    found = delivery.rate(174.0, 100_000.0)
    assert found is not None
    assert found[0] <= 150_000.0


def test_a_queue_at_the_threshold_is_enough_and_one_below_is_not() -> None:
    for queue_ns, mode in ((FULL_NS, "full"), (FULL_NS - 1, "free")):
        control = RateControl(750_000.0)
        control.update(0, PathEstimate(queue_ns, 200_000.0, 0.0, 40 * MS), 8_700.0)
        assert control.mode == mode
