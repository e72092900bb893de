"""A measured network becomes a trace, and the link replays it: the same delays, the same losses."""

import random
from pathlib import Path

import numpy as np
import pytest

from analysis.network_trace import DIRECTIONS, QUANTILES, longest_run, traces_of, write_traces
from proto.errors import TelenanoError
from proto.messages import Array, LinkClock
from proto.network_messages import LinkNetwork
from services.delay_node.config import parse_settings
from services.delay_node.engine import fates_of

NS_PER_MS = 1_000_000
BEGAN_NS = 10**18


def reports(direction: str, count: int = 4000, per_report: int = 500, *, valid: bool = True) -> list[LinkNetwork]:
    """Make what an end reports of a network with a wandering delay of some 40 ms and bursts of losses."""
    draw = random.Random(direction)
    wander_ms, lost_left, made = 0.0, 0, []
    rows = []
    for number in range(count):
        wander_ms = 0.99 * wander_ms + draw.gauss(0.0, 0.4)
        lost_left = max(lost_left - 1, 0) or (draw.randint(1, 4) if draw.random() < 0.02 else 0)
        delay_ns = 0 if lost_left else round((40.0 + wander_ms + draw.expovariate(2.0)) * NS_PER_MS)
        arrived_ns = 0 if lost_left else BEGAN_NS + number * NS_PER_MS + delay_ns
        rows.append((number, arrived_ns, delay_ns, int(bool(lost_left))))
    # what was given up is reported a second after those around it, and what came after all has a second row
    late_news = [row for row in rows if row[3]]
    rows = [row for row in rows if not row[3]]
    for place, row in enumerate(late_news):
        rows.insert(min(len(rows), row[0] + 900 + place), row)
    for saved in late_news[:1]:
        rows.append((saved[0], BEGAN_NS + saved[0] * NS_PER_MS + 41 * NS_PER_MS, 41 * NS_PER_MS, 0))
    clock = LinkClock(valid=valid, offset_s=0.0, uncertainty_s=0.04, round_trip_s=0.08, exchanges=64)
    for seq, first in enumerate(range(0, len(rows), per_report)):
        columns = np.array(rows[first : first + per_report], dtype="i8").T
        made.append(
            LinkNetwork(
                seq=seq, t_ns=BEGAN_NS, src="controller@slave", v=1, direction=direction, receiving="datagram",
                sending="datagram", sent=count, arrived=0, late=seq, lost=0, refused={}, repeats=0, unsent=0,
                sent_bytes=0, delay_valid=True, delay_min_s=0.0, delay_mean_s=0.0, delay_max_s=0.0, clock=clock,
                number=Array.from_numpy(columns[0]), arrived_ns=Array.from_numpy(columns[1]),
                delay_ns=Array.from_numpy(columns[2]), lost_flag=Array.from_numpy(columns[3].astype("u1")),
            )
        )  # fmt: skip
    return made


def test_the_link_replays_the_delays_and_losses_that_were_measured(tmp_path: Path) -> None:
    traces = traces_of([*reports("forward"), *reports("backward")])
    settings = parse_settings(write_traces(traces, tmp_path))
    for direction in DIRECTIONS:
        trace = traces[direction]
        assert len(trace.sent_s) > 3990
        assert np.all(np.diff(trace.sent_s) > 0.0)
        assert 0.02 < trace.lost.mean() < 0.08
        assert trace.summary()["longest_loss"] == longest_run(trace.lost) >= 3
        sent_ns = np.round(trace.sent_s * 1e9).astype(int).tolist()[:-1]
        fates = fates_of(settings, direction, "teleop/forward", sent_ns, 300, folder=tmp_path)
        fates = [fate for fate in fates if fate.copy == 0]
        assert [fate.dropped == "loss_trace" for fate in fates] == trace.lost[:-1].tolist()
        replayed_s = np.array([fate.delay_ns * 1e-9 for fate in fates if not fate.dropped])
        np.testing.assert_allclose(replayed_s, trace.arrived_s[: len(replayed_s)], rtol=0.0, atol=2e-6)
        for share in QUANTILES:
            assert abs(np.quantile(replayed_s, share) - np.quantile(trace.arrived_s, share)) < 1e-3
        # commands and events are carried as by a connection that retransmits, and half a period later nothing differs
        kept = fates_of(settings, direction, "session/control", sent_ns, 300, folder=tmp_path)
        assert {fate.dropped for fate in kept} == {""}


def test_what_says_nothing_of_a_network_is_refused_or_left_out() -> None:
    assert traces_of(reports("forward", valid=False)) == {}
    with pytest.raises(TelenanoError, match=r"forward: 5[0-9] datagrams arrived, too few"):
        traces_of(reports("forward", count=60))
    forward = traces_of(reports("forward"))["forward"]
    # one that was given up and came after all arrived
    rows = [
        (int(number), bool(lost))
        for report in reports("forward")
        for number, lost in zip(report.number.to_numpy(), report.lost_flag.to_numpy(), strict=True)
    ]
    arrived = {number for number, lost in rows if not lost}
    lost = {number for number, lost in rows if lost} - arrived
    assert forward.lost.sum() == sum(min(arrived) < number < max(arrived) for number in lost)
    assert len({number for number, lost in rows if lost}) == len(lost) + 1


def test_what_was_lost_in_the_last_second_counts_before_it_is_reported() -> None:
    whole = reports("forward")
    cut = []
    for report in whole:
        columns = {name: getattr(report, name).to_numpy() for name in ("number", "arrived_ns", "delay_ns", "lost_flag")}
        # a second of a thousand a second
        told = (columns["lost_flag"] == 0) | (columns["number"] < 3000)
        kept = {name: Array.from_numpy(np.ascontiguousarray(values[told])) for name, values in columns.items()}
        cut.append(report.model_copy(update=kept))
    expected, found = (traces_of(given)["forward"] for given in (whole, cut))
    assert expected.lost[-900:].any()
    assert np.array_equal(found.lost, expected.lost)
    assert np.array_equal(found.delay_s, expected.delay_s)
    assert np.allclose(found.sent_s, expected.sent_s, rtol=0.0, atol=1e-6)
