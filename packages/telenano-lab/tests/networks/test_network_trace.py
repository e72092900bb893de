"""A measured network becomes a trace, and the link replays it: the same delays, the same losses."""

import random
from pathlib import Path

import msgspec
import numpy as np
import pytest
from telenano_lab.networks.network_trace import DIRECTIONS, QUANTILES, longest_run, traces_of, write_traces

from telenano.link import DirectionEngine
from telenano.settings import LinkSettings
from telenano.timing import OffsetFilter
from telenano.wire import Array, LinkClock, LinkNetwork, TelenanoError

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
    settings = LinkSettings.of(write_traces(traces, tmp_path))
    for direction in DIRECTIONS:
        trace = traces[direction]
        assert len(trace.sent_s) > 3990
        assert np.all(np.diff(trace.sent_s) > 0.0)
        assert 0.02 < trace.lost.mean() < 0.08
        assert trace.summary()["longest_loss"] == longest_run(trace.lost) >= 3
        # whatever is sent when, in the place of what was measured
        sent_ns = (np.arange(len(trace.sent_s) - 1) * 1_300_000).tolist()
        fates = DirectionEngine.fates(settings, direction, "teleop/forward", sent_ns, 300, folder=tmp_path)
        fates = [fate for fate in fates if fate.copy == 0]
        assert [fate.dropped == "loss_trace" for fate in fates] == trace.lost[:-1].tolist()
        replayed_s = np.array([fate.delay_ns * 1e-9 for fate in fates if not fate.dropped])
        np.testing.assert_allclose(replayed_s, trace.arrived_s[: len(replayed_s)], rtol=0.0, atol=2e-6)
        for share in QUANTILES:
            assert abs(np.quantile(replayed_s, share) - np.quantile(trace.arrived_s, share)) < 1e-3
        # commands and events are carried as by a connection that retransmits, and half a period later nothing differs
        kept = DirectionEngine.fates(settings, direction, "session/control", sent_ns, 300, folder=tmp_path)
        assert {fate.dropped for fate in kept} == {""}


def test_what_says_nothing_of_a_network_is_refused_or_left_out() -> None:
    assert traces_of(reports("forward", valid=False)) == {}
    with pytest.raises(TelenanoError, match=r"forward: 5[0-9] datagrams arrived, too few"):
        traces_of(reports("forward", count=60))
    # nor does a direction in which nothing crossed while it was looked at
    none = np.zeros(0, dtype="i8")
    fields = {name: Array.from_numpy(none) for name in ("number", "arrived_ns", "delay_ns")}
    fields["lost_flag"] = Array.from_numpy(none.astype("u1"))
    silent = [msgspec.structs.replace(report, **fields) for report in reports("backward", count=60)]
    with pytest.raises(TelenanoError, match="backward: 0 datagrams arrived, too few"):
        traces_of(silent)
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
        cut.append(msgspec.structs.replace(report, **kept))
    expected, found = (traces_of(given)["forward"] for given in (whole, cut))
    assert expected.lost[-900:].any()
    assert np.array_equal(found.lost, expected.lost)
    assert np.array_equal(found.delay_s, expected.delay_s)
    assert np.allclose(found.sent_s, expected.sent_s, rtol=0.0, atol=1e-6)


def test_what_a_report_left_out_over_a_full_line_is_not_counted_as_lost() -> None:
    whole, arrived = reports("forward"), 0
    for place, report in enumerate(whole):
        arrived += int((report.lost_flag.to_numpy() == 0).sum())
        whole[place] = msgspec.structs.replace(report, arrived=arrived)
    names = ("number", "arrived_ns", "delay_ns", "lost_flag")
    told = [*whole]
    told[-2] = msgspec.structs.replace(
        whole[-2], **{name: Array.from_numpy(getattr(whole[-2], name).to_numpy()[:0]) for name in names}
    )
    expected, found = (traces_of(given)["forward"] for given in (whole, told))
    assert expected.lost.sum() - 30 <= found.lost.sum() <= expected.lost.sum()


AHEAD_S, DRIFT = 0.3, 2e-4


def measured(jitter: str) -> tuple[list[LinkNetwork], dict[str, np.ndarray]]:
    """Give the reports of both ends of a network of 20 ms with jitter in order, over 12 s, and the delays of each way.

    The slave's clock is ahead and drifts. Each end reports what its own exchanges of time stamps tell until then.
    """
    draw = np.random.default_rng(11)
    count, step_s = 12_000, 1e-3
    sent_s = np.arange(count) * step_s
    delays = {}
    for way in DIRECTIONS:
        spread = {"normal": draw.normal(0.0, 3e-3, count), "uniform": draw.uniform(-6e-3, 6e-3, count)}[jitter]
        arrived = np.maximum.accumulate(sent_s + np.maximum(0.02 + spread, 0.0))
        delays[way] = arrived - sent_s

    def slave_s(time_s: np.ndarray) -> np.ndarray:
        return time_s + AHEAD_S + DRIFT * time_s

    there = np.rint((slave_s(sent_s + delays["forward"]) - sent_s) * 1e9).astype(np.int64)
    back = np.rint((sent_s + delays["backward"] - slave_s(sent_s)) * 1e9).astype(np.int64)
    filters = {way: OffsetFilter(64) for way in DIRECTIONS}
    made = []
    for seq, first in enumerate(range(0, count, 500)):
        rows = slice(first, first + 500)
        for k in range(first, first + 500):
            asked_ns = BEGAN_NS + k * NS_PER_MS
            # the newest datagram of the other way, some 21 ms before
            other = max(0, k - 30)
            other_ns = BEGAN_NS + other * NS_PER_MS
            arrived_ns = asked_ns + int(back[k]) + round(1e9 * (AHEAD_S + DRIFT * k * step_s))
            slave_ns = asked_ns + round(1e9 * (AHEAD_S + DRIFT * k * step_s))
            filters["backward"].record(other_ns, other_ns + int(there[other]), slave_ns, arrived_ns)
            other_slave_ns = other_ns + round(1e9 * (AHEAD_S + DRIFT * other * step_s))
            filters["forward"].record(
                other_slave_ns, other_slave_ns + int(back[other]), asked_ns, asked_ns + int(there[k])
            )
        for way, transit in (("forward", there), ("backward", back)):
            estimate = filters[way].estimate()
            assert estimate is not None
            clock = LinkClock(valid=True, **estimate._asdict())
            number = np.arange(first, first + 500)
            left_ns = BEGAN_NS + number * NS_PER_MS
            if way == "backward":
                left_ns = left_ns + np.rint(1e9 * (AHEAD_S + DRIFT * number * step_s)).astype(np.int64)
            delay_ns = np.maximum(transit[rows] + round(estimate.offset_s * 1e9), 0)
            (template,) = reports(way, 1, 1)
            columns = {"number": number, "arrived_ns": left_ns + transit[rows], "delay_ns": delay_ns}
            arrays = {key: Array.from_numpy(values) for key, values in columns.items()}
            lost = Array.from_numpy(np.zeros(500, dtype="u1"))
            made.append(msgspec.structs.replace(template, seq=seq, clock=clock, lost_flag=lost, **arrays))
    return made, delays


@pytest.mark.parametrize("jitter", ["normal", "uniform"])
def test_delays_of_a_probe_are_those_of_the_wire_with_jitter_and_two_clocks(jitter: str) -> None:
    made, delays = measured(jitter)
    for direction, trace in traces_of(made).items():
        places = np.sort(np.concatenate([trace.arrived_s, delays[direction]]))
        shares = [
            np.searchsorted(np.sort(values), places, side="right") / len(values)
            for values in (trace.arrived_s, delays[direction])
        ]
        assert np.abs(shares[0] - shares[1]).max() <= 0.05
        # neighbours keep what they have in common
        assert np.corrcoef(trace.arrived_s, delays[direction][: len(trace.arrived_s)])[0, 1] > 0.99
