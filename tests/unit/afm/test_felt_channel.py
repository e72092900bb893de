"""A measured channel is felt by a table that holds on one branch of it: what is refused, limited, and left."""

import math
from typing import Any

import numpy as np
import pytest

from telenano.afm.felt import BOUNDS, LEFT, RATE, SATURATED, FeltInputs, FeltState, LimitedForce, felt_step
from telenano.extend.stage import Place
from telenano.sections.feel_section import FeelConfig

HERE = Place(0.0, 0.0)
# `frequency_shift_hz` falls to its minimum of -8 Hz at 0.4 nm
FEEL = {
    "channel": "frequency_shift", "unit": "Hz", "table": [[-0.5, 0.0], [-4.0, 1e-9], [-7.5, 3e-9]], "tolerance": 0.05,
    "slope_limit_n_per_unit": 1e-9, "rate_limit_n_per_s": 1e-3,
}  # fmt: skip


def frequency_shift_hz(z_m: Any) -> Any:
    u = np.asarray(z_m) / 0.4e-9
    return -8.0 * u * np.exp(1.0 - u)


def feel(**changes: Any) -> FeelConfig:
    return FeelConfig.model_validate({**FEEL, **changes})


def felt(values: Any, bases: Any, places: Any = None, **changes: Any) -> list[LimitedForce]:
    """Return what is felt of values at bases, a millisecond apart."""
    params, state, found = feel(**changes).to_params(), FeltState(), []
    for i, (value, base_m) in enumerate(zip(values, bases, strict=True)):
        place = HERE if places is None else places[i]
        state, out = felt_step(params, state, FeltInputs(value, base_m, place, False), 1e-3)
        found.append(out)
    return found


def test_a_value_is_felt_as_the_force_of_the_table() -> None:
    values = [-0.5, -2.25, -4.0, -5.75, -7.5]
    found = felt(values, np.arange(5) * 1e-10)
    assert [each.force_n for each in found] == pytest.approx([0.0, 0.5e-9, 1e-9, 2e-9, 3e-9], rel=1e-12, abs=1e-24)
    assert {each.clamp for each in found} == {""}


def test_units_of_the_table_are_those_that_it_declares() -> None:
    current = {"channel": "current", "unit": "pA", "table": [[1.0, 0.0], [100.0, 1e-9]], "tolerance": 1.0}
    found = felt([1e-12, 50.5e-12, 100e-12], [0.0, 1e-10, 2e-10], **current)
    assert [each.force_n for each in found] == pytest.approx([0.0, 0.5e-9, 1e-9], rel=1e-9, abs=1e-20)


def test_far_from_the_sample_it_is_saturated_and_bounds_and_rate_limit_by_name() -> None:
    assert felt([0.3], [0.0])[0] == LimitedForce(0.0, SATURATED)
    assert felt([-7.0, -7.0], [0.0, 1e-10], most_n=2e-9)[1] == LimitedForce(2e-9, BOUNDS)
    slow = felt([-4.0, -4.0], [0.0, 1e-10], rate_limit_n_per_s=1e-7)
    assert slow == [LimitedForce(pytest.approx(1e-10), RATE), LimitedForce(pytest.approx(2e-10), RATE)]  # type: ignore[arg-type]


@pytest.mark.parametrize("value", [-7.51, -8.0, math.nan, math.inf])
def test_a_value_beyond_the_last_row_or_no_number_leaves_the_branch(value: float) -> None:
    last = felt([-4.0, value if value != math.inf else -math.inf], [0.0, 1e-10])[-1]
    assert last.clamp == LEFT
    assert last.force_n == 0.0


def test_a_value_that_goes_back_while_the_base_goes_on_leaves_the_branch_even_without_the_last_row() -> None:
    z = np.linspace(2e-9, 0.05e-9, 300)
    found = felt(frequency_shift_hz(z), -z, table=[[-0.1, 0.0], [-8.5, 3e-9]])
    first = next(i for i, each in enumerate(found) if each.clamp == LEFT)
    # behind the minimum, by what the tolerance of 0.05 Hz allows
    assert 0.3e-9 < z[first] < 0.4e-9
    assert frequency_shift_hz(z[first]) - frequency_shift_hz(0.4e-9) < 0.1
    assert {each.clamp for each in found[first:]} == {LEFT}


def test_a_minimum_that_was_jumped_over_is_noticed_on_the_way_back() -> None:
    # 2 nm and 0.02 nm have shifts on either side of the minimum, which no value between them tells
    z = np.array([2e-9, 0.02e-9, 0.03e-9, 0.05e-9])
    values = frequency_shift_hz(z) * 0.98
    found = felt(values, -z, table=[[-0.01, 0.0], [-8.5, 3e-9]])
    assert found[-1].clamp == LEFT


def test_noise_within_the_tolerance_and_another_place_do_not_leave_the_branch() -> None:
    drawn = np.random.default_rng(5)
    z = np.concatenate([np.linspace(2e-9, 0.6e-9, 200), np.linspace(0.6e-9, 2e-9, 200)])
    noisy = frequency_shift_hz(z) + drawn.uniform(-0.02, 0.02, len(z))
    assert LEFT not in {each.clamp for each in felt(noisy, -z)}
    moved = felt([-4.0, -3.0], [0.0, 1e-10], places=[HERE, Place(1e-9, 0.0)])
    assert moved[1].clamp == ""


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"unit": "V"}, "unit: 'V' is not a unit of frequency_shift, which is in Hz"),
        ({"table": [[0.0, 0.0], [-4.0, 1e-9], [-3.0, 2e-9]]}, "the value is not monotone at row 3"),
        ({"table": [[0.0, 0.0], [-4.0, 1e-9], [-5.0, 1e-9]]}, "the force is not monotone at row 3"),
        ({"table": [[0.0, -1e-9], [-4.0, 1e-9]]}, "the force changes its sign"),
        ({"table": [[0.0, 0.0], [-4.0]]}, "row 2 has 1 numbers"),
        ({"slope_limit_n_per_unit": 5e-10}, "between rows 2 and 3 its slope is 5.71e-10 N/Hz, more than"),
        ({"tolerance": 0.0}, "tolerance"),
        ({"channel": "deflection"}, "channel"),
    ],
)
def test_a_table_that_does_not_hold_is_refused_by_name(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        feel(**changes)
