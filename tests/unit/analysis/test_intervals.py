"""Figures as texts, with their errors."""

import pytest

from analysis.intervals import with_error


@pytest.mark.parametrize(
    ("value", "interval", "text"),
    [
        (1.0500000014573272, None, "1.050"),
        (1.0500000014573272, [1.05, 1.050000002], "1.050"),
        (1.0495902808336222, [1.0483682, 1.0508123], "1.0496 ± 0.0012"),
        (1.1, [0.8, 1.4], "1.10 ± 0.30"),
        (31.4, [11.4, 51.4], "31 ± 20"),
    ],
)
def test_a_figure_is_told_to_the_digits_that_its_error_leaves(
    value: float, interval: list[float] | None, text: str
) -> None:
    assert with_error(value, interval) == text
