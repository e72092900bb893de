"""Whether a value with an error is an estimate: each reason for which it is none, and the ordinary case."""

import math
from typing import Any

import pytest

from telenano.analysis import denied


@pytest.mark.parametrize(
    ("value", "error", "facts", "reason"),
    [
        (12.5, 9.4, {}, "with an error of 75 %, which is no estimate"),
        (2.0, math.inf, {}, "no bound of its error"),
        (2.0, math.nan, {}, "no bound of its error"),
        (-1.0, 0.1, {}, "nothing tells the stiffness"),
        (math.nan, 0.1, {}, "nothing tells the stiffness"),
        (10.0, 0.1, {"ends": (0.1, 10.0)}, "ends at the end of its range, 10 N/m"),
        (0.05, 0.001, {"ends": (0.1, 10.0)}, "ends at the end of its range, 0.1 N/m"),
        (2.0, 0.1, {"others": (2.1, 5.0)}, "may be 2 N/m or 5 N/m"),
        (2.0, 0.1, {"above_scatter": 1.5}, "1.5 times as high as its lines scatter"),
        (2.0, 0.1, {"points": (4, 10)}, "4 points tell the stiffness, and 10 are needed"),
    ],
)
def test_what_its_error_or_its_fit_denies_is_no_estimate(
    value: float, error: float, facts: dict[str, Any], reason: str
) -> None:
    assert reason in denied("the stiffness", value, error, "N/m", **facts)


def test_what_is_known_is_an_estimate() -> None:
    known: dict[str, Any] = {"ends": (0.1, 10.0), "others": (2.1,), "above_scatter": 8.0, "points": (10, 10)}
    assert denied("the stiffness", 2.0, 0.59, "N/m", **known) == ""
