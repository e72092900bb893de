"""Disturbances in the lockstep: what they do to a cell."""

from typing import Any

import numpy as np
import pytest
from telenano_lab.studies import option_values
from telenano_lab.studies.loops.cells import Cell, course_of, run_cell

from telenano.wire import ConfigError


def test_a_cell_tells_what_there_is_to_disturb_and_what_is_unknown() -> None:
    assert option_values.disturbances(["drift", "thermal.temperature_k=77"]) == (
        ("drift.enabled", True),
        ("thermal.enabled", True),
        ("thermal.temperature_k", 77),
    )

    def cell(environment: str, *given: str) -> Cell:
        return Cell(
            law="virtual_impedance", environment=environment, round_trip_ms=0.0, stiffness_n_per_m=40.0,
            disturbances=option_values.disturbances(given),
        )  # fmt: skip

    # what says a force alone is read by the cantilever of Table 2
    assert cell("spring", "drift").disturbed_instrument(1.0).plant.instrument.stiffness_n_per_m == 40.0
    with pytest.raises(ConfigError, match="gremlins"):
        cell("tip_sample", "gremlins").disturbed_instrument(1.0)
    with pytest.raises(ConfigError, match=r"thermal\.temperature_k"):
        cell("tip_sample", "thermal.temperature_k=-1").disturbed_instrument(1.0)
    assert cell("tip_sample").key != cell("tip_sample", "drift").key


@pytest.mark.check("compiles a disturbed loop, takes 9 s")
@pytest.mark.drawn(0.0, "packages/telenano-lab/telenano_lab/studies/", "telenano/afm/")
def test_a_disturbed_course_is_compiled_and_its_seed_decides_it(request: pytest.FixtureRequest) -> None:
    def course(seed: int, *disturbed: str) -> Any:
        cell = Cell(
            law="virtual_impedance", environment="tip_sample", round_trip_ms=10.0, stiffness_n_per_m=40.0, seed=seed,
            disturbances=option_values.disturbances(disturbed),
        )  # fmt: skip
        return course_of(cell, ((0.0, 0.0), (0.1, 2.0), (0.5, 2.0)), 0.5)

    noise = ("readout", "vibration")
    noisy, quiet, other = course(1, *noise), course(1), course(2, *noise)
    assert noisy.in_contact.any()
    assert not np.array_equal(noisy.tip_force_n, quiet.tip_force_n)
    assert not np.array_equal(noisy.tip_force_n, other.tip_force_n)
    # the plain steps of the node give the same bits
    request.getfixturevalue("plain_loop")
    plain = course(1, *noise)
    for name in ("tip_force_n", "base_position_m", "hand_position_m", "in_contact", "instrument_mode"):
        assert np.array_equal(getattr(noisy, name), getattr(plain, name)), name


@pytest.mark.endurance
def test_a_disturbed_cell_is_judged_and_its_seed_decides_it() -> None:
    cells: list[Any] = [
        Cell(law="virtual_impedance", environment="tip_sample", round_trip_ms=10.0, stiffness_n_per_m=40.0, seed=seed,
             disturbances=given)
        for seed, given in (
            (1, ()), (1, (("readout.enabled", True), ("vibration.enabled", True))),
            (2, (("readout.enabled", True), ("vibration.enabled", True))),
        )
    ]  # fmt: skip
    quiet, noisy, other = (run_cell(cell) for cell in cells)
    # the noise of this read-out hides what the ground moves, and is no motion of the loop
    assert quiet.verdict == "stable"
    assert {noisy.verdict, other.verdict} <= {"stable", "cannot_say"}
    assert quiet.peak_n is not None
    assert noisy.peak_n is not None
    assert noisy.peak_n > quiet.peak_n + 0.1
    assert noisy.peak_n != other.peak_n
    again = course_of(cells[1], cells[1].hand_points(), 2.0)
    assert np.array_equal(again.tip_force_n, course_of(cells[1], cells[1].hand_points(), 2.0).tip_force_n)
