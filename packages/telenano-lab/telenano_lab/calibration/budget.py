"""Budgets of a recorded session: the uncertainty of each figure by source, and the delay of the loop by stage.

Standard uncertainties of independent sources are added in squares (JCGM 100:2008, Eq. 10), and 95 % is 1.96 of them.
The force of the tip is F_s = k (v - v_0) / s, with the stiffness k and the voltage per metre s, so a relative error of
either is the same relative error of F_s. A stiffness from thermal noise was measured with that same s, and is
proportional to its square: there the errors partly cancel, and a sum of squares is too large rather than too small.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from statistics import NormalDist
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from telenano.analysis import Session, mean_half_width
from telenano.devices import HandleCalibration, InstrumentCalibration
from telenano.recording import RecordingSource
from telenano.timing import STAGES
from telenano.wire import TelenanoError

# 95 % lie within this number of standard uncertainties.
_DEVIATIONS = NormalDist().inv_cdf(0.975)
# The calibrated scales that each figure of a summary is proportional to, by the name of the source.
_SCATTER = "scatter in the session"
_TIP_FORCE = ("stiffness of the cantilever", "deflection for a volt")
_SCALES = {
    "hold_ratio": ("force of the hand for a count", *_TIP_FORCE),
    "contact_x_cm": ("position of the hand for a count",),
    "release_force_nn": _TIP_FORCE,
}


class Source(NamedTuple):
    """A source of uncertainty of a figure. `standard`: standard uncertainty, in its unit; `share`: of the variance."""

    figure: str
    source: str
    standard: float
    share: float


class Budget(NamedTuple):
    """A figure with its combined uncertainty. `half_width`: of the 95 % interval, in its unit.

    `without`: sources whose error is not known, which are left out.
    """

    figure: str
    value: float
    half_width: float
    sources: tuple[Source, ...]
    without: tuple[str, ...]


class Stage(NamedTuple):
    """A stage of the loop. The means add up to that of the loop; `half_width_ms`: of the mean, 95 %.

    `share`: of the loop's mean; `clock_ms`: bound of the error by the two clocks, 0 for a stage within one site.
    """

    stage: str
    mean_ms: float
    half_width_ms: float | None
    p50_ms: float
    p99_ms: float
    share: float
    clock_ms: float


def scale_errors(handle: HandleCalibration | None, stage: InstrumentCalibration | None) -> dict[str, float]:
    """Return the relative standard error of each calibrated scale; scales without a stated error are absent.

    Args:
        handle: The calibration of the handle, if there is one.
        stage: The calibration of stage, read-out and cantilever, if there is one.
    """
    errors: dict[str, tuple[float, float]] = {}
    if handle is not None:
        errors["force of the hand for a count"] = (handle.force.standard_error_n_per_count, handle.force.n_per_count)
        position = handle.position
        errors["position of the hand for a count"] = (position.standard_error_m_per_count, position.m_per_count)
    if stage is not None:
        lever, deflection = stage.cantilever, stage.deflection
        errors["stiffness of the cantilever"] = (lever.standard_error_n_per_m, lever.stiffness_n_per_m)
        errors["deflection for a volt"] = (deflection.standard_error_v_per_m, deflection.v_per_m)
    return {name: abs(error / scale) for name, (error, scale) in errors.items() if error > 0.0}


def figure_budgets(summary: Mapping[str, Any], shares: Mapping[str, float]) -> list[Budget]:
    """Return the budget of each figure of a summary that has an interval or a scale of known error.

    Args:
        summary: The summary of the session.
        shares: The relative standard error of each scale, as `scale_errors` returns it.
    """
    budgets = []
    for figure, scales in _SCALES.items():
        value, interval = summary.get(figure), summary.get("intervals", {}).get(figure)
        if value is None or not (interval or any(scale in shares for scale in scales)):
            continue
        # Without an interval the scatter is listed as missing.
        parts = {_SCATTER: 0.5 * (interval[1] - interval[0]) / _DEVIATIONS} if interval else {}
        parts |= {scale: shares[scale] * abs(value) for scale in scales if scale in shares}
        variance = sum(part**2 for part in parts.values())
        sources = tuple(
            Source(figure, name, part, part**2 / variance if variance else 0.0) for name, part in parts.items()
        )
        without = tuple(scale for scale in scales if scale not in shares) + (() if interval else (_SCATTER,))
        budgets.append(Budget(figure, value, _DEVIATIONS * math.sqrt(variance), sources, without))
    return budgets


def delay_budget(recording: RecordingSource, session: Session) -> list[Stage]:
    """Return the stages of the loop in their order, over the hand's samples that were answered.

    Args:
        recording: The master's recording of a session.
        session: The session.

    Raises:
        TelenanoError: Fewer than 50 samples can be followed all the way, or a topic of the loop has two publishers.
    """
    for topic in STAGES:
        sources = [channel.src for channel in recording.channels if channel.channel_topic == topic]
        if len(sources) > 1:
            raise TelenanoError(
                f"{recording.path}: {topic} has {len(sources)} publishers, {sources[0]} and {sources[1]} among them, "
                "and the loop has one"
            )
    parts = session.split_age(recording)
    if not parts:
        raise TelenanoError(
            f"{recording.path}: fewer than 50 samples of the hand can be followed from the device to the instrument "
            "and back: give the master's recording of a session whose loop was closed"
        )
    # A simulated device adds no delay, and on one machine there is no network.
    found_s = {name: values for name, values in parts.items() if values.any()}
    loop_ms = 1e3 * np.sum(list(found_s.values()), axis=0)
    rows = [_stage(name, 1e3 * values, loop_ms, 1e3 * session.clock_error_s(name)) for name, values in found_s.items()]
    return [*rows, _stage("loop", loop_ms, loop_ms, 0.0)]


def _stage(name: str, values_ms: npt.NDArray[np.float64], loop_ms: npt.NDArray[np.float64], clock_ms: float) -> Stage:
    p50, p99 = np.percentile(values_ms, [50.0, 99.0])
    mean = float(values_ms.mean())
    half = mean_half_width(values_ms)
    return Stage(name, mean, half, float(p50), float(p99), mean / float(loop_ms.mean()), clock_ms)


def force_rows(budgets: Sequence[Budget]) -> Iterator[dict[str, str]]:
    """Yield the rows of a table: the sources of each figure, and their sum."""
    for budget in budgets:
        size = abs(budget.value)
        for part in budget.sources:
            row = {"figure": budget.figure, "source": part.source, "standard": f"{part.standard:.2g}"}
            yield {
                **row,
                "of the value": _percent(part.standard, size),
                "of the variance": f"{100.0 * part.share:.0f} %",
            }
        whole = {"figure": budget.figure, "source": "all, 95 %", "standard": f"± {budget.half_width:.2g}"}
        yield {**whole, "of the value": _percent(budget.half_width, size), "of the variance": "100 %"}


def delay_rows(stages: Sequence[Stage]) -> Iterator[dict[str, str]]:
    """Yield the rows of a table; the last one is the whole loop."""
    for one in stages:
        error = "–" if one.half_width_ms is None else f"± {one.half_width_ms:.2g}"
        yield {
            "stage": one.stage,
            "mean [ms]": f"{one.mean_ms:.3f}",
            "95 % [ms]": error,
            "p50 [ms]": f"{one.p50_ms:.3f}",
            "p99 [ms]": f"{one.p99_ms:.3f}",
            "of the loop": f"{100.0 * one.share:.0f} %",
            "clocks [ms]": f"± {one.clock_ms:.2g}" if one.clock_ms else "",
        }


def _percent(part: float, whole: float) -> str:
    return f"{float(f'{100.0 * part / whole:.2g}'):g} %" if whole else "–"
