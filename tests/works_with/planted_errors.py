"""Errors that are planted into what telenano writes, and the comparison that has to see each of them.

A row of works-with.md counts only if its comparison tells an exchanged axis, a wrong unit and a wrong sign from
what is right: each test runs with nothing planted, where nothing may differ, and with each error, where something must.
"""

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt
import pytest

Numbers = Mapping[str, npt.ArrayLike]

# The test runs once for each: nothing planted first.
each_error = pytest.mark.parametrize("error", ["", "axis", "unit", "sign"])


def planted(error: str, values: npt.ArrayLike, axis: int = -1, unit: float = 1e3) -> npt.NDArray[np.float64]:
    """Return values with an error: the order along an axis reversed, another unit, the sign, or none.

    Args:
        error: One of those of `each_error`.
        values: The values, of any shape.
        axis: The axis whose order the error `axis` reverses.
        unit: The factor of the error `unit`.
    """
    right = np.asarray(values, dtype=np.float64)
    wrong = {"": right, "axis": np.flip(right, axis), "unit": unit * right, "sign": -right}
    return wrong[error]


def differences(wanted: Numbers, found: Numbers, rtol: float = 1e-12) -> list[str]:
    """Return a line for each quantity that is absent or differs from what is wanted by more than `rtol` of its largest.

    A number that both have as NaN is equal.
    """
    lines = []
    for name, values in wanted.items():
        right = np.asarray(values, dtype=np.float64)
        if name not in found:
            lines.append(f"{name} is absent")
            continue
        other = np.asarray(found[name], dtype=np.float64)
        if other.shape != right.shape:
            lines.append(f"{name} has shape {other.shape}. Right: {right.shape}")
            continue
        tolerance = rtol * float(np.nanmax(np.abs(right), initial=0.0))
        if not np.allclose(other, right, rtol=0.0, atol=tolerance, equal_nan=True):
            lines.append(f"{name} is {other.tolist()}. Right: {right.tolist()}")
    return lines


def judge(error: str, wanted: Numbers, found: Numbers, rtol: float = 1e-12) -> None:
    """Assert that nothing differs where no error is planted, and that something does where one is."""
    lines = differences(wanted, found, rtol)
    assert not lines if not error else lines, f"planted {error or 'nothing'}, differs: {lines}"
