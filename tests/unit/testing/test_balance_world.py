"""The world of an order: lines that step, overtake, hold back and lose; samples that jump and creep."""

from dataclasses import replace

import numpy as np
import pytest

from telenano.sections import LAWS
from telenano.testing.law_balance.balance import balance
from telenano.testing.law_balance.balance_draws import ADVERSE, EVERYTHING, LineDraw, Order, drawn
from telenano.testing.law_balance.balance_world import Line, lines_of, sample_of

T = 1e-3
TICKS = 20_000


def order_of(**line: float | str) -> Order:
    return replace(drawn(3, 0, "hold"), period_s=T, line=replace(LineDraw(0.02, 0.02, 0.0), **line))


def newest(line: Line) -> list[int]:
    """Return the newest message that has arrived, of each period."""
    rows, at, best = [], 0, -1
    for tick in range(TICKS):
        while at < len(line.when) and line.when[at] <= tick:
            best = max(best, int(line.number[at]))
            at += 1
        rows.append(best)
    return rows


def test_a_constant_line_delays_each_message_by_as_much() -> None:
    line, _ = lines_of(order_of(), TICKS)
    assert (line.when - line.number == 20).all() and len(line.number) == TICKS


@pytest.mark.parametrize("shape", ["steps", "sawtooth", "random", "slots"])
def test_no_line_is_earlier_than_its_least_delay_or_later_than_its_spread(shape: str) -> None:
    line, back = lines_of(order_of(shape=shape, spread_s=0.05, every_s=0.04), TICKS)
    late = line.when - line.number
    assert late.min() >= 20 and late.max() <= 71
    assert not np.array_equal(line.when - line.number, back.when - back.number) or shape == "slots"
    assert (np.diff(line.when) >= 0).all()


def test_lines_overtake_where_their_delay_shrinks_faster_than_time_passes() -> None:
    for shape, overtakes in (("constant", False), ("slots", False), ("sawtooth", True), ("random", True)):
        line, _ = lines_of(order_of(shape=shape, spread_s=0.05, every_s=0.02), TICKS)
        assert bool((np.diff(line.number) < 0).any()) == overtakes, shape


def test_slots_bring_all_messages_at_their_ends() -> None:
    line, _ = lines_of(order_of(shape="slots", every_s=0.05), TICKS)
    assert set((line.when % 50).tolist()) == {0}
    assert len(set(newest(line))) <= TICKS / 50 + 1


@pytest.mark.parametrize("burst", [1.0, 20.0])
def test_a_line_loses_its_share_in_bursts_of_the_mean_length(burst: float) -> None:
    line, _ = lines_of(order_of(lost=0.2, burst=burst), TICKS)
    lost = np.ones(TICKS, dtype=bool)
    lost[line.number] = False
    assert lost.mean() == pytest.approx(0.2, abs=0.05)
    bursts = np.count_nonzero(np.diff(lost.astype(int)) == 1)
    assert lost.sum() / bursts == pytest.approx(1.25 if burst == 1.0 else burst, rel=0.3)


def test_a_sample_jumps_there_and_back_and_creeps_ever_slower() -> None:
    draw = replace(drawn(3, 0, "hold").sample, place_m=1e-9, drift_m_per_s=0.0)
    jumps = sample_of(replace(draw, jump_m=2e-9, jump_every_s=0.5), 1.0, TICKS, T).surface_m
    assert set(np.round(1e9 * jumps, 6).tolist()) == {1.0, 3.0}
    assert np.count_nonzero(np.diff(jumps)) == TICKS * T / 0.5 - 1
    creeps = np.diff(sample_of(replace(draw, creep_m=1e-9), 1.0, TICKS, T).surface_m)
    assert (creeps > 0.0).all() and (np.diff(creeps) < 0.0).all()


@pytest.mark.check("compiles two laws")
@pytest.mark.drawn(0.2, "telenano/testing/law_balance/", "telenano/numerics/")
@pytest.mark.parametrize("name", ["wave", "two_layer"])
@pytest.mark.parametrize("kind", [*ADVERSE, EVERYTHING])
def test_an_order_is_the_same_compiled_and_as_plain_python(name: str, kind: str) -> None:
    order = drawn(5, 2, kind, longest_s=3.0)
    assert balance(LAWS[name], order, fast=True) == balance(LAWS[name], order)


@pytest.mark.parametrize("quantum_m", [0.0, 1e-10])
def test_the_tolerance_is_what_the_law_states_and_a_step_of_the_base(quantum_m: float) -> None:
    law = LAWS["wave"]
    order = replace(drawn(5, 2, "quantised force", longest_s=1.2), base_quantum_m=quantum_m)
    most_n, step_m = order.hand.most_n, quantum_m / law.config().position_scale  # type: ignore[attr-defined]
    found = balance(law, order).tolerance_j
    assert found >= law.passive_within_j + 0.5 * most_n * step_m
    assert (found == law.passive_within_j) == (quantum_m == 0.0)
