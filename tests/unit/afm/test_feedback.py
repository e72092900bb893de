"""The feedback of images: where it is stable, by closed form and by its own steps, and what a limit leaves of it."""

import math
import re
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from telenano.extend.feedback import carried_out, feedback_step, gain_fault, most_integral_share, remaining

NAMES = ("--gain", "--proportional")
# no lag at all, that of Table 2 in a millisecond, a high Q, and that of a period of the drive
LAGS = (None, 0.0, remaining(1e-3, 150e3, 100.0), remaining(1e-3, 150e3, 1000.0), remaining(1.0 / 150e3, 150e3, 100.0))


def swings(share: float, proportional: float, lag: float | None, *, stiff: float = 1.0, steps: int = 4000) -> float:
    """Give by how much a rigid sample's error of 1 nm has grown at the end, by the steps themselves."""
    base = amplitude = part = 0.0
    error = -1e-9
    errors = []
    for _ in range(steps):
        base, part = feedback_step(base, part, error, share, proportional)
        # the amplitude is read before it has followed the last move
        seen, amplitude = (base, 0.0) if lag is None else (amplitude, lag * amplitude + (1.0 - lag) * base)
        error = -1e-9 - stiff * seen
        errors.append(abs(error))
        if error > 1e3 or not math.isfinite(error):
            break
    return max(errors[-40:]) / 1e-9


@pytest.mark.parametrize("lag", LAGS)
@pytest.mark.parametrize("part", [0.0, 0.3, 0.9])
def test_just_inside_the_bound_the_loop_is_stable_and_just_outside_it_is_not(lag: float | None, part: float) -> None:
    proportional = part * (1.0 if lag is None else min(1.0 / (1.0 - lag), 20.0))
    most = most_integral_share(proportional, lag)
    assert swings(0.98 * most, proportional, lag) < 0.3
    assert swings(1.02 * most, proportional, lag) > 3.0
    # refused are gains that would be unstable with a margin, and of a slow tip what Routh's criterion says
    margin = 1.0 if lag is None else 1.5
    allowed = most * 1e3 / margin
    if lag:
        allowed = min(allowed, 2.0 * (1.0 + proportional / margin) * -math.log(lag) * 1e3)
    for share, faulty in ((0.98, False), (1.02, True)):
        fault = gain_fault(share * allowed, proportional / margin, 1e-3, lag, NAMES)
        assert bool(fault) is faulty
        assert not faulty or ("--gain = " in fault and f"below {allowed:.6g} 1/s" in fault)
    greatest = (1.0 if lag is None else 1.0 / (1.0 - lag)) / margin
    assert f"--proportional = {greatest:g} makes" in gain_fault(1.0, greatest, 1e-3, lag, NAMES)


@given(
    st.floats(0.0, 0.99),
    st.floats(0.0, 1.0),
    st.floats(0.0, 0.999),
    st.floats(1e-3, 0.999),
    st.floats(0.05, 1.0),
)
def test_a_softer_sample_or_an_earlier_reading_is_further_from_the_bound(
    lag: float, read: float, part: float, share: float, stiff: float
) -> None:
    p = part * min(1.0 / (1.0 - lag), 20.0)
    a = share * most_integral_share(p, lag)
    a, p = stiff * a, stiff * p
    # of the last move the reading has a share of up to what there is after a whole period
    phi = read * (1.0 - lag)
    g = 1.0 - phi - lag
    roots = np.roots([1.0, (a + p) * phi - 1.0 - lag, lag + (a + p) * g - p * phi, -p * g])
    assert np.abs(roots).max() < 1.0 + 1e-9


@pytest.mark.parametrize(
    ("gain", "proportional", "words"),
    [
        (400.0, 1.0, "--proportional = 1 makes the feedback unstable in contact mode at 1000 Hz: it must be below 1"),
        (2000.0, 0.0, "--gain = 2000 1/s makes .* with --proportional = 0: it must be below 2000 1/s"),
    ],
)
def test_an_impossible_gain_is_named_with_what_would_be_right(gain: float, proportional: float, words: str) -> None:
    assert re.search(words, gain_fault(gain, proportional, 1e-3, None, NAMES))


def test_a_fault_of_a_feedback_without_a_proportional_gain_names_the_integral_gain_alone() -> None:
    # in contact Ki T has to be below 2, less the margin, which is thousands a second at 1 kHz
    alone = gain_fault(1e6, 0.0, 1e-3, None, ("--gain", ""))
    beside = gain_fault(1e6, 0.0, 1e-3, None, NAMES)
    assert alone.startswith("--gain = 1e+06 1/s makes the feedback unstable in contact mode at 1000 Hz: it must be")
    assert beside.startswith(alone.partition(":")[0] + " with --proportional = 0: it must be")


def limited(proportional: float, surface: Callable[[int], float], steps: int) -> list[tuple[float, float]]:
    """Give base and error of a rigid sample followed at 2 nm a step within -50 and 50 nm."""
    base = part = error = 0.0
    found = []
    for n in range(steps):
        wanted, part = feedback_step(base, part, error, 0.4, proportional)
        held = min(max(wanted, base - 2e-9, -50e-9), base + 2e-9, 50e-9)
        base, part = held, carried_out(part, wanted - held)
        error = surface(n) - base
        found.append((base, error))
    return found


@pytest.mark.parametrize("proportional", [0.0, 0.5, 0.7])
def test_neither_the_range_nor_the_speed_winds_the_integral_up(proportional: float) -> None:
    # a second out of reach, then back within it
    ways = limited(proportional, lambda n: 200e-9 if n < 1000 else 20e-9, 1100)
    assert ways[999][0] == 50e-9
    # at once, and without passing the sample by more than 40 % of the last step
    assert ways[1001][0] == pytest.approx(48e-9, rel=1e-6, abs=0.0)
    assert min(base for base, _ in ways[1000:]) > 20e-9 - 0.8e-9
    assert abs(ways[-1][1]) < 1e-12
    # 40 nm at 2 nm a step take 20 steps, and an overshoot of no more
    rise = limited(proportional, lambda n: 40e-9, 100)
    assert rise[20][0] == pytest.approx(40e-9, rel=0.05, abs=0.0)
    assert max(base for base, _ in rise) < 40e-9 + 0.8e-9


@given(st.floats(-1e-8, 1e-8), st.floats(-1e-8, 1e-8))
def test_a_limit_takes_the_proportional_part_first_and_no_more_than_that(part: float, missing: float) -> None:
    left = carried_out(part, missing)
    assert min(part, 0.0) <= left <= max(part, 0.0)
    if (part > 0.0) is not (missing > 0.0):
        assert left == part
    elif abs(missing) <= abs(part):
        # the integral is what it was
        assert left == part - missing


@given(st.floats(-1e-6, 1e-6), st.floats(-1e-6, 1e-6), st.floats(0.0, 2.0))
def test_without_a_proportional_gain_it_is_the_integral_to_the_bit(base: float, error: float, share: float) -> None:
    assert feedback_step(base, 0.0, error, share, 0.0) == (base + error * share, 0.0)
