"""Drift, and the plan of an assembly: the filter's gains, who goes where, ways round others, order, refusals."""

import math
from itertools import pairwise

import numpy as np
import pytest
from telenano_lab.assembly import drift, plan
from telenano_lab.assembly.patterns import pattern
from telenano_lab.assembly.plan import Task, UnreachableError, assigned, planned, way_around
from telenano_lab.assembly.run import look_sides_m

from telenano.wire import ConfigError

NM = 1e-9
SIX = [(-700, -500), (300, 600), (650, -350), (-200, 150), (-600, 700), (100, -700)]
LINE = [(-500 + 200 * i, 0) for i in range(6)]


def test_the_filter_of_the_drift_is_that_of_kalman() -> None:
    """Compare with the filter in matrices, of which a motion measures the speed times the time."""
    random = np.random.Generator(np.random.PCG64(1))
    density, axis = 1.3889e-6 * NM**2, drift.unknown()
    mean, covariance = np.zeros(2), np.diag([0.0, drift.FASTEST_M_PER_S**2])
    for _ in range(40):
        t, by_m, error_m = float(random.uniform(20.0, 90.0)), float(random.normal(0.0, 5 * NM)), NM
        axis = drift.moved(drift.predicted(axis, t, density), by_m, t, error_m)
        step = np.array([[1.0, t], [0.0, 1.0]])
        noise = density * np.array([[t**3 / 3.0, t**2 / 2.0], [t**2 / 2.0, t]])
        mean, covariance = step @ mean, step @ covariance @ step.T + noise
        seen = np.array([0.0, t])
        gain = covariance @ seen / (seen @ covariance @ seen + error_m**2)
        mean, covariance = mean + gain * (by_m - seen @ mean), covariance - np.outer(gain, seen @ covariance)
        assert (axis.offset_m, axis.speed_m_per_s) == pytest.approx(tuple(mean), rel=1e-9, abs=1e-18)
        found = (axis.offset_variance, axis.covariance, axis.speed_variance)
        assert found == pytest.approx((covariance[0, 0], covariance[0, 1], covariance[1, 1]), rel=1e-9, abs=0.0)


def test_the_filter_finds_a_steady_drift_and_keeps_its_error() -> None:
    random = np.random.Generator(np.random.PCG64(1))
    speed, state = 0.05 * NM, drift.Drift(0.0, drift.unknown(), drift.unknown())
    for look in range(1, 30):
        ahead = drift.drift_at(state, 60.0 * look)
        by_m = random.normal(speed * 60.0, NM)
        moved = drift.moved(ahead.x, by_m, 60.0, NM), drift.moved(ahead.y, 0.0, 60.0, NM)
        state = drift.Drift(ahead.time_s, *moved)
    assert state.x.speed_m_per_s == pytest.approx(speed, abs=3.0 * math.sqrt(state.x.speed_variance))
    assert drift.drift_at(state, state.time_s + 60.0).x.offset_m == pytest.approx(
        speed * 60.0 * 30, abs=5.0 * state.x.error_m
    )


def test_the_least_squared_ways_decide_who_goes_where() -> None:
    targets = assigned(SIX, LINE)
    assert targets == [0, 4, 5, 2, 1, 3]
    ways = sum(math.dist(place, LINE[target]) for place, target in zip(SIX, targets, strict=True))
    assert ways == pytest.approx(3161.160, abs=1e-3)
    assert assigned([(0, 0), (5, 5)], [(4, 4)]) == [-1, 0]


def test_a_way_goes_round_what_stands_in_it() -> None:
    way = way_around((-1000.0, 0.0), (1000.0, 0.0), [(0.0, 10.0)], 300.0)
    assert way is not None and len(way) > 2
    for a, b in pairwise(way):
        for share in np.linspace(0.0, 1.0, 50):
            point = (a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1]))
            assert math.dist(point, (0.0, 10.0)) >= 300.0 * (1.0 - 1e-6)
    assert all(y <= 0.0 for _, y in way)  # the shorter side
    assert Task(0, way, 0).length_m < 2000.0 * 1.06
    assert way_around((0.0, 0.0), (1000.0, 0.0), [(0.0, 800.0)], 300.0) == ((0.0, 0.0), (1000.0, 0.0))
    assert way_around((-1000.0, 0.0), (0.0, 0.0), [(100.0, 0.0)], 300.0) is None


def test_a_particle_waits_until_its_target_is_free() -> None:
    tasks = planned([(0.0, 0.0), (-2000.0, 0.0)], [(0.0, 0.0), (2000.0, 0.0)], 600.0, 10.0, 3000.0)
    # the squared ways are least where both move one place on
    assert [(task.particle, task.target) for task in tasks] == [(0, 1), (1, 0)]


def test_where_two_wait_for_each_other_one_is_parked(monkeypatch: pytest.MonkeyPatch) -> None:
    places = [(0.0, 0.0), (2000.0, 0.0)]
    monkeypatch.setattr(plan, "assigned", lambda *_: [1, 0])
    tasks = planned(places, places, 600.0, 10.0, 3000.0)
    assert [(task.particle, task.target) for task in tasks] == [(0, -1), (1, 0), (0, 1)]
    assert tasks[-1].way[-1] == (2000.0, 0.0)
    assert all(math.dist(tasks[0].way[-1], place) >= 600.0 for place in places)


@pytest.mark.parametrize(
    ("places", "targets", "words"),
    [
        ([(0, 0)], [(0, 0), (900, 0)], "the pattern has 2 places, and 1 particles were found"),
        ([(0, 0), (5000, 0)], [(0, 0), (100, 0)], "targets 0 and 1 are 100 m apart"),
        ([(0, 0), (900, 0)], [(700, 0)], "no free path leads to the targets of particles 0"),
    ],
)
def test_what_cannot_be_planned_is_refused_by_name(
    places: list[tuple[float, float]], targets: list[tuple[float, float]], words: str
) -> None:
    if words.startswith("no free path"):
        ring = [(round(500 * math.cos(a), 3), round(500 * math.sin(a), 3)) for a in np.linspace(0, 2 * math.pi, 7)[:-1]]
        places, targets = [(0.0, 0.0), *ring], [(5000.0, 0.0), *ring]
    with pytest.raises(UnreachableError, match=words):
        planned(places, targets, 600.0 if not words.startswith("no free path") else 490.0, 10.0, 2000.0)


def test_the_plan_of_the_six_reaches_all_targets_without_meeting_another() -> None:
    places = [(4.0 * x, 4.0 * y) for x, y in SIX]
    line = [(-2000.0 + 800.0 * i, 0.0) for i in range(6)]
    at = list(places)
    for task in planned(places, line, 700.0, 10.0, 4000.0):
        others = [place for i, place in enumerate(at) if i != task.particle]
        for a, b in pairwise(task.way):
            assert way_around(a, b, others, 690.0) == (a, b)
        at[task.particle] = task.way[-1]
    assert sorted(at) == sorted(line)


def test_a_way_goes_around_what_is_fixed_and_a_target_beside_it_is_refused() -> None:
    wall = [(0.0, y * 0.25e-6) for y in range(-4, 5)]
    (task,) = planned([(-1.5e-6, 0.0)], [(1.5e-6, 0.0)], 0.6e-6, 25e-9, 3e-6, wall)
    assert min(math.dist(corner, one) for corner in task.way for one in wall) >= 0.6e-6 * (1 - 1e-9)
    assert max(abs(y) for _, y in task.way) > 1.4e-6
    with pytest.raises(UnreachableError, match=r"target 0 is .* m from something fixed on the sample"):
        planned([(-1.5e-6, 0.0)], [(0.3e-6, 0.0)], 0.6e-6, 25e-9, 3e-6, wall)


def test_the_edges_of_a_look_keep_away_from_other_particles() -> None:
    reach = 333e-9
    assert look_sides_m((0.0, 0.0), [(3e-6, 0.0), (0.0, -2e-6)], reach) == pytest.approx((4 * reach, 4 * reach))
    width, depth = look_sides_m((0.0, 0.0), [(-0.8e-6, 0.2e-6), (0.1e-6, 0.9e-6)], reach)
    assert 0.5 * width <= 0.8e-6 - reach and 0.5 * depth <= 0.9e-6 - reach
    # the particle itself is always seen
    assert min(look_sides_m((0.0, 0.0), [(0.55e-6, 0.0), (0.0, 0.55e-6)], reach)) >= 2.0 * reach


def test_letters_are_dots_in_three_columns_and_five_rows() -> None:
    # a T: its bar above, its stem below
    stem = [(0.0, 1.0), (0.0, 0.0), (0.0, -1.0), (0.0, -2.0)]
    assert sorted(pattern("letters", 8, 1.0)) == sorted([(-1.0, 2.0), (0.0, 2.0), (1.0, 2.0), *stem])
    word = pattern("letters:Lo 1", 8, 0.5)
    # four characters, with a column between them
    assert min(x for x, _ in word) == -3.5 and max(x for x, _ in word) == 3.5
    assert min(math.dist(a, b) for i, a in enumerate(word) for b in word[:i]) == 0.5


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("letters:AÄ", "'Ä' is not one of A to Z, 0 to 9 and space"),
        ("letters: ", "has no places"),
        ("lettres", "is not one of line, square, ring, letters:TEXT, and cannot be read as a file"),
    ],
)
def test_a_pattern_that_is_none_says_what_there_is(name: str, words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        pattern(name, 8, 1e-6)
