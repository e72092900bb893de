import math

import numpy as np
import pytest

from services.delay_node.config import Outage
from services.delay_node.models.outages import Outages
from services.delay_node.random_streams import stream

MS = 1_000_000
ORIGIN = 5_000 * MS


def outages(**keys):
    return Outages(Outage(**keys), ORIGIN, stream(31, "outage"))


def test_scheduled_outages_are_exact_and_end_when_they_say():
    link = outages(schedule=((0.010, 0.005), (0.020, 0.001)))
    expected = {0: None, 10 * MS - 1: None, 10 * MS: 15, 15 * MS - 1: 15, 15 * MS: None, 20 * MS: 21, 21 * MS: None}
    for elapsed, end in expected.items():
        assert link.end_ns(ORIGIN + elapsed) == (None if end is None else ORIGIN + end * MS)
    assert link.end_ns(ORIGIN + 10**12) is None


def test_schedule_repeats_with_its_period():
    link = outages(schedule=((0.0, 0.002),), period_s=0.010)
    down = [link.end_ns(ORIGIN + k * MS) is not None for k in range(100)]
    assert down == [k % 10 < 2 for k in range(100)]


def test_touching_outages_are_one():
    link = outages(schedule=((0.001, 0.001), (0.002, 0.003)))
    assert link.end_ns(ORIGIN + MS) == ORIGIN + 5 * MS


def test_random_outages_have_the_share_and_the_lengths_of_their_law():
    up_s, down_s = 0.080, 0.020
    link = outages(mean_up_s=up_s, mean_down_s=down_s)
    step_ns, steps = MS // 2, 2_000_000
    ends = [link.end_ns(ORIGIN + k * step_ns) for k in range(steps)]
    down = np.array([end is not None for end in ends])
    cycles = steps * step_ns * 1e-9 / (up_s + down_s)
    # Alternating exponential times: the share has the variance 2 u^2 d^2 / (u + d)^4 per cycle.
    sigma = math.sqrt(2 * up_s**2 * down_s**2 / (up_s + down_s) ** 4 / cycles)
    assert abs(down.mean() - down_s / (up_s + down_s)) < 4 * sigma
    first = [(k, end) for k, end in enumerate(ends) if end is not None and (k == 0 or ends[k - 1] != end)]
    # Exponential lengths have no memory: what remains at the first look has the mean of the whole.
    remaining_s = np.array([end - ORIGIN - k * step_ns for k, end in first]) * 1e-9
    assert abs(remaining_s.mean() / down_s - 1) < 4 / math.sqrt(len(remaining_s))


def test_random_outages_do_not_depend_on_when_one_looks():
    every, some = outages(mean_up_s=0.01, mean_down_s=0.005), outages(mean_up_s=0.01, mean_down_s=0.005)
    seen = {k: every.end_ns(ORIGIN + k * MS // 4) for k in range(8000)}
    for k in range(0, 8000, 77):
        assert some.end_ns(ORIGIN + k * MS // 4) == seen[k]


def test_schedule_and_chance_together_are_down_when_either_is():
    chance = outages(mean_up_s=0.01, mean_down_s=0.005)
    both = outages(mean_up_s=0.01, mean_down_s=0.005, schedule=((0.5, 0.1),))
    for k in range(1000):
        now = ORIGIN + k * MS
        either = chance.end_ns(now) is not None or 500 <= k < 600
        assert (both.end_ns(now) is not None) == either


def test_a_long_pause_is_not_walked_through_and_keeps_the_law():
    hour_ns, up_s, down_s = 3600 * 10**9, 3e-6, 1e-6
    settings = Outage(mean_up_s=up_s, mean_down_s=down_s)
    draws, ends = [], []
    for seed in range(4000):
        draw = stream(seed, "outage")
        link = Outages(settings, ORIGIN, lambda draw=draw: draws.append(0) or draw())
        ends.append(link.end_ns(ORIGIN + hour_ns))
    assert len(draws) <= 8 * len(ends)
    remaining_s = np.array([end - ORIGIN - hour_ns for end in ends if end is not None]) * 1e-9
    share = down_s / (up_s + down_s)
    assert abs(len(remaining_s) / len(ends) - share) < 4 * math.sqrt(share * (1 - share) / len(ends))
    # an outage that goes on has the mean of a whole one, to the nanosecond that is the least
    assert abs(remaining_s.mean() / down_s - 1) < 5 / math.sqrt(len(remaining_s))


def test_log_normal_lengths_have_their_mean_and_their_spread():
    mean_s, spread = 0.265, 0.3
    link = outages(mean_up_s=0.5, mean_down_s=mean_s, down_spread=spread)
    now, lengths = ORIGIN, []
    while len(lengths) < 4000:
        now += MS
        if (end := link.end_ns(now)) is not None:
            lengths.append((end - now) * 1e-9)
            now = end
    # The look comes up to 1 ms after the begin.
    assert np.mean(lengths) == pytest.approx(mean_s, abs=0.001 + 4 * spread * mean_s / math.sqrt(len(lengths)))
    assert np.std(np.log(lengths)) == pytest.approx(spread, abs=4 * spread / math.sqrt(2 * len(lengths)) + 0.003)
