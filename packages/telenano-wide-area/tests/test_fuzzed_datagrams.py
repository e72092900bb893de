"""Nothing that a machine with a key sends as a datagram ends or hangs an end of the link."""

import os
import random

import pytest
from telenano_wide_area.datagram.arrivals import MOST_ROWS, ArrivalRecord, LinkNetwork
from telenano_wide_area.datagram.body import BOUND, DATAGRAMS_OF, REPORT
from telenano_wide_area.datagram.end import DatagramEnd
from telenano_wide_area.datagram.replay_window import WINDOW, ReplayWindow
from telenano_wide_area.doubles.datagram_bench import Pair, Side, pair
from telenano_wide_area.doubles.fuzz_datagrams import CAUSES, Datagrams

from telenano.timing import OffsetFilter

# TELENANO_FUZZ_DATAGRAMS in the environment replaces it, for a longer search
COUNT = int(os.environ.get("TELENANO_FUZZ_DATAGRAMS", 1500))
MAX = 2**64 - 1
# Without it a loop over 2^40 numbers would hold the suite for hours.
pytestmark = pytest.mark.timeout(120)


def send(sender: Side, datagram: bytes) -> None:
    assert sender.end._peer is not None
    sender.end.socket.sendto(datagram, sender.end._peer)


def report(end: DatagramEnd, **fields: int) -> bytes:
    """Give the report of an honest end, but for `fields`."""
    honest = {"sent_ns": end._clock.now_ns(), "heard_sent_ns": 0, "heard_ns": 0, "expected": 0, "arrived": 0}
    return REPORT.pack(*{**honest, **fields}.values())


def check(side: Side) -> None:
    assert set(side.end.rejected) <= CAUSES
    network = side.outlet.last("link/network")
    rows = network.number.to_numpy()
    assert len(rows) <= MOST_ROWS
    assert (network.delay_ns.to_numpy() >= 0).all()
    assert network.arrived <= network.sent + network.late + 1


@pytest.mark.parametrize("play_out", [False, True])
@pytest.mark.parametrize("attacked", ["master", "slave"])
def test_no_datagram_of_a_peer_with_a_key_ends_an_end(attacked: str, play_out: bool) -> None:
    draw = random.Random(f"{attacked} {play_out}")
    with pair(play_out=play_out) as ends:
        ends.joined()
        victim, peer = (ends.master, ends.slave) if attacked == "master" else (ends.slave, ends.master)
        ways = "backward" if attacked == "master" else "forward"
        made = Datagrams(f"{attacked} {play_out}", peer.clock.now_ns(), DATAGRAMS_OF[ways])
        for _ in range(COUNT):
            for _ in range(draw.randrange(4)):
                assert peer.end._agreement.sealer is not None
                send(peer, made.sealed(peer.end._agreement.sealer, peer.clock.now_ns()))
            ends.turn(send=False)
        check(victim)
        assert {"time", "count", "ahead", "malformed"} <= set(victim.end.rejected)
        assert victim.end.arrivals.arrived > 0.3 * COUNT, victim.end.rejected
        recovers(ends, attacked)


def recovers(ends: Pair, attacked: str) -> None:
    """Assert that an honest end in the place of the other one is understood: nothing is left of what came before."""
    victim, peer = (ends.master, ends.slave) if attacked == "master" else (ends.slave, ends.master)
    for side in ends.sides:
        side.end._agreement.forget(side.clock.monotonic_ns())
    ends.turns(200)
    assert victim.end.receiving == "datagram"
    assert peer.end.receiving == "datagram"
    # what the peer said of its clock is believed for as long as its exchanges are in view
    peer.end.offset, victim.end.offset = OffsetFilter(64), OffsetFilter(64)
    ends.turns(200)
    found = victim.outlet.last("link/network")
    assert found.delay_max_s < 1.0


@pytest.mark.parametrize(
    ("cause", "fields"),
    [
        ("time", {"sent_ns": MAX}),
        ("time", {"sent_ns": BOUND}),
        ("time", {"heard_ns": MAX, "heard_sent_ns": 1}),
        ("time", {"heard_sent_ns": MAX}),
        ("count", {"expected": MAX, "heard_sent_ns": 1}),
        ("count", {"expected": 1, "arrived": 2, "heard_sent_ns": 1}),
    ],
)
def test_a_report_that_no_sender_can_give_is_refused_by_name(cause: str, fields: dict[str, int]) -> None:
    with pair() as ends:
        ends.joined()
        sealer = ends.slave.end._agreement.sealer
        assert sealer is not None
        arrived = ends.master.end.arrivals.arrived
        send(ends.slave, sealer.seal(report(ends.slave.end, **fields)))
        ends.master.take()
        assert ends.master.end.rejected[cause] == 1
        assert ends.master.end.arrivals.arrived == arrived
        ends.turns(200)
        check(ends.master)
        assert ends.master.end.receiving == "datagram"
        assert ends.master.end.rejected[cause] == 1


@pytest.mark.parametrize("times", [(0, 0, 0), (0, 1, BOUND - 1), (BOUND - 1, 1, BOUND - 1), (BOUND - 1, BOUND - 1, 1)])
def test_the_extremes_of_what_is_taken_are_summed_up(times: tuple[int, int, int]) -> None:
    with pair() as ends:
        ends.joined()
        fields = dict(zip(("sent_ns", "heard_sent_ns", "heard_ns"), times, strict=True))
        for _ in range(200):
            sealer = ends.slave.end._agreement.sealer
            assert sealer is not None
            send(ends.slave, sealer.seal(report(ends.slave.end, **fields, expected=BOUND - 1, arrived=0)))
            ends.turn(send=False)
        assert "time" not in ends.master.end.rejected
        check(ends.master)


@pytest.mark.parametrize("number", [2**40, 2**62, 2**63 - 1])
def test_a_number_that_no_sender_can_have_reached_is_refused_and_leaves_the_window(number: int) -> None:
    with pair() as ends:
        ends.joined()
        sealer = ends.slave.end._agreement.sealer
        assert sealer is not None
        own, sealer.number = sealer.number, number
        jump = sealer.seal(report(ends.slave.end))
        sealer.number = own
        send(ends.slave, jump)
        ends.turns(200)
        assert ends.master.end.rejected["ahead"] == 1
        assert ends.master.end.arrivals.lost == 0
        assert ends.master.seqs[-1] == ends.slave.seq - 1


def test_the_receiver_may_stand_still_for_ten_minutes_and_take_the_next_number() -> None:
    with pair() as ends:
        ends.joined()
        sealer = ends.slave.end._agreement.sealer
        assert sealer is not None
        for side in ends.sides:
            side.clock.advance_ns(600 * 10**9)
        # a thousand a second were sent meanwhile, none of which arrived; the first that does says so
        sealer.number += 600_000
        for _ in range(2):
            send(ends.slave, sealer.seal(report(ends.slave.end)))
            ends.master.take()
        assert "ahead" not in ends.master.end.rejected
        assert ends.master.end._agreement.opener is not None
        assert ends.master.end._agreement.opener.window.newest == sealer.number - 1


@pytest.mark.parametrize("jump", [WINDOW - 1, WINDOW, WINDOW + 1, 10 * WINDOW, 10**7, 2**40])
def test_a_jump_is_counted_without_a_step_for_each_number(jump: int) -> None:
    window, account = ReplayWindow(), ArrivalRecord()
    account.begin(window)
    numbers = [*range(2000), *range(2000 + jump, 4000 + jump)]
    for turn, number in enumerate(numbers):
        window.record(number)
        account.record(number, 0, turn)
        if turn % 50 == 0:
            account.settle(turn * 1_000_000)
    account.settle(len(numbers) * 1_000_000)
    account.settle(len(numbers) * 1_000_000 + LinkNetwork.SETTLE_NS)
    assert account.sent == 4000 + jump
    assert account.arrived == 4000
    assert account.lost == jump
    assert len(account.take_fates().number) <= MOST_ROWS
