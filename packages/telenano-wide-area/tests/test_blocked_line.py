"""UDP that is blocked one way or both, over networks that are drawn: the tip is held shortly and never withdrawn."""

import random
from itertools import pairwise

import pytest
from blocked_line_bench import DEADLINE_S, MS, WITHDRAWN_S, Network, S, Session
from telenano_wide_area.datagram.reception import SILENCE_NS
from telenano_wide_area.datagram.sparse import CALM_NS, SparseSamples, carried_by_tcp

EVER_NS = 10**12
# After this a session has begun, and its line was measured; then something is blocked.
BEGUN_S = 2.0
OTHER = {"forward": "backward", "backward": "forward"}
RECEIVER = {"forward": "slave", "backward": "master"}
PATTERNS = ("from the start", "from a moment on", "for a while")
RATES_HZ = (125.0, 250.0, 250.0, 500.0, 1000.0)


def drawn(number: int) -> tuple[Network, float, str]:
    """Draw a network, a rate, and when something is blocked; nobody has looked at the numbers."""
    draw = random.Random(7300 + number)
    pattern = PATTERNS[number % 3]
    begin_ns = 0 if pattern == "from the start" else round(draw.uniform(BEGUN_S, BEGUN_S + 0.3) * S)
    end_ns = begin_ns + round(draw.uniform(0.4, 1.6) * S) if pattern == "for a while" else EVER_NS
    ways = [("forward",), ("backward",), ("forward", "backward")][draw.randrange(3)]
    network = Network(
        delay_s=draw.uniform(0.005, 0.075),
        loss=draw.choice((0.0, 0.0, 0.01, 0.02)),
        rate_bit_per_s=0.0 if pattern == "from the start" else draw.choice((0.0, 0.0, 4e6, 2e6)),
        blocks=dict.fromkeys(ways, (begin_ns, end_ns)),
        seed=number,
    )
    return network, draw.choice(RATES_HZ), pattern


@pytest.mark.parametrize("number", range(12))
def test_a_block_holds_the_tip_for_a_deadline_and_a_round_trip_at_most(number: int) -> None:
    network, rate_hz, pattern = drawn(number)
    session = Session(network, rate_hz)
    try:
        session.run(BEGUN_S - 0.5 if pattern != "from the start" else 3.5)
        session.end_trains()
        session.run(0.4)
        session.forget()
        session.run(3.1)
        again_s = session.worst_again * 2.5 * network.delay_s
        for way in OTHER:
            silence_s = session.longest_s(RECEIVER[way])
            if way in network.blocks or pattern == "from the start":
                # A packet of TCP that is lost holds up what follows until it was sent again.
                most_s = 2.0 * DEADLINE_S + 2.0 * network.delay_s + again_s
                assert silence_s <= most_s, way
                assert silence_s < WITHDRAWN_S, way
            else:
                assert silence_s <= DEADLINE_S, f"{way} was not blocked"
                assert session.end_of(way).receiving == "datagram"
        for way, (begin_ns, end_ns) in network.blocks.items():
            said = session.said_of(way)
            assert said[-1].receiving == ("datagram" if end_ns < EVER_NS else "stream")
            since = {report.blocked_since_ns for report in said} - {None}
            sends = pattern != "from the start" or way == "backward" or "backward" not in network.blocks
            # The master's end learns the address of the slave's from its datagrams: until then it sends none.
            if sends and end_ns - begin_ns > SILENCE_NS + S:
                (since_ns,) = since
                assert abs(since_ns - session.epoch_ns - begin_ns) < (network.delay_s + 0.1) * S
            assert (said[-1].blocked_since_ns is not None) == (sends and end_ns == EVER_NS)
        for way in OTHER:
            if way not in network.blocks and pattern != "from the start":
                assert {report.blocked_since_ns for report in session.said_of(way)} == {None}
    finally:
        session.close()


def test_a_block_is_named_with_its_direction_and_its_time() -> None:
    session = Session(Network(0.02, 0.0, 0.0, {"backward": (round(BEGUN_S * S), EVER_NS)}), 250.0)
    try:
        session.run(5.0)
        (text,) = [event.text for event in session.master.events if "is blocked" in event.text]
        assert "is blocked from the slave to the master since 01:46:4" in text
        assert not [event.text for event in session.slave.events if "blocked" in event.text]
        assert session.slave.end.receiving == "datagram"
        assert session.master.end.receiving == "stream"
    finally:
        session.close()


def test_an_outage_of_everything_is_not_called_a_block() -> None:
    network = Network(0.02, 0.0, 0.0, dict.fromkeys(OTHER, (round(BEGUN_S * S), round((BEGUN_S + 0.9) * S))))
    session = Session(network, 250.0)
    try:
        for way in session.ways.values():
            way.tcp_is_cut = True
        session.run(6.0)
        said = [report for way in OTHER for report in session.said_of(way)]
        assert {report.blocked_since_ns for report in said} == {None}
    finally:
        session.close()


def test_what_tcp_carries_follows_the_capacity_and_the_losses() -> None:
    assert carried_by_tcp(0, 0.0, 0.04) == float("inf")
    assert carried_by_tcp(2_000_000, 0.0, 0.04) == 2e6
    # Mathis et al. (1997): 1400 bytes, 150 ms, 2 %
    assert carried_by_tcp(0, 0.02, 0.15) == pytest.approx(8 * 1400 * 1.2247 / (0.15 * 0.02**0.5), rel=1e-4)
    assert carried_by_tcp(400_000, 0.02, 0.15) == 4e5


@pytest.mark.parametrize(
    ("carried", "alone", "share"), [(float("inf"), False, 1.0), (2e6, False, 0.05), (2e6, True, 0.3)]
)
def test_sparse_samples_take_a_share_of_a_narrow_line(carried: float, alone: bool, share: float) -> None:
    sparse = SparseSamples()
    sparse.carried, sparse.alone = carried, alone
    found = [sparse.takes("teleop/forward", 300, at_ms * MS) for at_ms in range(10_000)]
    prefixes = [prefix for prefix in found if prefix is not None]
    # By turns, so that a connection that waits holds up every other one.
    assert all(before != after for before, after in pairwise(prefixes))
    taken = len(prefixes)
    assert taken * 8 * (300 + 250) / 10.0 <= 1.01 * share * carried
    assert taken >= 10_000 * MS // (5 * CALM_NS)
    assert sum(sparse.takes("law/status", 300, at_ms * MS) is not None for at_ms in range(10_000)) <= 101
