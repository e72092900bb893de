"""One run of the benchmark and its measures, in lockstep.

Sums are rounded once (`math.fsum`), and sines are those of Python, because NumPy's bits depend on the processor.
"""

import functools
import math
from collections.abc import Sequence
from dataclasses import fields
from typing import Any, NamedTuple

import numpy as np

from telenano.lockstep import Rig, Schedule, Trajectory
from telenano.sections import HapticConfig
from telenano.settings import validate
from telenano.wire import RigError
from telenano_lab.experiments.benchmark.etvo import Offsets, Series, etvo
from telenano_lab.experiments.benchmark.plan import SWING_HZ, TASKS, Run, Task
from telenano_lab.studies.loops.cells import CellResult, Scales, judged, never_placed, scales_of, settle_ticks
from telenano_lab.studies.loops.sweep import Kind

# Number of digits of every figure; further digits exceed the accuracy of the model.
DIGITS = 9
# Sampling period of the signals that are warped onto each other.
ETVO_STEP_S = 0.005
# Longest lag of one signal behind the other.
ETVO_LONGEST_S = 1.0


class Measure(NamedTuple):
    """A column of the result."""

    unit: str
    about: str


MEASURES: dict[str, Measure] = {
    "force_held_n": Measure("N", "Force at the tip at the hand's scale, mean of the later half of the hold"),
    "force_error": Measure("", "|force held / force to hold - 1|"),
    "peak_force_n": Measure("N", "Greatest force at the tip at the hand's scale, up to the end of the hold"),
    "position_error_mm": Measure("mm", "Hand ahead of the tip, x_m - x_s/alpha_p, mean of the later half of the hold"),
    "parted_mm": Measure("mm", "Change of that from the middle of the hold to the end of the run"),
    "hand_work_mj": Measure("mJ", "Work of the hand at its port, up to the end of the hold"),
    "tip_work_mj": Measure("mJ", "Work of the base at the tip's port, at the hand's scale"),
    "least_energy_mj": Measure("mJ", "Least that hand's work exceeded tip's work by; below 0 energy was made"),
    "stiffness_ratio": Measure("", "Stiffness that the hand feels while it follows the swing, over the true one"),
    "tracking_error": Measure("", "RMS of x_s/alpha_p - x_m without means, over that of x_m, while it follows"),
    "eto_forward_ms": Measure("ms", "Effective time-offset of the tip's motion behind the hand's"),
    "evo_forward_mm": Measure("mm", "Effective value-offset of the tip's motion, at the hand's scale"),
    "eto_backward_ms": Measure("ms", "Effective time-offset of the force rendered behind the force at the tip"),
    "evo_backward_n": Measure("N", "Effective value-offset of the force rendered"),
}


class Outcome(NamedTuple):
    """A run, its verdict or kind of failure, the reason in words, and its measures, None where there is none."""

    cell: Run
    verdict: str
    reason: str
    measures: dict[str, float | None]

    def as_dict(self) -> dict[str, Any]:
        """Return the outcome as plain data; `outcome_from` is the inverse."""
        return {**self._asdict(), "cell": self.cell.model_dump(mode="json")}


def outcome_from(data: dict[str, Any]) -> Outcome:
    """Return an outcome from plain data."""
    cell = data["cell"]
    settings = tuple((key, value) for key, value in cell["settings"])
    return Outcome(Run(**{**cell, "settings": settings}), data["verdict"], data["reason"], dict(data["measures"]))


def run(run: Run) -> Outcome:
    """Run and judge; ConfigError for a run that is not possible."""
    points, held_s, begin_s, end_s = run.force_profile()
    try:
        course = course_of(run, points, end_s)
    except RigError as error:
        return Outcome(run, never_placed(run.cell, error).outcome, str(error), dict.fromkeys(MEASURES))
    scales = scales_of(run.cell.controller())
    held = course_until(course, held_s)
    result = judged(run.cell, held)
    measures = {**dict.fromkeys(MEASURES), **_held(result, held, scales, TASKS[run.task])}
    if _followed(course):
        measures["parted_mm"] = _parted(
            course, scales, run.cell.hold_s(), SWING_HZ if TASKS[run.task].follows else None
        )
    if TASKS[run.task].follows and _followed(course):
        measures |= _swung(course, begin_s, scales, TASKS[run.task])
    return Outcome(run, result.outcome, result.reason, {name: rounded(value) for name, value in measures.items()})


def course_of(run: Run, points: Sequence[tuple[float, float]], end_s: float) -> Trajectory:
    """Run the hand's programme, corners (time [s], force [N]), for end_s [s] over a draw of the network."""
    cell, haptic = run.cell, validate(HapticConfig, run.hand_section(points), f"hand {run.hand}", "haptic_node")
    controller = cell.controller()
    settle = settle_ticks(cell, controller.period_s)
    ticks = settle + max(1, round(end_s / controller.period_s))
    length_s = ticks * controller.period_s
    rig = Rig.of(controller, haptic, cell.disturbed_instrument(length_s), length_s)
    schedule = _schedule(run.network, run.seed, _longest_ticks(run), rig.period_s)
    return rig.run(schedule._replace(ticks=ticks), settle)


def _longest_ticks(run: Run) -> int:
    """Return the ticks of the longest task over the network, so that all tasks share one draw of the link."""
    period_s = run.cell.controller().period_s
    longest = 0
    for name in TASKS:
        other = run.model_copy(update={"task": name})
        end_s = other.force_profile()[-1]
        longest = max(longest, settle_ticks(other.cell, period_s) + max(1, round(end_s / period_s)))
    return longest


@functools.lru_cache(maxsize=2)
def _schedule(network: str, seed: int, ticks: int, period_s: float) -> Schedule:
    run = Run(task="touch", network=network, law="wave", hand="force", seed=seed)
    return Schedule.of(run.link, ticks, period_s)


def course_until(course: Trajectory, end_s: float) -> Trajectory:
    """Return the part of a course before a time [s]."""
    count = int(np.searchsorted(course.time_s, end_s - 1e-9))
    columns: dict[str, Any] = {field.name: getattr(course, field.name) for field in fields(course)}
    for name, column in columns.items():
        columns[name] = column[:count] if isinstance(column, np.ndarray) else column
    return Trajectory(**columns)


def rounded(value: float | None) -> float | None:
    """Return a figure with DIGITS digits; None for None or a value that is not finite."""
    return float(f"{value:.{DIGITS}g}") if value is not None and math.isfinite(value) else None


def _held(result: CellResult, course: Trajectory, scales: Scales, task: Task) -> dict[str, float | None]:
    """Return the measures of the hold."""
    to_hand = scales.force_scale / scales.position_scale
    tip_j = to_hand * (float(course.tip_energy_j[-1]) - float(course.tip_energy_j[0]))
    apart, work = result.apart_m, result.hand_work_j
    return {
        "force_held_n": result.tip_n,
        "force_error": None if result.tip_n is None else abs(result.tip_n / task.force_n - 1.0),
        "peak_force_n": result.peak_n,
        "position_error_mm": None if apart is None else 1e3 * apart,
        "hand_work_mj": None if work is None else 1e3 * work,
        "tip_work_mj": 1e3 * tip_j,
        "least_energy_mj": 1e3 * result.lowest_energy_j,
    }


def _parted(course: Trajectory, scales: Scales, hold_s: tuple[float, float], swing_hz: float | None) -> float | None:
    """Return the change of the distance of hand and tip since mid-hold [mm], over whole periods of a swing."""
    apart = course.hand_position_m - course.base_position_m / scales.position_scale
    middle_s, tenth_s, end_s = 0.5 * sum(hold_s), 0.1 * (hold_s[1] - hold_s[0]), float(course.time_s[-1])
    spans = (
        (middle_s - 0.5 * tenth_s, middle_s + 0.5 * tenth_s),
        (end_s - (tenth_s if swing_hz is None else 1.0 / swing_hz), end_s),
    )
    means = []
    for first_s, last_s in spans:
        part = apart[slice(*np.searchsorted(course.time_s, (first_s - 1e-9, last_s - 1e-9)).tolist())].tolist()
        if not part:
            return None
        means.append(math.fsum(part) / len(part))
    return 1e3 * (means[1] - means[0])


def _followed(course: Trajectory) -> bool:
    """Return whether the instrument followed to the end; short holds, due to a pause in the commands, are allowed."""
    return bool((course.follows | course.held).all())


def _swung(course: Trajectory, begin_s: float, scales: Scales, task: Task) -> dict[str, float | None]:
    """Return the measures of the swing."""
    first = int(np.searchsorted(course.time_s, begin_s - 1e-9))
    hand_m, tip_m = course.hand_position_m, course.base_position_m / scales.position_scale
    tip_n, rendered_n = scales.force_scale * course.tip_force_n, course.rendered_force_n
    true_n_per_m = scales.force_scale * scales.position_scale * task.stiffness_n_per_m
    moved = _tone(hand_m[first:], course.time_s[first:])
    pressed = _tone(course.hand_force_n[first:], course.time_s[first:])
    motion = _deviation(hand_m[first:])
    step = max(1, round(ETVO_STEP_S / float(course.time_s[1] - course.time_s[0])))
    forward = _offsets(hand_m, tip_m, first, step)
    backward = _offsets(tip_n, rendered_n, first, step)
    return {
        "stiffness_ratio": (pressed / moved).real / true_n_per_m if abs(moved) > 0.0 else None,
        "tracking_error": _deviation(tip_m[first:] - hand_m[first:]) / motion if motion > 0.0 else None,
        "eto_forward_ms": None if forward is None else 1e3 * forward.time_s,
        "evo_forward_mm": None if forward is None else 1e3 * forward.value,
        "eto_backward_ms": None if backward is None else 1e3 * backward.time_s,
        "evo_backward_n": None if backward is None else backward.value,
    }


def _offsets(sent: Series, received: Series, first: int, step: int) -> Offsets | None:
    lags = round(ETVO_LONGEST_S / ETVO_STEP_S)
    count = len(received[first::step])
    past = sent[first - lags * step :: step][: lags + count]
    return etvo(past, received[first::step][:count], ETVO_STEP_S, lags)


def _deviation(values: Series) -> float:
    listed = values.tolist()
    mean = math.fsum(listed) / len(listed)
    return math.sqrt(math.fsum((value - mean) ** 2 for value in listed) / len(listed))


def _tone(values: Series, time_s: Series) -> complex:
    """Return the complex amplitude of a signal at the frequency of the swing, over its whole periods."""
    listed = values.tolist()
    mean = math.fsum(listed) / len(listed)
    phases = [2.0 * math.pi * SWING_HZ * time for time in time_s.tolist()]
    real = math.fsum((value - mean) * math.cos(phase) for value, phase in zip(listed, phases, strict=True))
    imaginary = math.fsum((value - mean) * math.sin(phase) for value, phase in zip(listed, phases, strict=True))
    return complex(real, -imaginary) * (2.0 / len(listed))


# Networks that deliver every message after the same delay.
_EVEN = ("clean", "constant delay")


def _check(run: Run) -> None:
    run.cell.controller()
    run.cell.hold_s()
    run.link.model_dump()


def _doubts(run: Run) -> str:
    even = run.link.network_name in _EVEN
    return run.cell.controller().stiffness_doubts(run.cell.felt_stiffness_n_per_m, even=even)


RUNS = Kind(_check, run, outcome_from, _doubts, batch=36)
