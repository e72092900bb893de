"""Comparison of both cantilever models by the marks of a force curve: quasi-static, and with Eq. 4 in full."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

from telenano.sections import AfmConfig
from telenano_lab.microscopy.force_curve import Marks, force_curve, marks_of

STIFFNESSES_N_PER_M = (40.0, 8.0, 1.0)


class ModelRow(NamedTuple):
    """Pull-off [N], snap-in base [m] and hysteresis [J] of both models; differences as shares, that of the base in [m].

    step_m: distance of neighbouring points of the curves [m], which limits the resolution of the bases.
    """

    stiffness_n_per_m: float
    static_pull_off_n: float
    dynamic_pull_off_n: float
    pull_off_share: float
    static_snap_in_m: float
    dynamic_snap_in_m: float
    snap_in_difference_m: float
    static_hysteresis_j: float
    dynamic_hysteresis_j: float
    hysteresis_share: float
    step_m: float


def compare_models(
    stiffnesses: Sequence[float] = STIFFNESSES_N_PER_M,
    points: int = 400,
    progress: Callable[[int, int], None] = lambda n, of: None,
) -> list[ModelRow]:
    """Compare the models for each stiffness of the cantilever [N/m]; all other values are those of Table 2."""
    rows = []
    for number, k in enumerate(stiffnesses):
        config = AfmConfig.model_validate({"cantilever": {"stiffness_n_per_m": k}})
        # Far enough for a soft cantilever to come off: its spring is stretched by the pull-off over k.
        start_m = 10e-9 + 16e-9 / k
        curves = [force_curve(config, start_m, 20e-9, points, dynamic=dynamic) for dynamic in (False, True)]
        static, dynamic = (marks_of(curve) for curve in curves)
        base = curves[0].approach.base_m
        rows.append(_row(k, static, dynamic, float(base[1] - base[0])))
        progress(number + 1, len(stiffnesses))
    return rows


def _row(k: float, static: Marks, dynamic: Marks, step_m: float) -> ModelRow:
    snaps = [marks.snap_in_base_m if marks.snap_in_base_m is not None else float("nan") for marks in (static, dynamic)]
    return ModelRow(
        k,
        static.pull_off_force_n,
        dynamic.pull_off_force_n,
        dynamic.pull_off_force_n / static.pull_off_force_n - 1.0,
        snaps[0],
        snaps[1],
        snaps[1] - snaps[0],
        static.hysteresis_j,
        dynamic.hysteresis_j,
        dynamic.hysteresis_j / static.hysteresis_j - 1.0,
        step_m,
    )
