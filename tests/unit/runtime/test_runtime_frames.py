"""The sign between the paper's axis and a site's frame."""

import math

import pytest

from services.runtime.frames import across, along


@pytest.mark.parametrize("value", [0.0, 7e-3, -1.1e-8])
def test_there_and_back(value: float) -> None:
    assert along(across(value)) == value
    assert across(value)[2] == -value


def test_zero_stays_plus_zero() -> None:
    assert math.copysign(1.0, across(0.0)[2]) == 1.0
    assert math.copysign(1.0, along((0.0, 0.0, 0.0))) == 1.0
