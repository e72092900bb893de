"""A push by the tip, in simulated time: where the particle ends, what was felt, and what is refused."""

import math
from typing import Any

import pytest
from telenano_lab.assembly import push_program as push
from telenano_lab.assembly.particles.push import KINETIC, RADIUS, RESTED, push_step
from telenano_lab.assembly.particles.settings import ParticlesConfig
from telenano_lab.assembly.particles.tip_shape import Spring, tip_shape, touch_distance_m
from telenano_lab.assembly.push_program import Push, PushSettings, PushState

from telenano.devices import VirtualInstrument
from telenano.extend.programs import Inputs, Instrument
from telenano.extend.samples import Oscillation
from telenano.extend.stage import LateralParams, Place
from telenano.sections import AfmConfig
from telenano.settings import validate
from telenano.wire import RefusedError

ORIGIN, SIDES, LATERAL = Place(0.0, 0.0), (8e-6, 8e-6), LateralParams(5e-5, 2e-5)


def inputs_at(place: Place, lateral_n: tuple[float, float]) -> Inputs:
    return Inputs(0.0, place, 0.0, lateral_n, Oscillation(0.0, 0.0), ORIGIN)


def instrument(places: list[list[float]], **others: Any) -> VirtualInstrument:
    section = {
        "sample": {"name": "flat", "size_m": 8e-6, "pixels": 16, "particles": {"places": places}},
        "cantilever": {"stiffness_n_per_m": 1.0},
        "meniscus": False,
        "safety": {
            "base_min_m": -1e-6,
            "retract_position_m": -7e-7,
            "base_speed_m_per_s": 2e-5,
            "retract_speed_m_per_s": 2e-5,
        },
        **others,
    }
    return VirtualInstrument(validate(AfmConfig, section, "a test", "afm_node"))


def pushed(afm: VirtualInstrument, **keys: Any) -> PushState:
    """Run a push and return its last state."""
    state: Any = None
    parameters = {"program": "push", "push.approach_m_per_s": 2e-6}
    for step in afm.run(parameters | {f"push.{key}": value for key, value in keys.items()}):
        state = step.wanted.state
    assert isinstance(state, PushState)
    return state


def truth(afm: VirtualInstrument, number: int = 0) -> tuple[float, float]:
    x, y = afm.device.state.part.moving[number, :2].tolist()
    return x, y


@pytest.mark.parametrize(("first_deg", "way_nm"), [(30.0, 2012.4), (90.0, 2131.9)])
def test_a_steered_push_turns_the_particle_to_its_goal(first_deg: float, way_nm: float) -> None:
    limits = AfmConfig().to_params().safety
    plan, state, *_ = Push().begin(
        PushSettings(x1_m=2e-6, height_m=0.0, tolerance_m=1e-9), Instrument(limits, LATERAL, SIDES, 1.0, 1e-3), ORIGIN
    )
    d, first = plan.distance_m, math.radians(first_deg)
    tip = Place(-d * math.cos(first), -d * math.sin(first))
    fixed, moving = ParticlesConfig(places=((0.0, 0.0),)).rows(10e-9, 1e-5, 1e-5)
    shape, spring = tip_shape(10e-9, math.radians(15.0)), Spring(1.0, 1e6, 0.0, False, 0.01)
    state = state._replace(phase=push.PUSH, steps=3, place=tip)
    way, before, why = 0.0, Place(0.0, 0.0), ""
    force = (-1e-8 * math.cos(first), -1e-8 * math.sin(first))
    while not why:
        state = push._felt(plan, state._replace(force_x_n=force[0], force_y_n=force[1]), inputs_at(tip, force))
        why = push._ended(plan, state, 0.0)
        state, target = push._onwards(plan, state, 1e-3)
        moving, contact = push_step(shape, spring, fixed, moving, (*tip, *target), (0.0, -20e-9), 1e-3)
        tip, force = target, (contact.push_x_n, contact.push_y_n)
        here = Place(*moving[0, :2].tolist())
        way, before = way + math.dist(here, before), here
    assert why == push.AT_GOAL
    assert math.dist(before, (2e-6, 0.0)) < 2.5e-9
    assert way * 1e9 == pytest.approx(way_nm, rel=0.02)


@pytest.mark.parametrize("first_deg", [5.0, 15.0, 30.0])
@pytest.mark.parametrize(("tick_m", "least", "most"), [(2e-9, 0.015, 0.025), (2e-8, 0.055, 0.085)])
def test_the_part_of_the_force_along_a_push_is_late_by_a_tick(
    first_deg: float, tick_m: float, least: float, most: float
) -> None:
    fixed, moving = ParticlesConfig(places=((0.0, 0.0),)).rows(10e-9, 1e-5, 1e-5)
    # it never rests for so long that its static friction is back
    shape, spring = tip_shape(10e-9, math.radians(15.0)), Spring(1.0, 1e6, 0.0, False, 1e9)
    d, half = touch_distance_m(shape, fixed[0, RADIUS], 0.0), math.tan(0.5 * math.radians(first_deg))
    x, y = -d * math.cos(math.radians(first_deg)), -d * math.sin(math.radians(first_deg))
    moving[0, RESTED], way = 0.0, 0.0
    while way < 0.9 * d * math.log(1.0 / half):
        moving, contact = push_step(shape, spring, fixed, moving, (x, y, x + tick_m, y), (0.0, -20e-9), 1e-3)
        x, way = x + tick_m, way + tick_m
    force = math.hypot(contact.push_x_n, contact.push_y_n)
    assert force == pytest.approx(fixed[0, KINETIC], rel=1e-9)
    expected = force * math.cos(2.0 * math.atan(half * math.exp(way / d)))
    assert least < 1.0 + contact.push_x_n / expected < most


def test_a_steered_push_finds_its_goal_from_beside_the_particle() -> None:
    afm = instrument([[0.0, 0.0]])
    state = pushed(afm, mode="steered", y0_m=1.5e-7, x1_m=2e-6, y1_m=3e-7, speed_m_per_s=5e-6)
    assert state.why == push.AT_GOAL
    assert math.dist(truth(afm), (2e-6, 3e-7)) < 10e-9


def test_a_straight_push_brings_it_to_its_goal_and_knows_where_it_is() -> None:
    afm = instrument([[0.0, 0.0], [2e-6, 2e-6]])
    state = pushed(afm, mode="straight", x1_m=1e-6)
    assert state.why == push.AT_GOAL
    assert math.dist(truth(afm), (1e-6, 0.0)) < 6e-9
    assert math.dist(state.believed, truth(afm)) < 2e-9
    assert state.plateau_n == pytest.approx(10.7526e-9, rel=1e-3)
    assert truth(afm, 1) == (2e-6, 2e-6)
    assert afm.outcome is not None and afm.outcome.state == "finished"
    assert afm.device.state.inputs.base_m == pytest.approx(-7e-7)


def test_a_straight_push_that_begins_beside_it_ends_where_it_is_lost() -> None:
    afm = instrument([[0.0, 0.0]])
    state = pushed(afm, mode="straight", y0_m=1e-7, y1_m=1e-7, x1_m=2e-6)
    assert state.why == push.LOST
    # it slips off by ln cot(phi / 2) of the distance, with sin phi the share that it began beside the line
    slips = math.log(1.0 / math.tan(0.5 * math.asin(1e-7 / 332e-9))) * 332e-9
    assert state.gone_m < 0.3 * 332e-9 + slips + 0.3 * 332e-9
    assert afm.outcome is not None and "the particle is lost" in afm.outcome.text


def test_where_no_particle_is_the_push_says_so() -> None:
    assert pushed(instrument([[2e-6, 2e-6]]), mode="steered").why == push.NOT_MET


def test_a_push_with_a_force_holds_it_and_one_against_a_wall_of_particles_is_limited() -> None:
    afm = instrument([[0.0, 0.0]])
    assert pushed(afm, hold="force", x1_m=5e-7).why == push.AT_GOAL
    assert math.dist(truth(afm), (5e-7, 0.0)) < 8e-9
    row = instrument([[i * 0.5e-6, 0.0] for i in range(5)])
    limited = pushed(row, mode="straight", x1_m=1e-6, lateral_limit_n=45e-9)
    assert "push.lateral_limit_n = 4.5e-08 N" in limited.why
    guarded = instrument(
        [[i * 0.5e-6, 0.0] for i in range(5)],
        safety={
            "base_min_m": -1e-6,
            "retract_position_m": -7e-7,
            "lateral_limit_n": 45e-9,
            "base_speed_m_per_s": 2e-5,
        },
    )
    pushed(guarded, mode="straight", x1_m=1e-6)
    assert guarded.outcome is not None and "lateral_limit" in guarded.outcome.text


def test_a_sweep_brings_a_particle_along_whose_place_is_not_well_known() -> None:
    for beside in (-1.5e-7, 0.0, 1e-7):
        afm = instrument([[5e-8, beside]])
        state = pushed(afm, mode="sweep", x1_m=1e-6, speed_m_per_s=1e-5)
        assert state.why == push.AT_GOAL
        assert truth(afm)[0] == pytest.approx(1e-6, abs=0.26 * 333e-9)


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"x1_m": 1e-9}, "within push.tolerance_m"),
        ({"setpoint_n": 3e-7}, "push.setpoint_n must lie between"),
        ({"height_m": 6e-7}, "above a particle of radius"),
        ({"x1_m": 6e-5}, "lateral.reach_m"),
        ({"x1_m": 4.1e-6}, "its goal at 4.1e-06, 0 m lies outside of the sample of 8e-06 x 8e-06 m"),
        ({"hold": "force", "gain_per_s": 1e5}, "push.gain_per_s"),
    ],
)
def test_a_push_that_cannot_be_is_refused_in_one_sentence_and_nothing_moves(keys: dict[str, Any], words: str) -> None:
    afm = instrument([[0.0, 0.0]])
    with pytest.raises(RefusedError, match=words.replace(".", r"\.")):
        pushed(afm, **keys)
    assert truth(afm) == (0.0, 0.0) and afm.time_s == 0.0


@pytest.mark.parametrize("left_m", [-1e-7, 0.0])
def test_a_light_image_whose_edge_lies_on_a_particle_leaves_it_where_it_is(left_m: float) -> None:
    """From line to line the tip goes as fast as along one; a quicker step would press on the flank and push it."""
    afm = instrument([[0.0, 0.0]], cantilever={"stiffness_n_per_m": 0.1})
    keys = {
        "program": "scan",
        "scan.setpoint_n": 1.5e-9,
        "scan.x_m": left_m + 3e-7,
        "scan.width_m": 6e-7,
        "scan.depth_m": 1.2e-6,
        "scan.pixels": 12,
        "scan.lines": 8,
        "scan.dwell_s": 25e-3,
        "scan.approach_m_per_s": 5e-6,
        "scan.settle_s": 0.05,
    }
    before, ways, lines = None, [], 0
    for step in afm.run(keys):
        phase = step.wanted.state.phase
        if before is not None:
            ways.append((phase, math.dist(step.inputs.place, before)))
        before = step.inputs.place
        if step.wanted.line is not None:
            lines, scanning = lines + 1, phase
    assert truth(afm) == (0.0, 0.0)
    assert max(way for phase, way in ways if phase == scanning) <= 2e-9 * (1.0 + 1e-6)
    assert lines == 16


@pytest.mark.parametrize(("dwell_s", "gain_per_s", "stays"), [(40e-3, 1200.0, True), (7e-3, 400.0, False)])
def test_the_image_of_the_walk_in_the_page_leaves_particles_and_a_quick_one_does_not(
    dwell_s: float, gain_per_s: float, stays: bool
) -> None:
    """The figures are those of `docs/particles.md`, at the page, with the pixels and lines of its 8 um."""
    afm = instrument([[0.0, 0.0]], cantilever={"stiffness_n_per_m": 0.1})
    image = {"setpoint_n": 1.5e-9, "width_m": 7.5e-7, "depth_m": 6e-7, "pixels": 6, "lines": 3}
    image |= {"approach_m_per_s": 2e-6, "dwell_s": dwell_s, "gain_per_s": gain_per_s}
    for _ in afm.run({"program": "scan"} | {f"scan.{key}": value for key, value in image.items()}):
        pass
    assert (math.hypot(*truth(afm)) < 1e-9) == stays
