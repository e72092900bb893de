"""How far a hand walks: by the balance of energy first, and over two hundred cycles where that is near zero."""

import pytest
from telenano_studies.loops.cells import Cell
from telenano_studies.loops.transparency import drift_m

SPRING = {"environment": "spring", "stiffness_n_per_m": 10.0}
TIRED = (
    ("passivity.refill_damping_n_s_per_m", 1e-6),
    ("passivity.exchange_s", 1e3),
    ("passivity.start_energy_j", 1e-4),
)


@pytest.mark.check("compiles the closed loop of passivity on a spring")
@pytest.mark.parametrize("round_trip_ms", [20.0, 120.0])
def test_the_hand_of_passivity_does_not_walk(round_trip_ms: float) -> None:
    drift = drift_m(Cell(law="passivity", round_trip_ms=round_trip_ms, **SPRING))
    assert drift is not None
    assert abs(drift) < 1e-9


def test_a_law_that_lives_on_what_it_was_granted_is_seen_to_walk() -> None:
    drift = drift_m(Cell(law="passivity", round_trip_ms=50.0, settings=TIRED, **SPRING))
    assert drift is not None
    assert abs(drift) > 1e-7


def test_a_law_that_has_spent_its_grant_and_stands_has_no_drift_rather_than_one_of_nothing() -> None:
    spent = {"law": "passivity", "environment": "spring", "stiffness_n_per_m": 0.5}
    assert drift_m(Cell(round_trip_ms=120.0, settings=TIRED[:2], **spent)) is None


def test_a_loop_that_no_guard_lets_finish_has_no_drift() -> None:
    assert drift_m(Cell(law="virtual_impedance", round_trip_ms=250.0, **SPRING)) is None
