"""Common form of recorded curves, which every reader of force curves returns."""

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Way = tuple[Array, Array]


class RecordedCurve(NamedTuple):
    """One curve.

    place: column and row in the grid. ways: for approach and retraction the height [m], rising away from the sample,
    and the value, in the order of time. unit: unit of the values, N of a force, m or V of a deflection.
    stiffness_n_per_m, sensitivity_m_per_v: from the file, or None. speed_m_per_s: speed of the approach. remarks:
    sentences on what was assumed and left out.
    """

    place: tuple[int, int]
    ways: tuple[Way, ...]
    unit: str
    stiffness_n_per_m: float | None = None
    sensitivity_m_per_v: float | None = None
    speed_m_per_s: float = 1.0
    remarks: tuple[str, ...] = ()


class Curves(NamedTuple):
    """The curves of a file: columns and rows of its grid, its sides [m], and a reader of each with the share done."""

    shape: tuple[int, int]
    sides_m: tuple[float, float]
    each: Iterator[tuple[Callable[[], RecordedCurve], float]]


def constants_of(curve: RecordedCurve, constants: dict[str, float]) -> tuple[float | None, float | None]:
    """Return spring constant [N/m] and sensitivity [m/V] of a curve; given constants replace those of the file."""
    return (
        constants.get("stiffness_n_per_m", curve.stiffness_n_per_m),
        constants.get("sensitivity_m_per_v", curve.sensitivity_m_per_v),
    )


def factor_to_force(curve: RecordedCurve, constants: dict[str, float], *, as_deflection: bool = False) -> float:
    """Return the factor that converts the values of a curve to a force [N], or to a deflection [m].

    Raises:
        ValueError: The unit is that of no force and no deflection, or a constant is missing; the message names it.
    """
    names = ("stiffness_n_per_m", "sensitivity_m_per_v")
    powers = {"N": (0, 0), "m": (1, 0), "V": (1, 1)}
    if curve.unit not in powers:
        raise ValueError(f"its deflection is in {curve.unit!r}; it must be in N, m or V")
    factor, missing = 1.0, []
    for name, value, power in zip(names, constants_of(curve, constants), powers[curve.unit], strict=True):
        is_stiffness = name == names[0]
        if value is None and (power or (as_deflection and is_stiffness)):
            missing.append(name)
        elif value is not None:
            factor *= value ** (power - (as_deflection and is_stiffness))
    if missing:
        raise ValueError(lacks(missing))
    return factor


def lacks(names: list[str]) -> str:
    """Return the error message for constants that are neither in the file nor given by the user."""
    settings = " ".join(f"--set {name}=…" for name in names)
    return f"{', '.join(names)}: the file has no such value; give {settings}"
