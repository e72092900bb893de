"""Late cycles of a loop: their count, its interval and a hand's record of them, against loops that know the truth."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[3] / "benchmarks"))
import tables
from cycles import Cycle, Late, Samples, later_than, matched, responses_ms, runs_in_million
from late_cycles import BESIDE, HEAD, LOOPS, cells, ratio

PERIOD_NS = 1_000_000
SEEDS = range(40)


def test_a_deadline_that_was_skipped_ends_with_the_next_cycle() -> None:
    stood_still_ns = 5_200_000
    cycles = [Cycle(0, 10, 1_000), Cycle(5 * PERIOD_NS, stood_still_ns, stood_still_ns + 1_000)]
    assert responses_ms(cycles, PERIOD_NS) == pytest.approx([0.001, 4.201, 3.201, 2.201, 1.201, 0.201], rel=1e-9)
    assert later_than(responses_ms(cycles, PERIOD_NS), 1.0) == Late((4,), 6)
    assert responses_ms([], PERIOD_NS).size == 0


@pytest.mark.parametrize("seed", SEEDS)
def test_each_deadline_ends_with_the_first_answer_to_it_or_to_a_later_one(seed: int) -> None:
    rng = np.random.default_rng(seed)
    numbers = np.flatnonzero(rng.random(200) < rng.uniform(0.2, 1.0))
    ends_ns = numbers * PERIOD_NS + np.round(rng.exponential(rng.uniform(1e5, 3e6), numbers.size)).astype(int)
    cycles = [
        Cycle(n * PERIOD_NS, n * PERIOD_NS, end) for n, end in zip(numbers.tolist(), ends_ns.tolist(), strict=True)
    ]
    wanted = []
    for number in range(numbers[0], numbers[-1] + 1):
        end_ns = min(end for n, end in zip(numbers.tolist(), ends_ns.tolist(), strict=True) if n >= number)
        wanted.append((end_ns - number * PERIOD_NS) * 1e-6)
    found = responses_ms(cycles, PERIOD_NS)
    assert found == pytest.approx(wanted, rel=1e-9)
    late = later_than(found, 1.0)
    text = "".join("x" if value > 1.0 else " " for value in wanted)
    assert late.runs == tuple(map(len, text.split()))
    assert late.cycles == len(wanted)


def test_the_interval_of_a_rate_has_the_true_one() -> None:
    rng = np.random.default_rng(7)
    cycles = 30_000
    for expected in (0.3, 1.0, 3.0, 10.0, 100.0):
        true_rate = 1e6 * expected / cycles
        outside = 0
        for count in rng.poisson(expected, 1000).tolist():
            lengths = rng.geometric(0.3, count).tolist()
            found = runs_in_million(Late(tuple(lengths), cycles))
            assert found.low <= found.rate <= found.high
            outside += not found.low <= true_rate <= found.high
        assert outside <= 70, expected


def test_an_interval_gets_narrower_and_rounds_add_up() -> None:
    few, many = Late((1, 4), 10_000), Late((2,) * 200, 1_000_000)
    assert (few + few) == Late((1, 4, 1, 4), 20_000)
    assert few.in_million == 500.0
    assert runs_in_million(few).rate == runs_in_million(many).rate == 200.0
    narrow, wide = runs_in_million(many), runs_in_million(few)
    assert wide.low < narrow.low < 200.0 < narrow.high < wide.high
    nothing = runs_in_million(Late((), 1_000_000))
    assert (nothing.rate, nothing.low) == (0.0, 0.0)
    assert nothing.high == pytest.approx(3.689, rel=1e-3)


class Rig:
    """A hand that samples on a grid, skips what it missed and shows the newest answer; it knows when each one came."""

    def __init__(self, seed: int, usual_ms: float, spread_ms: float) -> None:
        rng = np.random.default_rng(seed)
        first_ns, number, last_number = int(rng.integers(10**18)), 0, -1
        self.sent: dict[int, int] = {}
        rows: list[tuple[int, int, int, int]] = []
        self.arrivals: list[tuple[int, int, int]] = []
        shown = (0, 0)
        for _ in range(3000):
            # now and then the hand itself stands still
            number += 1 if rng.random() > 0.003 else int(rng.integers(2, 9))
            now_ns = first_ns + number * PERIOD_NS + int(rng.integers(0, 20_000))
            for end_ns, stamp, _ in self.arrivals[-40:]:
                if end_ns <= now_ns and stamp > shown[0]:
                    shown = (stamp, end_ns)
            rows.append((number - last_number, now_ns, *shown))
            last_number = number
            end_ns = now_ns + round(1e6 * max(0.2, usual_ms + spread_ms * rng.standard_exponential()))
            if rng.random() < 0.99:
                # the others were superseded on their way
                self.arrivals.append((end_ns, now_ns, first_ns + number * PERIOD_NS))
                self.sent[now_ns] = end_ns - int(rng.integers(60_000, 120_000))
        rows[0] = (1, *rows[0][1:])
        self.samples = Samples(*np.array(rows, np.int64).T)
        taken = [Cycle(due, stamp, end) for end, stamp, due in self.arrivals]
        self.true_ms = responses_ms(taken, PERIOD_NS)


@pytest.mark.parametrize("spread_ms", [0.1, 0.4, 0.8])
@pytest.mark.parametrize("usual_ms", [0.4, 0.8, 1.1])
def test_what_a_hand_shows_gives_the_late_cycles_of_its_loop(usual_ms: float, spread_ms: float) -> None:
    wrong = late = 0
    for seed in range(2):
        rig = Rig(seed, usual_ms, spread_ms)
        found = responses_ms(matched(rig.samples, rig.sent, PERIOD_NS), PERIOD_NS)
        length = min(found.size, rig.true_ms.size) - 30
        limit_ms = float(np.median(rig.true_ms)) + 1.0
        assert np.median(found) == pytest.approx(np.median(rig.true_ms), abs=0.03)
        is_late = rig.true_ms[:length] > limit_ms
        wrong += int(np.sum((found[:length] > limit_ms) != is_late))
        late += int(is_late.sum())
    assert late > 50
    # a command that another one overtook is given the median way to the hand
    assert wrong <= 0.05 * late


def test_a_rig_that_answers_nothing_more_is_late_until_the_end() -> None:
    rig = Rig(0, 0.5, 0.1)
    half = rig.samples.answered_ns.size // 2
    for values in (rig.samples.answered_ns, rig.samples.arrived_ns):
        values[half:] = values[half]
    sent = {stamp: at_ns for stamp, at_ns in rig.sent.items() if stamp <= int(rig.samples.sampled_ns[half])}
    found = responses_ms(matched(rig.samples, sent, PERIOD_NS), PERIOD_NS)
    late = later_than(found, 2.0)
    assert late.runs[-1] > 1400
    assert found.max() > 1400.0


def test_a_window_takes_the_deadlines_within_it() -> None:
    rig = Rig(1, 0.5, 0.1)
    whole = matched(rig.samples, rig.sent, PERIOD_NS)
    begin_ns, end_ns = whole[1000].due_ns, whole[1500].due_ns
    assert matched(rig.samples, rig.sent, PERIOD_NS, begin_ns, end_ns) == whole[1000:1501]


def test_a_ratio_to_a_loop_that_was_never_late_is_a_bound() -> None:
    none, some = runs_in_million(Late((), 30_000)), runs_in_million(Late((2,) * 90, 30_000))
    assert ratio(some, some) == (1.0, False)
    least, is_bound = ratio(some, none)
    assert is_bound
    assert 10.0 < least < 90.0


def test_a_row_of_the_table_has_a_cell_for_each_column() -> None:
    interval = {"rate": 12.0, "low": 3.0, "high": 30.0}
    row = {
        "beside": "burner", "loop": "rig", "cycles": 30_000, "late_in_million": 40.0, "runs_in_million": interval,
        "runs": 1, "ratio": 3.0, "ratio_is_bound": True, "after_next_tick_in_million": 50.0, "median_ms": 0.8,
        "longest_ms": 5.0, "burner_percent": 70.0,
    }  # fmt: skip
    found = cells(row)
    assert len(found) == HEAD.count("|") - 1
    assert found[:6] == (BESIDE["burner"], LOOPS["rig"][0], "30000", "40", "12 (3 to 30)", "> 3.0")
    lines = tables.late_lines({"rows": [row]})
    assert len({line.count("|") for line in lines}) == 1
    assert cells({**row, "runs": 0})[5] == cells({**row, "loop": "waiting"})[5] == ""
