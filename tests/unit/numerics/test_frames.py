"""The sign between the paper's axis and a site's frame."""

import math

import pytest

from telenano.numerics.frames import to_paper_axis, to_site_frame


@pytest.mark.parametrize("value", [0.0, 7e-3, -1.1e-8])
def test_there_and_back(value: float) -> None:
    assert to_paper_axis(to_site_frame(value)) == value
    assert to_site_frame(value)[2] == -value


def test_zero_stays_plus_zero() -> None:
    assert math.copysign(1.0, to_site_frame(0.0)[2]) == 1.0
    assert math.copysign(1.0, to_paper_axis((0.0, 0.0, 0.0))) == 1.0
