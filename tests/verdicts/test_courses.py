"""The labelled courses have the distribution that is stated, and their samples do what their truth says."""

import ast
import hashlib
import json
import math
import os
import subprocess
import sys
from collections import Counter
from pathlib import Path

import distribution as d
import numpy as np
import plans
import pytest
from courses import Course, course
from nonlinear import MAKERS, nonlinear_course

HERE = Path(__file__).parent
SOURCES = ("distribution.py", "nonlinear_distribution.py", "plans.py", "courses.py", "nonlinear.py")
# sha256 of distribution.py as it was first committed
FROZEN = "bde515e13770fefb73cc78a2ebf2b0eb423b8d29d599e8168cbcc946bb3e4ab5"
LIBRARY_ORDERED = {"sum", "mean", "std", "var", "dot", "matmul", "inner", "vdot", "einsum", "convolve", "linalg", "fft"}
DISTURBED = {
    "drift",
    "tremor",
    "random_link",
    "friction",
    "several_modes",
    "lifts_off",
    "overload",
    "two_holds",
    "blow",
}


@pytest.fixture(scope="module")
def corpus() -> list[plans.Plan]:
    return [plans.plan(seed) for seed in range(d.COURSES)]


def longest(plan: plans.Plan) -> tuple[float, float, plans.Run]:
    start_s, end_s, run = max(plans.stretches(plan), key=lambda stretch: stretch[1] - stretch[0])
    return start_s, end_s, plan.runs[run]


def off_rest(plan: plans.Plan, recorded: Course, start_s: float, end_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Return times and distances of the force from its rest within an interval."""
    first, last = np.searchsorted(recorded.time_s, [start_s, end_s])
    rest_n = plan.rest_ratio * plan.hand_force_n + plan.rest_offset_n
    return recorded.time_s[first:last], recorded.tip_force_n[first:last] - rest_n


def misfit(values: list[float], interval: d.Range) -> float:
    """Return the largest distance between the distribution of values and the one stated, over the 0.1 % level."""
    scale = math.log if interval.logarithmic else float
    low, high = scale(interval.low), scale(interval.high)
    parts = sorted((scale(value) - low) / (high - low) for value in values)
    count = len(parts)
    distance = max(max(part - index / count, (index + 1) / count - part) for index, part in enumerate(parts))
    return distance / (1.95 / math.sqrt(count))


def test_the_distribution_is_the_one_that_was_committed_before_the_judge_changed() -> None:
    assert hashlib.sha256((HERE / "distribution.py").read_bytes()).hexdigest() == FROZEN


@pytest.mark.parametrize("name", SOURCES)
def test_nothing_of_the_project_is_imported(name: str) -> None:
    own = {Path(source).stem for source in SOURCES}
    for node in ast.walk(ast.parse((HERE / name).read_text())):
        names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
        if isinstance(node, ast.ImportFrom):
            assert node.level == 0
            names = [node.module or ""]
        for imported in names:
            assert imported.split(".")[0] in own | {"numpy"} | set(sys.stdlib_module_names), f"{name}: {imported}"


@pytest.mark.parametrize("name", ["plans.py", "courses.py", "nonlinear.py"])
def test_no_sum_is_left_to_a_library_and_its_order(name: str) -> None:
    for node in ast.walk(ast.parse((HERE / name).read_text())):
        assert not isinstance(node, ast.MatMult)
        assert not (isinstance(node, ast.Attribute) and node.attr in LIBRARY_ORDERED), ast.dump(node)


def test_a_seed_is_one_course() -> None:
    for seed in range(30):
        for one, other in zip(course(seed), course(seed), strict=True):
            same = np.array_equal(one, np.asarray(other)) if isinstance(one, np.ndarray) else one == other
            assert same, seed
    assert not np.array_equal(course(0).tip_force_n[:20], course(1).tip_force_n[:20])


def test_another_processor_makes_the_same_courses() -> None:
    """Without the wide registers of this processor: the same plans, and samples that differ in their last bits only."""
    kinds = "X86_V3 X86_V4 AVX512_ICL AVX512_SPR"
    made = (
        "import json; from courses import course; made = map(course, range(12));"
        "print(json.dumps([(one.truth, one.cell, one.tip_force_n.tolist()) for one in made]))"
    )
    environment = {**os.environ, "NPY_DISABLE_CPU_FEATURES": kinds, "PYTHONPATH": str(HERE)}
    printed = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", made], env=environment, capture_output=True, text=True, check=True
    )
    for seed, (truth, cell, forces) in enumerate(json.loads(printed.stdout)):
        here = course(seed)
        assert (truth, cell) == (here.truth, here.cell)
        if "quantised" not in here.tags:  # a value between two steps may be rounded to either
            np.testing.assert_allclose(forces, here.tip_force_n, rtol=1e-9, atol=1e-12, err_msg=str(seed))


def test_a_negative_seed_is_refused() -> None:
    with pytest.raises(ValueError, match="zero or more, and not -1"):
        course(-1)


def test_the_ranges_are_filled_as_stated(corpus: list[plans.Plan]) -> None:
    poles = [plan.modes[0] for plan in corpus]
    arrived = [plan for plan in corpus if plan.arrival_s is not None]
    drawn = {
        "rate": ([abs(pole.rate_per_s) for pole in poles if pole.rate_per_s], d.RATE),
        "growth": ([pole.rate_per_s for pole in poles if pole.rate_per_s > 0.0], d.RATE),
        "decay": ([-pole.rate_per_s for pole in poles if pole.rate_per_s < 0.0], d.RATE),
        "frequency": ([pole.frequency_hz for pole in poles if pole.frequency_hz], d.FREQUENCY),
        "hold": ([plan.holds[-1].end_s - plan.holds[-1].start_s for plan in corpus], d.HOLD),
        "force": ([plan.hand_force_n for plan in corpus], d.HAND_FORCE),
        "noise": ([plan.noise_n / plan.hand_force_n for plan in corpus if plan.noise != "none"], d.NOISE),
        "arrival": (
            [
                (plan.arrival_s - plan.holds[0].start_s) / (plan.holds[0].end_s - plan.holds[0].start_s)
                for plan in arrived
                if plan.arrival_s is not None
            ],
            d.ARRIVAL,
        ),
    }
    assert {name: misfit(*values) for name, values in drawn.items() if misfit(*values) > 1.0} == {}


def test_the_misfit_sees_another_distribution(corpus: list[plans.Plan]) -> None:
    holds = [plan.holds[-1].end_s - plan.holds[-1].start_s for plan in corpus]
    assert misfit(holds, d.HOLD._replace(logarithmic=False)) > 1.0


def test_the_shares_are_as_stated(corpus: list[plans.Plan]) -> None:
    counts = Counter(tag for plan in corpus for tag in plan.tags)
    stated = {share.value: share.probability for share in (*d.MOTIONS, *d.NOISE_KINDS) if share.value != "none"}
    stated |= {
        "two_holds": d.TWO_HOLDS_SHARE,
        "released": d.RELEASED_SHARE,
        "random_link": d.RANDOM_LINK_SHARE,
        "tremor": d.TREMOR_SHARE,
        "drift": d.DRIFT_SHARE,
        "overload": d.OVERLOAD_SHARE,
        "never_arrives": d.NEVER_ARRIVES_SHARE,
        "outage": d.OUTAGE_SHARE * (1.0 - d.NEVER_ARRIVES_SHARE),
        "friction": d.FRICTION_SHARE * d.MOTIONS[0].probability,
        "rest_stated": d.REST_STATED_SHARE,
        "delayed": 1.0 - d.NO_DELAY_SHARE,
    }
    for tag, probability in stated.items():
        deviation = math.sqrt(d.COURSES * probability * (1.0 - probability))
        assert abs(counts[tag] - d.COURSES * probability) < 4.0 * deviation, tag


def test_each_class_of_rate_and_frequency_has_courses_that_settle_and_that_grow(corpus: list[plans.Plan]) -> None:
    known = [plan for plan in corpus if plan.truth != "no_truth"]
    classes = Counter((plan.truth, *plan.cell.split("/")[:2]) for plan in known)
    for frequency in ("real", "low", "middle", "high"):
        for rate in ("slow", "middle", "fast"):
            assert classes["settles", rate, frequency] >= d.LEAST_IN_A_CELL
            assert classes["grows", rate, frequency] >= 1
        assert classes["goes_on", "sustained", frequency] >= (0 if frequency == "real" else d.LEAST_IN_A_CELL)
    in_cells = Counter(plan.cell for plan in known)
    assert sum(count for count in in_cells.values() if count < d.LEAST_IN_A_CELL) < 0.03 * len(known)
    assert {cell.split("/")[2] for cell in in_cells} == {"short", "middle", "long"}


def test_a_course_has_a_truth_or_the_rule_by_which_it_has_none(corpus: list[plans.Plan]) -> None:
    for plan in corpus:
        rules = [tag for tag in plan.tags if tag.startswith("no_truth:")]
        assert len(rules) == (plan.truth == "no_truth"), plan.seed
        assert bool(plan.cell) == (plan.truth != "no_truth")
        rate_per_s = plan.modes[0].rate_per_s
        if plan.truth == "settles":
            assert rate_per_s < 0.0
            assert -rate_per_s * plan.length_s >= d.LEAST_RATE_TIMES_LENGTH
        elif plan.truth == "grows":
            assert rate_per_s > 0.0
            assert rate_per_s * plan.length_s >= d.LEAST_RATE_TIMES_LENGTH
        elif plan.truth == "goes_on":
            assert plan.rate_per_s == 0.0
            assert plan.motion in ("sustained", "bounces", "saturates")


@pytest.mark.parametrize("truth", ["settles", "grows", "goes_on"])
def test_the_samples_have_the_rate_that_is_stated(corpus: list[plans.Plan], truth: str) -> None:
    """One mode alone, without noise, is its amplitude times exp(rate t) times a cosine that comes close to one."""
    tried = 0
    for plan in corpus:
        exact = plan.noise == "none" or not plan.noise_n
        if plan.truth != truth or not exact or plan.tags & DISTURBED or plan.motion in ("bounces", "saturates"):
            continue
        start_s, end_s, run = longest(plan)
        main = plan.modes[0]
        if truth == "grows":  # up to where it leaves the surface or is stopped
            end_s = min(end_s, run.start_s + plans.seconds_to_n(plan, run, 0.9 * plan.rest_ratio * plan.hand_force_n))
        periods = main.frequency_hz * (end_s - start_s)
        if end_s <= start_s or 20.0 * main.frequency_hz > plan.sample_rate_hz or 0.0 < periods < 2.0:
            continue
        time_s, force_n = off_rest(plan, course(plan.seed), start_s, end_s)
        if time_s.size < 20:
            continue
        amplitudes = np.abs(force_n) * np.exp(-main.rate_per_s * (time_s - run.start_s))
        expected_n = abs(main.amplitude_n) * run.scale
        if abs(main.rate_per_s) * (time_s[-1] - run.start_s) > 10.0:
            continue  # the rest is then known less well than the motion
        for part in np.array_split(amplitudes, max(1, int(periods / 2.0))):
            assert part.max() == pytest.approx(expected_n, rel=0.06), plan.seed
        tried += 1
    assert tried >= 3, truth


def test_a_bouncing_tip_leaves_the_surface_in_every_cycle(corpus: list[plans.Plan]) -> None:
    bouncing = [plan for plan in corpus if plan.motion == "bounces" and plan.truth == "goes_on"][:40]
    assert len(bouncing) == 40
    for plan in bouncing:
        recorded = course(plan.seed)
        start_s, end_s, _ = longest(plan)
        first, last = np.searchsorted(recorded.time_s, [start_s, end_s])
        contact = recorded.in_contact[first:last]
        leaves = np.flatnonzero(contact[:-1] & ~contact[1:]).size
        assert abs(leaves - plan.modes[0].frequency_hz * (end_s - start_s)) <= 1.5, plan.seed


def test_a_decay_without_noise_ends_nearer_to_its_rest(corpus: list[plans.Plan]) -> None:
    """Also with several modes, friction and a lift-off: compare the first fifth with the last."""
    tried = 0
    for plan in corpus:
        far = -plan.rate_per_s * plan.length_s > 2.0 and plan.truth == "settles" and plan.noise == "none"
        if not far or plan.tags & {"drift", "tremor", "random_link", "overload", "two_holds"}:
            continue
        start_s, end_s, _ = longest(plan)
        _, force_n = off_rest(plan, course(plan.seed), start_s, end_s)
        fifths = [np.abs(part).max() for part in np.array_split(force_n, 5) if part.size]
        assert fifths[-1] <= 0.75 * fifths[0] + abs(plan.friction_offset_n), plan.seed
        tried += 1
    assert tried >= 30


def test_what_opens_the_loop_is_in_the_flags(corpus: list[plans.Plan]) -> None:
    interrupted = [plan for plan in corpus if plan.openings and "nothing_moves" not in plan.tags][:120]
    withdrawals = 0
    for plan in interrupted:
        recorded = course(plan.seed)
        for start_s, end_s, cause in recorded.interruptions:
            deadline_s = 0.0 if cause == "operator" else d.COMMAND_DEADLINE_S
            until_s = min(end_s, recorded.guard[0] if recorded.guard else math.inf)
            first, last = np.searchsorted(recorded.time_s, [start_s + deadline_s, until_s])
            assert recorded.held[first:last].all()
            assert not recorded.following[first:last].any()
            assert np.ptp(recorded.tip_force_n[first:last]) == 0.0 if plan.noise == "none" and last > first else True
        if plan.withdrawal_s is not None and recorded.guard == (plan.withdrawal_s, "no command for 250 ms"):
            withdrawals += 1
            after = recorded.time_s > plan.withdrawal_s + d.WITHDRAWAL_S
            assert not recorded.in_contact[after].any()
    assert withdrawals >= 10


def test_before_the_arrival_the_tip_is_in_air_and_afterwards_it_strikes(corpus: list[plans.Plan]) -> None:
    struck = [plan for plan in corpus if plan.blows and "nothing_moves" not in plan.tags][:60]
    for plan in struck:
        recorded = course(plan.seed)
        assert plan.arrival_s is not None
        assert not recorded.in_contact[recorded.time_s < plan.arrival_s].any()
        assert plan.blows[0].peak_n > 2.0 * plan.hand_force_n
    assert len(struck) == 60


def test_every_course_is_finite_and_in_order(corpus: list[plans.Plan]) -> None:
    for seed in range(0, d.COURSES, 15):
        recorded = course(seed)
        assert np.isfinite(recorded.tip_force_n).all()
        assert np.isfinite(recorded.hand_force_n).all()
        assert (np.diff(recorded.time_s) > 0.0).all()
        sizes = {value.size for value in recorded if isinstance(value, np.ndarray)}
        assert len(sizes) == 1
        assert recorded.truth == corpus[seed].truth
        assert not (recorded.following & recorded.held).any()


def test_every_kind_of_nonlinear_course_has_each_of_its_truths() -> None:
    drawn = [nonlinear_course(seed) for seed in range(1200)]
    counts = Counter((kind, one.truth) for one in drawn for kind in MAKERS if kind in one.tags)
    for kind in MAKERS:
        fates = {"rests": ["settles"], "saturates": ["goes_on"], "clamped": ["goes_on"]}.get(
            kind, ["goes_on", "settles"]
        )
        assert all(counts[kind, truth] >= 4 for truth in fates), (kind, counts)
    assert sum(one.truth != "no_truth" for one in drawn) > 0.5 * len(drawn)
    for one in drawn:
        assert np.isfinite(one.tip_force_n).all()
        assert (np.diff(one.time_s) > 0.0).all()
        assert len([tag for tag in one.tags if tag.startswith("no_truth:")]) == (one.truth == "no_truth")


@pytest.mark.check("takes 1 s")
def test_what_is_at_rest_stands_still_and_what_goes_on_moves_in_the_last_eighth() -> None:
    """Of courses without noise, creep or air between: from peak to peak, beside the hand's force."""
    tried = Counter[str]()
    for one in map(nonlinear_course, range(1500)):
        start_s, end_s, hand_n = one.planned[-1]
        last = (one.time_s > end_s - 0.02 * (end_s - start_s)) & (one.time_s < end_s)
        part = (one.time_s > end_s - 0.125 * (end_s - start_s)) & (one.time_s < end_s)
        if "none" not in one.tags or not one.in_contact[part].all() or last.sum() < 3:
            continue
        turns = one.frequency_hz * 0.125 * (end_s - start_s)
        if "at_rest" in one.tags:
            assert np.ptp(one.tip_force_n[part]) < 0.06 * hand_n, one.seed
        elif one.truth == "goes_on" and turns > 1.0 and one.tags & {"saturates", "clamped", "one_dies"}:
            assert np.ptp(one.tip_force_n[part]) > 0.03 * hand_n, one.seed
        tried["rest" if "at_rest" in one.tags else one.truth] += 1
    assert tried["rest"] >= 10 and tried["goes_on"] >= 10
