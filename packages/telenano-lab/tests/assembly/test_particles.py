"""The particles on a surface: what holds them, where a tip touches them, and how they go when it pushes.

The figures are closed forms: JKR and the friction of its area, a circle and a straight line that touch a circle, and
d phi / ds = sin phi / d for a push along a straight line.
"""

import math
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from telenano_lab.assembly.particles import push
from telenano_lab.assembly.particles.adhered_sphere import KINDS, contact_radius_m, hold_of
from telenano_lab.assembly.particles.cluster import give_way
from telenano_lab.assembly.particles.push import push_step
from telenano_lab.assembly.particles.tip_shape import Spring, join_height_m, ride_height_m, tip_shape, touch_distance_m

CONE = math.radians(15.0)
TIP = tip_shape(10e-9, CONE)
SPRING = Spring(1.0, 100.0, 0.0, False, 0.01)
PRESSED = (0.0, -20e-9)  # the apex on the substrate, with a load of 20 nN


def rows(kind: str, places: list[tuple[float, float]], **given: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return what is fixed and what moves of particles of a kind."""
    k = KINDS[kind]
    hold = hold_of(k, given.get("kinetic", 0.5), given.get("motion", "slide"), 10e-9, CONE, 0.0)
    fixed = np.tile(np.array([k.radius_m, *hold]), (len(places), 1))
    return fixed, np.column_stack([np.array(places, float).reshape(-1, 2), np.full(len(places), 1.0)])


def reach(kind: str, apex_m: float = 0.0) -> float:
    return touch_distance_m(TIP, KINDS[kind].radius_m, apex_m)


def pushed(
    fixed: np.ndarray,
    moving: np.ndarray,
    way: list[tuple[float, float]],
    heights: tuple[float, float] = PRESSED,
    spring: Spring = SPRING,
) -> tuple[np.ndarray, list[push.Contact]]:
    """Return the particles after a way of the stage, and the contact at each of its points."""
    seen = []
    for (x0, y0), (x1, y1) in pairwise(way):
        moving, contact = push_step(TIP, spring, fixed, moving, (x0, y0, x1, y1), heights, 1e-3)
        seen.append(contact)
    return moving, seen


def line(x0: float, x1: float, y: float = 0.0, step: float = 2e-9) -> list[tuple[float, float]]:
    count = max(math.ceil(abs(x1 - x0) / step), 1)
    return [(x0 + (x1 - x0) * i / count, y) for i in range(count + 1)]


@pytest.mark.parametrize(
    ("kind", "a_nm", "slides_nn", "pull_off_nn"),
    [
        ("latex_250", 23.884, 21.505, 58.905),
        ("gold_50", 4.3771, 3.0095, 23.562),
        ("silica_500", 14.993, 21.185, 117.81),
    ],
)
def test_a_preset_adheres_and_slides_as_jkr_says(kind: str, a_nm: float, slides_nn: float, pull_off_nn: float) -> None:
    k = KINDS[kind]
    hold = hold_of(k, 0.5, "slide", 10e-9, CONE, 0.0)
    assert contact_radius_m(*k[:3]) * 1e9 == pytest.approx(a_nm, rel=1e-4)
    assert (hold.static_n * 1e9, hold.kinetic_n * 2e9) == pytest.approx((slides_nn, slides_nn), rel=1e-4)
    assert hold.pull_off_n * 1e9 == pytest.approx(pull_off_nn, rel=1e-4)


def test_a_smooth_sphere_rolls_where_that_needs_less() -> None:
    rolls = hold_of(KINDS["latex_250"], 0.5, "roll", 10e-9, CONE, 0.0)
    assert rolls.kinetic_n * 1e9 == pytest.approx(2.340, rel=2e-3)
    assert hold_of(KINDS["latex_250"], 0.5, "auto", 10e-9, CONE, 0.0) == rolls
    sticks = KINDS["latex_250"]._replace(rolling_m=1e-6)
    assert hold_of(sticks, 0.5, "auto", 10e-9, CONE, 0.0).static_n * 1e9 == pytest.approx(21.505, rel=1e-4)


@pytest.mark.parametrize(
    ("kind", "apex_nm", "distance_nm"),
    [
        *(("latex_250", z, d) for z, d in ((0, 333.480), (100, 306.685), (400, 204.939), (480, 100.0))),
        *(("gold_50", z, d) for z, d in ((0, 72.8345), (20, 67.4756), (60, 56.5685), (90, 33.1662))),
    ],
)
def test_the_tip_touches_a_sphere_at_this_distance_and_rides_it_there(
    kind: str, apex_nm: float, distance_nm: float
) -> None:
    radius_m = KINDS[kind].radius_m
    assert touch_distance_m(TIP, radius_m, apex_nm * 1e-9) * 1e9 == pytest.approx(distance_nm, rel=1e-5)
    assert ride_height_m(TIP, radius_m, distance_nm * 1e-9) * 1e9 == pytest.approx(apex_nm, rel=1e-4, abs=1e-3)


def test_the_image_of_a_sphere_is_a_cap_on_a_cone() -> None:
    assert join_height_m(TIP, 250e-9) * 1e9 == pytest.approx(307.293, rel=1e-5)
    seen = [ride_height_m(TIP, 250e-9, share * 333.48e-9) * 1e9 for share in (0.25, 0.5, 0.75)]
    assert seen == pytest.approx([486.271, 439.494, 311.029], rel=1e-5)


@pytest.mark.parametrize(("loaded", "least_nn"), [(False, 5.7623), (True, 5.9525)])
def test_a_particle_yields_to_more_than_this_load_and_carries_the_tip_below(loaded: bool, least_nn: float) -> None:
    spring = SPRING._replace(normal_n_per_m=1e-5, loaded_area=loaded)
    for share, yields in ((0.995, False), (1.005, True)):
        fixed, moving = rows("latex_250", [(0.0, 0.0)])
        # a soft cantilever presses with the same load at each height
        heights = (0.0, -share * least_nn * 1e-9 / spring.normal_n_per_m)
        way = line(-1.2 * reach("latex_250"), 0.0)
        moving, seen = pushed(fixed, moving, way, heights, spring)
        assert (sum(c.moved for c in seen) > 0) is yields
        assert bool(max(c.apex_m for c in seen) > 450e-9) is not yields


@pytest.mark.check("thousands of small steps of a push, or their compilation")
@pytest.mark.parametrize(("radius_nm", "most_nn"), [(50, 207.24), (10, 19.319)])
def test_a_tip_at_a_constant_height_pushes_with_this_force_at_most(radius_nm: float, most_nn: float) -> None:
    way = line(-3.0 * (radius_nm + 10e0) * 1e-9, 0.0, step=0.02e-9)
    stiff = SPRING._replace(lateral_n_per_m=1e6)
    for hold_nn, yields in ((0.995 * most_nn, True), (1.005 * most_nn, False)):
        fixed = np.array([[radius_nm * 1e-9, hold_nn * 1e-9, hold_nn * 1e-9, 1e-9]])
        moving, _ = pushed(fixed, np.array([[0.0, 0.0, 1.0]]), way, (0.0, 0.0), stiff)
        assert bool(moving[0, push.X] != 0.0) is yields


@pytest.mark.parametrize(("phi_deg", "lost_d"), [(1, 4.7413), (5, 3.1313), (20, 1.7354), (45, 0.8814)])
def test_a_straight_push_is_lost_after_this_way(phi_deg: float, lost_d: float) -> None:
    d, phi = reach("latex_250"), math.radians(phi_deg)
    rigid = SPRING._replace(lateral_n_per_m=1e5)
    fixed, moving = rows("latex_250", [(d * math.cos(phi), d * math.sin(phi))])
    step = 1e-9
    after, seen = pushed(fixed, moving, line(0.0, 5.5 * d, step=step), spring=rigid)
    lost = (max(i for i, c in enumerate(seen) if c.moved) + 1) * step
    assert lost / d == pytest.approx(lost_d, rel=5e-3)
    along, across = (after - moving)[0, :2] / d
    assert along == pytest.approx(math.log(1.0 / math.tan(phi / 2)) - math.cos(phi), rel=1e-2)
    assert across == pytest.approx(1.0 - math.sin(phi), rel=1e-2)


def test_the_force_turns_as_tanh_and_sech_while_the_particle_slips_aside() -> None:
    d, phi = reach("latex_250"), math.radians(5)
    fixed, moving = rows("latex_250", [(d * math.cos(phi), d * math.sin(phi))])
    rigid = SPRING._replace(lateral_n_per_m=1e5)
    _, seen = pushed(fixed, moving, line(0.0, 3.0 * d, step=d / 1000), spring=rigid)
    for s, force in ((1, (0.9722, 0.2341)), (2, (0.8115, 0.5844)), (3, (0.1306, 0.9914))):
        contact = seen[1000 * s - 1]
        measured = (-contact.push_x_n / fixed[0, push.KINETIC], -contact.push_y_n / fixed[0, push.KINETIC])
        assert measured == pytest.approx(force, rel=1e-2, abs=2e-3)


@pytest.mark.parametrize(
    ("beta_deg", "force", "first_deg", "second"),
    [(0, 2.0, 0.0, 1.0), (20, 1.8794, -20.0, 0.8152), (40, 1.5321, -40.0, 0.2267), (60, 1.1547, -30.0, 0.0)],
)
def test_two_equal_spheres_give_way_with_the_least_dissipation(
    beta_deg: float, force: float, first_deg: float, second: float
) -> None:
    beta = math.radians(beta_deg)
    pairs = np.array([[0, 1, math.cos(beta), math.sin(beta), 0.0]])
    moved, reaction = np.zeros((2, 2)), np.zeros(1)
    give_way(np.ones(2), pairs, np.array([[0, 1.0, 0.0, 0.02]]), moved, reaction)
    assert reaction[0] == pytest.approx(force, rel=1e-3)
    assert math.degrees(math.atan2(moved[0, 1], moved[0, 0])) == pytest.approx(first_deg, abs=0.1)
    assert math.hypot(*moved[1]) / 0.02 == pytest.approx(second, abs=2e-3)
    # the tip has to overcome that force among particles as well
    fixed, moving = rows("latex_250", [(0.0, 0.0), (500e-9 * math.cos(beta), 500e-9 * math.sin(beta))])
    d = reach("latex_250")
    _, seen = pushed(fixed, moving, line(-d - 5e-9, -d + 6e-9, step=0.5e-9))
    first = next(c for c in seen if c.moved)
    assert -first.push_x_n / fixed[0, push.KINETIC] == pytest.approx(force, rel=5e-3)


@pytest.mark.parametrize(("way_nm", "spread_nm", "held"), [(1000, 20, 0.9028), (1300, 20, 0.5009), (800, 50, 0.7704)])
def test_so_many_pushes_are_held_that_begin_beside_the_line(way_nm: float, spread_nm: float, held: float) -> None:
    d, count = reach("latex_250"), 2000
    rigid = SPRING._replace(lateral_n_per_m=1e5)
    beside = np.random.Generator(np.random.PCG64(5)).normal(0.0, spread_nm * 1e-9, count)
    kept = 0
    for b in beside.tolist():
        fixed, moving = rows("latex_250", [(math.sqrt(d * d - b * b), b)])
        moving, seen = pushed(fixed, moving, [(0.0, 0.0), (way_nm * 1e-9, 0.0)], spring=rigid)
        kept += seen[-1].moved > 0 and abs(moving[0, push.Y]) < d and seen[-1].touched > 0
    assert kept / count == pytest.approx(held, abs=3.0 * math.sqrt(held * (1.0 - held) / count))


@pytest.mark.parametrize("kind", ["latex_250", "gold_50"])
@pytest.mark.parametrize(("apart", "along"), [(0.1, 0.03126), (0.5, 0.45093)])
def test_a_raster_moves_a_particle_across_its_lines(kind: str, apart: float, along: float) -> None:
    d = reach(kind)
    rigid = SPRING._replace(lateral_n_per_m=1e6)
    fixed, moving = rows(kind, [(0.0, 0.0)])
    y, before = -(1.0 - apart) * d - apart * d, moving
    for _ in range(6):
        y += apart * d
        before = moving
        start = moving[0, push.X] - 2.0 * d
        way = line(start, moving[0, push.X] + 3.0 * d, y, step=2e-3 * d)
        moving, _ = pushed(fixed, moving, way, spring=rigid)
    assert (moving - before)[0, :2] / d == pytest.approx((along, apart), rel=2e-2)


def test_a_start_beside_the_line_grows_as_the_closed_form_says() -> None:
    """tan(phi / 2) grows by e^(s / d): 5 nm beside the line are 22.370 nm after 500 nm."""
    d = reach("latex_250")
    fixed, moving = rows("latex_250", [(math.sqrt(d * d - 25e-18), 5e-9)])
    rigid = SPRING._replace(lateral_n_per_m=1e6)
    # 1 nm a tick, as an instrument goes by hand and by script
    moving, _ = pushed(fixed, moving, line(0.0, 500e-9, step=1e-9), spring=rigid)
    phi = 2.0 * math.atan(math.tan(0.5 * math.asin(5e-9 / d)) * math.exp(500e-9 / d))
    assert d * math.sin(phi) * 1e9 == pytest.approx(22.370, rel=1e-4)
    assert moving[0, push.Y] * 1e9 == pytest.approx(22.370, rel=1e-2)


def test_twelve_lines_of_a_raster_move_a_sphere_of_gold_as_stated() -> None:
    d = reach("gold_50")
    rigid = SPRING._replace(lateral_n_per_m=1e6)
    fixed, moving = rows("gold_50", [(0.0, 0.0)])
    for number in range(12):
        y = (0.25 * number - 0.9) * d
        moving, _ = pushed(fixed, moving, line(-3.0 * d, 6.0 * d, y, step=2e-3 * d), spring=rigid)
    assert moving[0, :2] * 1e9 == pytest.approx([109.58, 207.58], rel=1e-2)


def test_half_the_small_steps_change_the_way_to_the_loss_by_less_than_half_a_per_cent() -> None:
    d, phi = reach("latex_250"), math.radians(5)
    fixed, moving = rows("latex_250", [(d * math.cos(phi), d * math.sin(phi))])
    rigid = SPRING._replace(lateral_n_per_m=1e6)
    lost = []
    # as it divides a way by itself, and half of that
    for step in (push.LARGEST_STEP, 0.5 * push.LARGEST_STEP):
        after, _ = pushed(fixed, moving, line(0.0, 5.0 * d, step=step * d), spring=rigid)
        # a particle that has slipped off lies d beside the line, where it began to slip along it
        lost.append(after[0, push.X] + d * math.cos(phi))
    assert lost[0] == pytest.approx(lost[1], rel=5e-3)


def test_the_stage_goes_ahead_before_a_particle_yields_and_jumps_when_it_does() -> None:
    fixed, moving = rows("latex_250", [(0.0, 0.0)])
    d = reach("latex_250")
    moving, seen = pushed(fixed, moving, line(-d - 1e-9, -d + 500e-9, step=0.005e-9))
    force = -np.array([c.push_x_n for c in seen])
    first = next(i for i, c in enumerate(seen) if c.moved)
    touched = next(i for i, c in enumerate(seen) if c.touched)
    assert (first - touched) * 0.005 == pytest.approx(0.2151, abs=0.011)
    assert force.max() * 1e9 == pytest.approx(21.505, rel=0.03)
    assert force[first] * 1e9 == pytest.approx(0.5 * 21.505, rel=1e-3)
    # when it yields it jumps by what the spring lets go
    after, _ = push_step(TIP, SPRING, *rows("latex_250", [(0.0, 0.0)]), (-d, 0.0, 0.2151e-9 - d, 0.0), PRESSED, 1e-3)
    assert after[0, push.X] * 1e9 == pytest.approx(0.1075, rel=1e-2)
    work = float(np.sum(force) * 0.005e-9)
    assert work == pytest.approx(5.376e-15, rel=1e-2)


def test_an_untouched_particle_never_moves_and_none_overlaps_another() -> None:
    random = np.random.Generator(np.random.PCG64(3))
    places = [(float(x), float(y)) for x, y in random.uniform(-2.5e-6, 2.5e-6, (400, 2))]
    kept: list[tuple[float, float]] = []
    for place in places:
        if len(kept) < 30 and all(math.dist(place, other) > 500e-9 for other in kept):
            kept.append(place)
    fixed, moving = rows("latex_250", kept)
    start = moving
    for y in np.linspace(-2e-6, 2e-6, 9).tolist():
        before = moving
        moving, _ = pushed(fixed, moving, line(-3e-6, 3e-6, y, step=6e-9))
        far = np.abs(before[:, push.Y] - y) > 4.0 * 333e-9 + 500e-9
        still = far & (np.hypot(*(moving - before)[:, :2].T) > 0.0)
        chained = np.array(
            [np.min(np.hypot(*(moving[:, :2] - moving[i, :2]).T)[np.arange(len(kept)) != i]) for i in range(len(kept))]
        )
        assert not np.any(still & (chained > 700e-9))
        between = np.hypot(moving[:, None, 0] - moving[None, :, 0], moving[:, None, 1] - moving[None, :, 1])
        np.fill_diagonal(between, 1.0)
        assert between.min() >= 2 * 250e-9 - 0.01 * 250e-9
    assert np.any(moving[:, :2] != start[:, :2])


def test_a_scene_that_is_turned_gives_the_answer_turned() -> None:
    fixed, moving = rows("latex_250", [(0.0, 30e-9), (480e-9, 190e-9)])
    after, _ = pushed(fixed, moving, line(-400e-9, 100e-9, step=4e-9))
    for degrees in (37.0, 90.0, 181.0):
        c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
        turn = np.array([[c, -s], [s, c]])
        turned = np.column_stack([moving[:, :2] @ turn.T, moving[:, 2]])
        way = [(c * x - s * y, s * x + c * y) for x, y in line(-400e-9, 100e-9, step=4e-9)]
        result, _ = pushed(fixed, turned, way)
        assert result[:, :2] == pytest.approx(after[:, :2] @ turn.T, abs=1e-13)


def test_plain_and_compiled_steps_give_the_same_bits() -> None:
    fixed, moving = rows("latex_250", [(0.0, 30e-9), (480e-9, 190e-9), (5e-6, 0.0)])
    compiled: Any = push_step
    plain: Any = getattr(push_step, "py_func", push_step)
    other = moving
    for (x0, y0), (x1, y1) in pairwise(line(-400e-9, 300e-9, step=10e-9)):
        moving, contact = plain(TIP, SPRING, fixed, moving, (x0, y0, x1, y1), PRESSED, 1e-3)
        other, seen = compiled(TIP, SPRING, fixed, other, (x0, y0, x1, y1), PRESSED, 1e-3)
        assert moving.tobytes() == other.tobytes()
        assert tuple(contact) == tuple(seen)
