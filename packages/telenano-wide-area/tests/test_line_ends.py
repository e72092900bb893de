"""Two ends over a line: small samples, trains, an early way out over TCP, and a peer that reports nonsense."""

import hashlib
import random
import zlib
from collections.abc import Callable, Iterator
from statistics import median

import pytest
from telenano_wide_area.datagram import end
from telenano_wide_area.datagram.arrivals import ArrivalRecord
from telenano_wide_area.datagram.body import (
    ASKING_TRAIN,
    DICTIONARY,
    REPORT,
    SAMPLE,
    SHORT_REPORT,
    TRAIN,
    mark,
    packed,
    parse,
    short_report,
)
from telenano_wide_area.datagram.incoming import Incoming
from telenano_wide_area.datagram.outgoing import LEAST_HZ, TRAIN_DATAGRAMS, Outgoing
from telenano_wide_area.datagram.pacing import NETWORK_BYTES
from telenano_wide_area.datagram.rate import Mode
from telenano_wide_area.datagram.reception import DEADLINE_NS, SILENCE_NS
from telenano_wide_area.datagram.replay_window import ReplayWindow
from telenano_wide_area.doubles import datagram_bench
from telenano_wide_area.doubles.datagram_bench import Pair, pair
from telenano_wide_area.sealed import RejectedError
from telenano_wide_area.settings import DatagramSettings
from test_datagram_ends import _Blocked

from telenano.testing import payload

MS = 1_000_000
SECOND_NS = 1_000_000_000
REPORTED = REPORT.pack(1, 0, 0, 0, 0)
FORWARD = payload("teleop/forward", "controller@master", 7)

pytestmark = pytest.mark.timeout(120)


@pytest.fixture
def ends() -> Iterator[Pair]:
    with pair() as made:
        yield made


# --- samples ---


def test_a_sample_is_deflated_to_a_third_and_comes_back_as_it_was() -> None:
    sample = packed("teleop/forward", FORWARD)
    assert len(sample) < len(FORWARD) / 3
    assert parse(REPORTED + sample + mark(ASKING_TRAIN)) == (
        parse(REPORTED).report,
        [(b"teleop/forward", FORWARD)],
        [ASKING_TRAIN],
        0,
    )
    # both ends need the very same bytes: another dictionary would be another wire format
    assert hashlib.sha256(DICTIONARY).hexdigest() == "0acc65774425ceb5ca0e71552a3cd51364049f19fa05ead41eaa95ff98029c39"


def test_a_short_report_says_when_it_was_sent_and_nothing_else() -> None:
    sample = packed("teleop/forward", FORWARD)
    found = parse(short_report(1_792_000_000_000_000_000) + sample)
    assert found.report == (1_792_000_000_000_000_000, 0, 0, 0, 0)
    assert found.samples == [(b"teleop/forward", FORWARD)]
    with pytest.raises(RejectedError, match="time"):
        parse(short_report(2**62))


def test_over_a_full_line_most_datagrams_go_without_a_report(ends: Pair, monkeypatch: pytest.MonkeyPatch) -> None:
    ends.joined()
    monkeypatch.setattr(datagram_bench, "STEP_NS", 2 * MS)
    outgoing = ends.master.end.outgoing

    def usual_size() -> float:
        sizes = []
        for _ in range(500):
            before = outgoing.bytes
            ends.turn()
            sizes.append(outgoing.bytes - before)
        return median(sizes)

    whole = usual_size()
    outgoing.control.mode = "full"
    monkeypatch.setattr(outgoing, "update", lambda *_: None)
    assert whole - usual_size() == REPORT.size - SHORT_REPORT.size
    # What each hears of the other is enough for its rate.
    assert [side.end.acknowledged for side in ends.sides] == [True, True]
    assert ends.slave.seqs[-1] == ends.master.seq - 1


@pytest.mark.parametrize("what", ["bomb", "cut", "more", "noise"])
def test_what_does_not_inflate_to_a_sample_is_malformed(what: str) -> None:
    deflate = zlib.compressobj(9, zlib.DEFLATED, -12, 9, zlib.Z_DEFAULT_STRATEGY, DICTIONARY)
    data = {
        "bomb": deflate.compress(bytes(400_000)) + deflate.flush(),
        "cut": packed("teleop/forward", FORWARD)[SAMPLE.size : -3],
        "more": packed("teleop/forward", FORWARD)[SAMPLE.size :] + b"more",
        "noise": bytes(range(255, 200, -1)),
    }[what]
    with pytest.raises(RejectedError, match="malformed"):
        parse(REPORTED + SAMPLE.pack(0, len(data)) + data)


# --- the state of the line ---


def test_losses_are_divided_by_what_is_settled() -> None:
    window, account = ReplayWindow(), ArrivalRecord()
    account.begin(window)
    for number in range(5000):
        if number % 10:
            window.record(number)
            account.record(number, number * MS, number * MS + 20 * MS)
        if number % 50 == 49:
            account.settle(number * MS)
    # the last second is not settled: of 5 s, a tenth lost reads as 8 % of what was sent
    assert account.lost / account.settled == pytest.approx(0.1, abs=0.001)
    assert account.lost / account.sent < 0.085


def test_a_report_has_the_state_of_the_line(ends: Pair) -> None:
    ends.joined()
    ends.turns(100)
    for side in ends.sides:
        report = side.outlet.last("link/network")
        assert report.queue_s is not None
        assert report.queue_low_s <= report.queue_s <= report.queue_high_s
        assert report.queue_s < 1e-3
        assert report.capacity_low_bit_per_s <= report.capacity_bit_per_s
        # the train of the start, over the loopback
        assert report.capacity_bit_per_s > 1e7
        assert report.line == "free"
        assert report.limit_bit_per_s == 6_000_000


def after_standing_still(ends: Pair, monkeypatch: pytest.MonkeyPatch, still_ms: int, each_ms: int) -> Outgoing:
    """Let the slave's end stand still, then take so many datagrams a millisecond; return what it is sent."""
    ends.joined()
    monkeypatch.setattr(datagram_bench, "STEP_NS", MS)
    ends.turns(500)
    monkeypatch.setattr(end, "_BATCH", each_ms)
    master, taken = ends.master, ends.slave.end.arrivals.arrived
    for _ in range(still_ms):
        for side in ends.sides:
            side.clock.advance_ns(MS)
        master.send()
        master.take()
    assert ends.slave.end.arrivals.arrived == taken
    return master.end.outgoing


@pytest.mark.parametrize(("each_ms", "still_ms"), [(64, 2000), (4, 500), (2, 200), (2, 500), (2, 2000)])
def test_an_end_that_stood_still_and_catches_up_is_not_taken_for_a_full_line(
    ends: Pair, monkeypatch: pytest.MonkeyPatch, each_ms: int, still_ms: int
) -> None:
    after_standing_still(ends, monkeypatch, still_ms, each_ms)
    # What waited is taken within as long as the end stood still; all the while it was sent something.
    ends.turns(2500)
    for side in ends.sides:
        assert (side.end.outgoing.control.mode, side.end.outgoing.unsent) == ("free", 0)
    assert ends.slave.seqs[-1] == ends.master.seq - 1
    queue_s = [report.queue_s for topic, report in ends.slave.outlet.sent if topic == "link/network"]
    assert max(found for found in queue_s if found is not None) < 1e-3


def test_an_end_that_does_not_catch_up_is_sent_less(ends: Pair, monkeypatch: pytest.MonkeyPatch) -> None:
    outgoing = after_standing_still(ends, monkeypatch, 500, 1)
    ends.turns(1800)
    assert outgoing.unsent == 0
    # It takes no more than comes, so that what waited would wait for ever.
    ends.turns(3000)
    assert outgoing.unsent > 500
    assert ends.slave.seqs[-1] > ends.master.seq - 100


def test_a_train_measures_what_the_line_carries_though_the_process_stood_still_for_a_moment() -> None:
    incoming, at_ns = Incoming("slave"), 0
    for place in range(TRAIN_DATAGRAMS):
        # 500 bytes in 2 ms are 2 Mbit/s; what came during a pause of 8 ms is read at once after it,
        # so that nothing seems faster than it was
        at_ns = max(at_ns, place * 2 * MS + (8 * MS if place == 10 else 0))
        incoming.record(452, at_ns, [ASKING_TRAIN], 0, place)
    incoming.measure(at_ns + 500 * MS)
    assert incoming.capacity == pytest.approx(2e6, rel=0.1)
    assert incoming.wants_train


def trains_of(incoming: Incoming, bit_per_s: float, from_ns: int) -> int:
    """Let three trains come over a line of a rate; return when the last one was taken."""
    for _ in range(3):
        for place in range(TRAIN_DATAGRAMS):
            from_ns += round(8e9 * (452 + NETWORK_BYTES) / bit_per_s)
            incoming.record(452, from_ns, [TRAIN], 0, place)
        from_ns += SECOND_NS
        incoming.measure(from_ns)
    return from_ns


def test_what_the_line_carries_is_told_when_it_has_changed_for_good_and_no_other_time() -> None:
    incoming = Incoming("slave")
    now_ns = trains_of(incoming, 2e6, 0)
    assert incoming.take_change(now_ns) is None
    now_ns = trains_of(incoming, 2.1e6, now_ns)
    assert incoming.take_change(now_ns) is None
    # What trains of the last ten seconds showed holds until more, or only less, was measured.
    now_ns = trains_of(incoming, 1e6, now_ns + 11 * SECOND_NS)
    assert incoming.take_change(now_ns) is None
    told = incoming.take_change(now_ns + SECOND_NS)
    assert told is not None
    assert [one.bit_per_s for one in told] == [pytest.approx(2e6, rel=0.1), pytest.approx(1e6, rel=0.1)]
    assert all(one.low_bit_per_s <= one.bit_per_s <= (one.high_bit_per_s or 0) for one in told)
    assert incoming.take_change(now_ns + 3 * SECOND_NS) is None


@pytest.mark.parametrize("rate_mbit", [0.5, 3.0, 30.0, 1000.0])
def test_the_interval_of_a_train_holds_what_the_line_carries(rate_mbit: float) -> None:
    incoming = Incoming("slave")
    trains_of(incoming, 1e6 * rate_mbit, 0)
    measured = incoming.measured
    assert measured is not None
    assert measured.low_bit_per_s <= 1e6 * rate_mbit
    # A train that is over before a clock shows it bounds nothing from above.
    assert (measured.high_bit_per_s is None) == (rate_mbit > 300.0)
    assert measured.high_bit_per_s is None or measured.high_bit_per_s >= 1e6 * rate_mbit


@pytest.mark.parametrize("spread_ms", [30.0, 120.0])
def test_a_train_that_came_in_another_order_or_in_bursts_measures_nothing(spread_ms: float) -> None:
    draw = random.Random(3)
    delays_ms = [draw.uniform(0.0, spread_ms) for _ in range(TRAIN_DATAGRAMS)]
    courses = {
        "reordered": sorted((round(delay * MS), place) for place, delay in enumerate(delays_ms)),
        # The delay becomes longer while it is under way.
        "stepped": [
            (place * MS // 10 + round(spread_ms * MS) * (place > 20), place) for place in range(TRAIN_DATAGRAMS)
        ],
    }
    for course in courses.values():
        incoming = Incoming("slave")
        for at_ns, number in course:
            incoming.record(452, at_ns, [TRAIN], 0, number)
        incoming.measure(SECOND_NS)
        assert incoming.capacity == 0


def full_queue_over(send_hz: Callable[[float], float], delay_ms: Callable[[float], float], bit_per_s: float) -> int:
    """Return what is measured of a line of some rate, 0 for none, whose delay has a course, of what is sent over it."""
    incoming, at_s, free_s, number = Incoming("slave"), 0.0, 0.0, 0
    while at_s < 6.0:
        free_s = max(free_s, at_s) + (8.0 * 200 / bit_per_s if bit_per_s else 0.0)
        arrives_ns, sent_ns = round(1e9 * (free_s + 1e-3 * delay_ms(at_s))), round(1e9 * at_s) + 37 * SECOND_NS
        incoming.record(200 - NETWORK_BYTES, arrives_ns, [], sent_ns, number)
        number, at_s = number + 1, at_s + 1.0 / send_hz(at_s)
    return incoming.capacity


def test_what_leaves_a_queue_of_ones_own_is_what_the_line_carries_and_no_course_of_the_delay_is() -> None:
    more_and_less = lambda at_s: 900.0 if at_s % 2.0 < 1.0 else 400.0  # noqa: E731
    steady, level = (lambda at_s: 900.0), (lambda at_s: 20.0)
    assert full_queue_over(more_and_less, level, 1e6) == pytest.approx(1e6, rel=0.05)
    # A route that becomes longer and shorter, by and by or at once, and a line that is never full, show nothing.
    assert full_queue_over(steady, lambda at_s: 20.0 + 100.0 * abs(at_s % 2.0 - 1.0), 0.0) == 0
    assert full_queue_over(steady, lambda at_s: 20.0 if at_s < 3.0 else 300.0, 0.0) == 0
    assert full_queue_over(more_and_less, level, 2e6) == 0


@pytest.mark.parametrize(
    ("mode", "queue_ms", "levels"),
    [
        ("full", 50, ["warning", "info"]),
        ("full", 9, []),
        # It jitters in order, or others fill it: to send less does not lower the delay.
        ("free", 50, []),
        ("shared", 50, []),
    ],
)
def test_only_its_sender_calls_a_line_full_and_names_what_it_carries_now(
    mode: Mode, queue_ms: int, levels: list[str]
) -> None:
    outgoing, told = Outgoing(DatagramSettings(), 0), []
    outgoing.control.carried_bytes_per_s = 32_000.0
    for tick in range(2000):
        at_ns = 40 * MS + tick * 5 * MS
        queue_ns = queue_ms * MS if 400 <= tick < 1600 else 0
        outgoing.line.record(at_ns - 40 * MS - queue_ns, at_ns - 20 * MS, at_ns - 20 * MS, at_ns)
        outgoing.control.mode = mode if 400 <= tick < 1800 else "free"
        if found := outgoing.report_queue(at_ns, "slave"):
            told.append(found)
    assert [level for level, _ in told] == levels
    if levels:
        assert "which carries 0.256 Mbit/s of the link's datagrams, is full: a queue of 50 ms stands" in told[0][1]


# --- falling back ---


@pytest.mark.parametrize("step_ms", [1, 4, 8])
def test_tcp_is_subscribed_to_before_a_deadline_can_fire_at_every_rate(
    ends: Pair, monkeypatch: pytest.MonkeyPatch, step_ms: int
) -> None:
    ends.joined()
    monkeypatch.setattr(datagram_bench, "STEP_NS", step_ms * MS)
    ends.turns(300)
    sockets = [side.end.socket for side in ends.sides]
    for side in ends.sides:
        side.events.clear()
        side.end.socket = _Blocked(side.end.socket)  # type: ignore[assignment]
    waited = 0
    while "teleop/forward" not in ends.slave.log.topics:
        ends.turn()
        waited += 1
        assert waited * MS < SILENCE_NS / 3
    # Half the deadline and two pauses, or nine tenths of it.
    silence_ns = min(DEADLINE_NS / 2 + 2 * step_ms * MS, 0.9 * DEADLINE_NS)
    assert waited * step_ms * MS == pytest.approx(silence_ns, abs=2 * step_ms * MS)
    assert (waited - 1) * step_ms * MS < DEADLINE_NS
    # a node that sleeps is woken for it
    assert ends.master.end.due_ns <= ends.master.clock.monotonic_ns() + DEADLINE_NS or "law/status" in (
        ends.master.log.topics
    )
    assert [side.end.receiving for side in ends.sides] == ["datagram", "datagram"]
    for side, real in zip(ends.sides, sockets, strict=True):
        side.end.socket = real
    ends.turns(700)
    assert [side.log.whole for side in ends.sides] == [{"link/key"}, {"link/key"}]
    assert [event.text for side in ends.sides for event in side.events] == []


# --- a peer that lies ---


@pytest.mark.parametrize("lie_ns", [5 * MS, -5 * MS])
def test_a_peer_that_reports_a_growing_queue_is_sent_the_least_and_no_less(ends: Pair, lie_ns: int) -> None:
    ends.joined()
    for turn in range(2000):
        ends.turn()
        sent_ns, heard_ns = ends.slave.end._heard
        ends.slave.end._heard = (sent_ns, heard_ns + turn * lie_ns)
    before, seq = ends.master.end.outgoing.datagrams, ends.master.seq
    ends.turns(400)
    # four seconds of a hundred samples
    assert ends.master.end.outgoing.datagrams - before >= 0.9 * min(4 * LEAST_HZ, ends.master.seq - seq)
    assert ends.master.end.outgoing.control.bytes_per_s <= 750_000.0


def test_a_peer_that_asks_for_trains_all_the_time_gets_a_few(ends: Pair) -> None:
    ends.joined()
    before = ends.slave.end.outgoing.datagrams
    for _ in range(1000):
        ends.turn(send=False)
        ends.slave.end.incoming.wants_train = True
    # ten seconds: a train in 0.7 s, and twenty signs of life a second, with two reports of what the line carries
    assert ends.slave.end.outgoing.datagrams - before <= 15 * TRAIN_DATAGRAMS + 10 * (20 + 2) + 20
