"""Figures as texts, with their errors."""

import pytest
from scipy.stats import t

from telenano.analysis.intervals import student, with_error


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


@pytest.mark.parametrize("confidence", [0.5, 0.95, 0.999])
def test_students_t_is_that_of_scipy(confidence: float) -> None:
    for freedom in (*range(1, 40), 127, 128, 5000):
        assert student(freedom, confidence) == pytest.approx(t.ppf(0.5 + 0.5 * confidence, freedom), rel=1e-9)


@pytest.mark.parametrize(("freedom", "confidence"), [(0, 0.95), (3, 1.0), (3, -0.1)])
def test_a_distribution_that_does_not_exist_has_no_students_t(freedom: int, confidence: float) -> None:
    with pytest.raises(ValueError, match="does not exist"):
        student(freedom, confidence)
