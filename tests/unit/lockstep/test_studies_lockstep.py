"""The lockstep loop against a loop written out by hand, against itself without the compiler, and its delays."""

from typing import Any

import numpy as np
import pytest
from telenano_lab.studies.loops.cells import Cell, course_of, rig_of, trajectory_of
from telenano_lab.studies.loops.links import symmetric_link
from tried_laws import TRIED_LAWS as LAWS

from telenano.afm import step as afm
from telenano.afm.safety import MODE_FOLLOW
from telenano.extend.laws import NO_SIGNAL, HandSample
from telenano.laws.virtual_impedance import ImpedanceState, master_receive
from telenano.lockstep.link import Schedule
from telenano.sections import VirtualImpedanceConfig
from telenano.sections.afm_section import AfmConfig

PERIOD_S = 1e-3
FIG12 = ((0.8, 0.0), (1.2, 1.0), (2.6, 1.0), (2.9, 2.0), (4.5, 2.0), (4.6, 0.0))


def cell(law: str = "virtual_impedance", environment: Any = "spring", delay_ms: float = 20.0, **more: Any) -> Cell:
    stiffness = 40.0 if environment == "tip_sample" else 20.0
    return Cell(law=law, environment=environment, round_trip_ms=delay_ms, stiffness_n_per_m=stiffness, **more)


def written_out(force_at: Any, delay_ticks: int, lead_in: int, ticks: int) -> dict[str, np.ndarray]:
    """The paper's law coupled to a tip by hand: x of tick n - d gives F, which acts on x from n to n + 1."""
    law = VirtualImpedanceConfig().to_params(PERIOD_S)
    state, positions, forces = ImpedanceState(0.0, 0.0, 0.0), [], []
    for n in range(lead_in + ticks):
        positions.append(state.position_m)
        base_m = law.position_scale * positions[n - delay_ticks] if n >= delay_ticks else 0.0
        forces.append(force_at(base_m))
        hand_n = np.interp((n - lead_in) * PERIOD_S, *zip(*FIG12, strict=True)) if n >= lead_in else 0.0
        hand = HandSample(state.position_m, 0.0, float(hand_n), True)
        signal = NO_SIGNAL._replace(force_n=forces[-1], active=True, silence_s=0.0)
        state, _ = master_receive(law, state, hand, signal, PERIOD_S)
    return {"x": np.array(positions[lead_in:]), "f": np.array(forces[lead_in:])}


@pytest.mark.usefixtures("plain_loop")
@pytest.mark.parametrize("delay_ms", [0.0, 7.0, 40.0])
def test_spring_loop_is_the_loop_written_out(delay_ms: float) -> None:
    course = course_of(cell(delay_ms=delay_ms), FIG12, 6.0)
    expected = written_out(lambda base_m: 20.0 * base_m, int(delay_ms), 0, len(course.time_s))
    # the command of a tick is where the mass is at the next one
    np.testing.assert_allclose(course.reference_m[:-1], expected["x"][1:], rtol=0.0, atol=1e-12)
    # half of the delay lies before the spring
    half = int(delay_ms) // 2
    felt = 20.0 * 1.5e-6 * expected["x"][: len(expected["x"]) - half]
    np.testing.assert_allclose(course.tip_force_n[half:], felt, rtol=0.0, atol=1e-10 * felt.max())


@pytest.mark.usefixtures("plain_loop")
@pytest.mark.parametrize("delay_ms", [0, 40])
def test_contact_loop_is_the_loop_written_out(delay_ms: int) -> None:
    course = course_of(cell(environment="tip_sample", delay_ms=float(delay_ms)), FIG12, 8.0)
    params = AfmConfig().to_params()
    tip, _ = afm.step(params, afm.initial_afm_state(params), afm.AfmInputs(0.0, 0.0, 0, True, False), PERIOD_S)
    for _ in range(200):
        tip, _ = afm.step(params, tip, afm.AfmInputs(0.0, 0.0, 0, False, False), PERIOD_S)
    box = [tip]

    def force_at(base_m: float) -> float:
        box[0], (sample, _) = afm.step(params, box[0], afm.AfmInputs(base_m, 0.0, 0, False, False), PERIOD_S)
        return float(sample.force_n)

    # while the rig waits for the session the far attraction of the sample moves the hand by less than a micrometre
    expected = written_out(force_at, delay_ms, 50, len(course.time_s))
    np.testing.assert_allclose(course.reference_m[:-1], expected["x"][1:], rtol=0.0, atol=2e-6)
    assert course.reference_m[-1] == pytest.approx(0.703e-2, rel=1e-3, abs=0.0)
    assert course.tip_force_n.min() == pytest.approx(-12.5e-9, rel=1e-2, abs=0.0)
    if delay_ms == 0:
        np.testing.assert_allclose(course.tip_force_n, expected["f"], rtol=0.0, atol=5e-11)
        ratio = course.hand_force_n[2200:2500] / (1e8 * course.tip_force_n[2200:2500])
        assert ratio.mean() == pytest.approx(1.05, rel=1e-6, abs=0.0)


@pytest.mark.usefixtures("plain_loop")
@pytest.mark.grid(law="passivity")
@pytest.mark.parametrize("law", list(LAWS))
def test_every_law_holds_the_hand_against_the_spring(law: str) -> None:
    course = trajectory_of(cell(law, delay_ms=5.0, session_s=3.0))
    assert (course.instrument_mode == MODE_FOLLOW).all()
    assert course.hand_following.all()
    ratio = course.hand_force_n[-200:] / (1e8 * course.tip_force_n[-200:])
    assert 0.9 < ratio.mean() < 1.15
    assert np.ptp(ratio) < 0.05


def test_compiled_and_plain_loop_are_the_same(request: pytest.FixtureRequest) -> None:
    compiled = trajectory_of(cell(delay_ms=12.3, jitter_ms=2.0, loss=0.1, session_s=2.0))
    request.getfixturevalue("plain_loop")
    plain = trajectory_of(cell(delay_ms=12.3, jitter_ms=2.0, loss=0.1, session_s=2.0))
    for name in ("tip_force_n", "reference_m", "hand_position_m"):
        np.testing.assert_allclose(getattr(plain, name), getattr(compiled, name), rtol=1e-9, atol=1e-18)


def test_fraction_of_a_sample_acts_in_the_tick_of_arrival() -> None:
    courses = [trajectory_of(cell(delay_ms=delay, session_s=2.0)).reference_m for delay in (22.0, 22.9, 23.0)]
    np.testing.assert_allclose(courses[1], courses[0], rtol=1e-9, atol=1e-15)
    assert np.abs(courses[2] - courses[0]).max() > 1e-3 * courses[0].max()


def test_same_seed_same_course_other_seed_other_course() -> None:
    courses = [
        trajectory_of(cell(delay_ms=20.0, jitter_ms=5.0, loss=0.2, seed=seed, session_s=2.0)).tip_force_n
        for seed in (1, 1, 2)
    ]
    assert (courses[0] == courses[1]).all()
    assert (courses[0] != courses[2]).any()


def test_silent_link_lets_the_hand_go_and_retracts_the_tip() -> None:
    settings = symmetric_link(0.0, 0.0, 0.0, 0)
    schedule = Schedule.of(settings, 1500, PERIOD_S)
    cut = schedule.forward_ns < 800_000_000
    dead = schedule._replace(
        forward_ns=schedule.forward_ns[cut],
        forward_of=schedule.forward_of[cut],
        backward_ns=schedule.backward_ns[cut],
        backward_of=schedule.backward_of[cut],
    )
    example = cell(environment="tip_sample")
    course = rig_of(example, example.hand_points()).run(dead, 300)
    assert course.hand_following[400]
    # 50 ms of silence, and the tick in which the hand learns of it
    assert not course.hand_following[553:].any()
    assert course.instrument_mode[520] == MODE_FOLLOW
    assert (course.instrument_mode[760:] != MODE_FOLLOW).all()
    assert course.base_position_m[-1] == pytest.approx(-100e-9, rel=1e-9, abs=0.0)


def test_energies_are_the_work_at_the_device_and_at_the_base() -> None:
    course = course_of(cell(delay_ms=0.0), FIG12, 4.0)
    stored = 0.5 * 20.0 * course.base_position_m**2
    np.testing.assert_allclose(course.tip_energy_j / stored.max(), stored / stored.max(), rtol=0.0, atol=1e-9)
    mean = 0.5 * (course.hand_force_n[1:] + course.hand_force_n[:-1])
    work = np.sum(mean * np.diff(course.hand_position_m))
    assert course.hand_energy_j[-1] - course.hand_energy_j[0] == pytest.approx(work, rel=1e-9, abs=0.0)


def test_session_needs_ticks() -> None:
    example = cell()
    schedule = Schedule.of(symmetric_link(0.0, 0.0, 0.0, 0), 10, PERIOD_S)
    with pytest.raises(ValueError, match="tick 10 of 10"):
        rig_of(example, example.hand_points()).run(schedule, 10)
