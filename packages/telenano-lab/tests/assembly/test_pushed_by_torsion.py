"""What a push makes of the lateral force as it is measured: gain error, crosstalk and the limit of the guard."""

import math

import pytest
from telenano_lab.assembly import push_program as push
from test_push_program import instrument, pushed, truth


@pytest.mark.parametrize("error", [-0.5, 0.0, 1.0])
def test_a_wrong_gain_changes_what_is_felt_and_neither_particle_nor_belief(error: float) -> None:
    afm = instrument([[0.0, 0.0]], torsion={"gain_error": error, "gain_uncertainty": 0.2})
    state = pushed(afm, mode="straight", x1_m=5e-7)
    assert state.why == push.AT_GOAL
    assert state.plateau_n == pytest.approx(10.7526e-9 * (1.0 + error), rel=2e-3)
    assert math.dist(state.believed, truth(afm)) < 2e-9
    report = afm.outcome
    assert report is not None and report.values is not None
    assert report.values["plateau_error_n"] == pytest.approx(0.2 * state.plateau_n, rel=1e-6)
    assert 0.0 <= float(report.values["believed_error_m"]) < 1e-9


@pytest.mark.parametrize("crosstalk", [-0.4, 0.4])
def test_a_particle_is_lost_in_spite_of_crosstalk_that_looks_like_its_force(crosstalk: float) -> None:
    """The tip presses with 12 nN, of which 4.8 nN seem to be lateral: more than 0.3 of the 10.75 nN of a push."""
    keys = {"mode": "straight", "hold": "force", "y0_m": 1e-7, "y1_m": 1e-7, "x1_m": 2e-6}
    torsion = {"crosstalk_x": crosstalk, "crosstalk_y": 0.5 * crosstalk}
    true, measured = (pushed(instrument([[0.0, 0.0]], **section), **keys) for section in ({}, {"torsion": torsion}))
    assert (true.why, measured.why) == (push.LOST, push.LOST)
    assert measured.gone_m == pytest.approx(true.gone_m, rel=0.05)
    assert measured.plateau_n == pytest.approx(true.plateau_n, rel=0.02)


def test_a_steered_push_arrives_with_crosstalk_and_a_wrong_gain() -> None:
    afm = instrument([[0.0, 0.0]], torsion={"crosstalk_x": 0.2, "crosstalk_y": -0.2, "gain_error": 0.3})
    state = pushed(afm, mode="steered", hold="force", y0_m=1.5e-7, x1_m=1e-6, y1_m=3e-7, speed_m_per_s=5e-6)
    assert state.why == push.AT_GOAL
    assert math.dist(truth(afm), (1e-6, 3e-7)) < 15e-9


def test_the_guard_judges_what_is_measured() -> None:
    limits = {
        "base_min_m": -1e-6,
        "retract_position_m": -7e-7,
        "base_speed_m_per_s": 2e-5,
        "retract_speed_m_per_s": 2e-5,
        # above the 10.75 nN of a push, and below twice that
        "lateral_limit_n": 15e-9,
    }
    for gain_error, ends in ((0.0, False), (1.0, True)):
        afm = instrument([[0.0, 0.0]], safety=limits, torsion={"gain_error": gain_error})
        pushed(afm, mode="straight", x1_m=5e-7)
        assert afm.outcome is not None and ("lateral_limit" in afm.outcome.text) is ends


def test_what_judges_a_simulation_finds_the_particles_behind_the_channel() -> None:
    afm = instrument([[1e-6, -5e-7]], torsion={"gain_error": 0.1})
    afm.device.exchange(0.0)
    assert afm.truths["particles"].places_m.tolist() == [[1e-6, -5e-7]]
