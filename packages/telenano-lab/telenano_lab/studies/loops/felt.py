"""Felt stiffness: the stiffness that a hand feels under a law, by sample, frequency, instrument and line.

A cell is measured in several sessions that differ in quantities that the table does not list: the force with which the
hand presses, the amplitude of its swing, and the noise of the instrument. In each session the hand presses on a spring
K and swings. With the complex amplitudes X and F of the swing beside a trend, the hand feels Re(F_m / X_m), while the
true stiffness is K alpha_f alpha_p. The result of a cell is the mean of their ratio over its sessions, and the interval
in which a further session lies 95 times in 100.

A cell has no figure if one of its sessions is not stable, was ended by the guard, or moved otherwise than the hand
swung. It then has the reason, which is counted.
"""

import functools
import hashlib
import math
import random
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from pydantic import Field

from telenano.analysis import student
from telenano.wire import RigError
from telenano_lab.studies.loops.cells import Cell, run_cell, scales_of
from telenano_lab.studies.loops.sweep import Kind
from telenano_lab.studies.loops.transparency import followed, swing, tone

# The ranges from which the force and the amplitude of a session are drawn [N].
_PRESSES_N = (0.8, 1.3)
_SWINGS_N = (0.2, 0.45)
# A session with more motion than this besides swing and trend gets no figure, as a share of the swing (both RMS).
_OTHER_MOTION = 0.7
# The number of digits of a ratio: further digits differ from processor to processor.
_DIGITS = 6


class FeltCell(Cell):
    """A law over a line, on a spring and an instrument, felt by a hand that swings."""

    instrument_name: str = Field("ideal", description="Name of the instrument")
    frequency_hz: float = Field(0.5, ge=0.05, le=50.0, description="Frequency of the swing [Hz]")
    draws: int = Field(4, ge=2, le=1000, description="Sessions of the cell")
    first_draw: int = Field(0, ge=0, description="Number of the first session")

    @property
    def key(self) -> str:
        """A digest of the cell and of all sources on which its outcome depends."""
        return hashlib.sha256(f"felt {super().key}".encode()).hexdigest()[:24]


@dataclass(frozen=True)
class Felt:
    """The stiffness that the hand feels in a cell, relative to the true one.

    ratio: the mean over the sessions; low, high: the interval of 95 % for a further session. All are None if there is
    no figure; `refused` then has the reason, and `refusals` the number of sessions without a figure.
    """

    cell: FeltCell
    ratio: float | None
    low: float | None
    high: float | None
    refused: str = ""
    refusals: int = 0

    def as_dict(self) -> dict[str, Any]:
        """Return the result as plain data; `felt_from` is the inverse."""
        return {**asdict(self), "cell": self.cell.model_dump(mode="json")}

    def row(self) -> dict[str, Any]:
        """Return the result as a row of a table."""
        cell = self.cell
        return {
            "law": cell.law,
            "instrument": cell.instrument_name,
            "round_trip_ms": cell.round_trip_ms,
            "stiffness_n_per_m": cell.stiffness_n_per_m,
            "frequency_hz": cell.frequency_hz,
            "felt": self.ratio,
            "low": self.low,
            "high": self.high,
            "sessions": cell.draws,
            "refusals": self.refusals,
            "refused": self.refused,
        }


def felt_from(data: dict[str, Any]) -> Felt:
    """Return a result from plain data."""
    cell = data["cell"]
    pairs = {name: tuple((key, value) for key, value in cell[name]) for name in ("settings", "disturbances")}
    return Felt(**{**data, "cell": FeltCell(**{**cell, **pairs})})


def felt(cell: FeltCell) -> Felt:
    """Measure a cell; ConfigError for one that cannot be run."""
    found: list[float] = []
    refused: list[str] = []
    for number in range(cell.first_draw, cell.first_draw + cell.draws):
        ratio = felt_once(cell, number)
        if isinstance(ratio, str):
            refused.append(ratio)
        else:
            found.append(ratio)
    if refused:
        return Felt(cell, None, None, None, max(sorted(set(refused)), key=refused.count), len(refused))
    mean, half = _further(found)
    return Felt(cell, _rounded(mean), _rounded(mean - half), _rounded(mean + half))


def felt_once(cell: FeltCell, number: int) -> float | str:
    """Return the ratio of felt and true stiffness in one session, or a word for the reason why there is none."""
    draw = random.Random(f"felt {number}")
    mean_n, amplitude_n = draw.uniform(*_PRESSES_N), draw.uniform(*_SWINGS_N)
    own = cell.model_copy(update={"seed": cell.seed + number})
    if (outcome := _outcome(Cell(**{name: getattr(own, name) for name in Cell.model_fields}))) != "stable":
        return outcome
    try:
        course, begin_s = swing(own, mean_n, cell.frequency_hz, amplitude_n)
    except RigError:
        return "guarded"
    if not followed(course):
        return "guarded"
    part = slice(int(np.searchsorted(course.time_s, begin_s - 1e-9)), None)
    time_s = course.time_s[part]
    force, _ = tone(time_s, course.hand_force_n[part], cell.frequency_hz)
    moved, left = tone(time_s, course.hand_position_m[part], cell.frequency_hz)
    if not abs(moved) > 0.0 or left.std() > _OTHER_MOTION * math.sqrt(0.5) * abs(moved):
        return "other motion"
    scales = scales_of(cell.controller())
    return (force / moved).real / (scales.force_scale * scales.position_scale * cell.stiffness_n_per_m)


@functools.lru_cache(maxsize=256)
def _outcome(cell: Cell) -> str:
    """Return the outcome of the hold of a cell, which all its swings share."""
    return run_cell(cell).outcome


def refusals(results: Sequence[Felt]) -> dict[str, int]:
    """Return the number of cells without a figure by reason."""
    reasons = [result.refused for result in results if result.refused]
    return {reason: reasons.count(reason) for reason in sorted(set(reasons))}


def _further(values: Sequence[float]) -> tuple[float, float]:
    """Return the mean of values, and half the interval around it in which a further value lies 95 times in 100."""
    n, mean = len(values), math.fsum(values) / len(values)
    deviation = math.sqrt(math.fsum((value - mean) ** 2 for value in values) / (n - 1))
    return mean, student(n - 1) * deviation * math.sqrt(1.0 + 1.0 / n)


def _rounded(value: float) -> float:
    return float(f"{value:.{_DIGITS}g}")


def _check(cell: FeltCell) -> None:
    cell.controller()
    cell.disturbed_instrument(1.0)


FELT = Kind(_check, felt, felt_from, FeltCell.stiffness_doubts, batch=24)
