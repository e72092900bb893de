"""The stated stiffness limits over lines that lose signals or hold them back, at nine tenths of each, in lockstep."""

from itertools import product
from typing import Any

import numpy as np
import pytest
from telenano_lab.studies.loops.cells import LAWS as INSTALLED
from telenano_lab.studies.loops.cells import Cell, CellResult, hold_ratio, run_cell

LAWS = ("wave", "passivity", "model_mediated")
# These come with telenano-laws, and are tried where it is installed.
PACKAGE_LAWS = ("bounded_model", "fractal_impedance", "matched_wave")
CLAMPED = ("position_force", "virtual_impedance", "smith")
SEEDS = (101, 102, 103, 201, 202, 203)
LOSSY: list[dict[str, Any]] = [
    {"round_trip_ms": 60.0, "loss": 0.2},
    {"round_trip_ms": 60.0, "jitter_ms": 15.0, "loss": 0.2},
    {"round_trip_ms": 200.0, "jitter_ms": 50.0, "loss": 0.2},
    {"round_trip_ms": 20.0, "loss": 0.5},
]
KINDS = ("slots", "bursts", "outages", "sawtooth")
UNEVEN: list[dict[str, Any]] = [
    {"round_trip_ms": 20.0, "uneven": kind, "uneven_ms": size_ms}
    for kind, size_ms in product(KINDS, (10.0, 20.0, 30.0))
]
# Passivity needs nothing of what it was granted. Over a line whose delay varies model_mediated presses before its hand
# feels the surface, the longer the more it varies [ms], and bounded_model has a store that it may spend.
LEAST_J, LEAST_WHILE_LEARNING_J, BOUNDED_MODEL_J = -1e-6, {15.0: -2e-4, 50.0: -4e-4}, -4e-4
MOST_N = 1.5
# Behind the clamp these are the hand's force and F_0, and what such laws make of a line by themselves.
MOST_CLAMPED_N, LEAST_CLAMPED_J = 1.105, -2e-4


def at_share(
    law: str, share: float, line: dict[str, Any], seed: int = 0, session_s: float = 4.0, **more: Any
) -> CellResult:
    """Run a hand of 1 N on a spring of a share of what the law states to bear over such a line."""
    cell = Cell(law=law, environment="spring", stiffness_n_per_m=1.0, seed=seed, session_s=session_s, **line, **more)
    limit = cell.controller().stiffness_limit_n_per_m(even=False)
    assert limit is not None
    return run_cell(cell.model_copy(update={"stiffness_n_per_m": share * limit}))


def is_borne(result: CellResult) -> bool:
    learning_j = LEAST_WHILE_LEARNING_J.get(result.cell.jitter_ms, LEAST_J)
    least_j = {"model_mediated": learning_j, "bounded_model": BOUNDED_MODEL_J}.get(result.cell.law, LEAST_J)
    return result.lowest_energy_j >= least_j and result.peak_n is not None and result.peak_n <= MOST_N


@pytest.mark.parametrize(
    ("law", "line"), [("wave", LOSSY[1]), ("passivity", UNEVEN[9]), ("model_mediated", UNEVEN[9])], ids=LAWS
)
def test_a_line_with_gaps_is_borne_to_its_limit_and_not_to_that_of_an_even_one(
    law: str, line: dict[str, Any], plain_loop: None
) -> None:
    # The loop runs without the compiler, which would take longer over the law than the run does.
    assert is_borne(at_share(law, 0.9, line, SEEDS[0], 1.8))
    # 16/7 of it is what an even line bears
    assert not is_borne(at_share(law, 0.9 * 16.0 / 7.0, line, SEEDS[0], 1.8))


@pytest.mark.check("every line, from six seeds")
@pytest.mark.drawn(0.4)
@pytest.mark.parametrize("law", [*LAWS, *(pytest.param(law, marks=pytest.mark.endurance) for law in PACKAGE_LAWS)])
def test_nine_tenths_of_the_limit_are_borne_over_every_line(law: str) -> None:
    if law not in INSTALLED:
        pytest.skip(f"no installed package has the law {law}")
    results = [at_share(law, 0.9, line, seed) for line in LOSSY for seed in SEEDS]
    results += [at_share(law, 0.9, line) for line in UNEVEN]
    assert [result for result in results if not is_borne(result)] == []


@pytest.mark.check("every line, from six seeds")
@pytest.mark.drawn(0.4)
@pytest.mark.parametrize("law", CLAMPED)
def test_behind_the_clamp_nine_tenths_of_its_limit_are_pressed_no_harder_than_the_hand_presses(law: str) -> None:
    # At 200 ms these laws swing without any loss, and the hand is pushed with all that the device has.
    short = [line for line in LOSSY if line["round_trip_ms"] < 200.0]
    lines = [(line, seed) for line in short for seed in SEEDS] + [(line, 0) for line in UNEVEN]
    results = [at_share(law, 0.9, line, seed, settings=(("clamp.enabled", True),)) for line, seed in lines]
    assert [each for each in results if each.peak_n is None or each.peak_n > MOST_CLAMPED_N] == []
    assert [each for each in results if each.lowest_energy_j < LEAST_CLAMPED_J] == []


@pytest.mark.parametrize(
    ("force_n", "ratio"), [([0.5, 0.25], 3.0), ([0.5, 0.0], None), ([0.5, 1e-310], None), ([], None)]
)
def test_the_ratio_of_a_hold_is_a_number_or_none(force_n: list[float], ratio: float | None) -> None:
    assert hold_ratio(np.ones(len(force_n)), np.array(force_n)) == ratio
