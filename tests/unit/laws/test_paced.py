"""The time of the slave half: its calls are irregular, the periods that it steps are those of the hand."""

import random

import pytest

from telenano.extend.laws import MOST_PERIODS_A_STEP, paced


def test_a_signal_a_period_is_a_step_of_one_period() -> None:
    assert paced(0, 1, 0) == (0, 1)


def test_between_signals_it_steps_what_it_is_behind_and_not_ahead_of_time() -> None:
    # a period and a half after the signal, and again after three periods
    assert paced(0, 0, 1) == (-1, 1)
    assert paced(-1, 0, 1) == (-1, 0)
    assert paced(-1, 0, 3) == (-3, 2)
    # the signal that then comes has four periods behind it, of which three are made
    assert paced(-3, 4, 0) == (0, 1)


def test_what_it_is_behind_is_made_up_for_a_few_periods_at_a_time() -> None:
    behind, steps = 0, []
    for elapsed in (10, 1, 1, 1, 1, 1, 1):
        behind, periods = paced(behind, elapsed, 0)
        steps.append(periods)
    assert steps == [MOST_PERIODS_A_STEP] * 4 + [2, 1, 1]
    assert behind == 0


@pytest.mark.parametrize("seed", range(5))
def test_its_time_is_that_of_the_hand_over_any_link(seed: int) -> None:
    source = random.Random(seed)
    behind, stepped, sent, now, next_own = 0, 0, 0, 0.0, 1.5
    arrived, last = 0.0, 0.0
    while sent < 5000:
        # a signal arrives after a random time and brings the periods since the last one that was not overtaken
        arrived += source.expovariate(1.0)
        while next_own < arrived:
            now, next_own = next_own, next_own + 1.5
            behind, periods = paced(behind, 0, int(now - last))
            stepped += periods
        elapsed = max(1, round(arrived) - sent)
        behind, periods = paced(behind, elapsed, 0)
        sent, stepped, last, next_own = sent + elapsed, stepped + periods, arrived, arrived + 1.5
    assert stepped == pytest.approx(sent, rel=0.02, abs=0.0)
