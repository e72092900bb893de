"""The study of pushes: the scripted hand over a line of delay, the loop that carries its rates, and what is counted."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from telenano_lab.assembly import push_hand
from telenano_lab.assembly.particles.adhered_sphere import KINDS
from telenano_lab.assembly.particles.push import KINETIC, push_step
from telenano_lab.assembly.particles.steering import steered
from telenano_lab.assembly.particles.tip_shape import Spring, tip_shape, touch_distance_m
from telenano_lab.studies import push_command
from telenano_lab.studies.loops import push_study
from telenano_lab.studies.loops.push_study import Outcome, Trial, check, read, rows_of, trials_of
from telenano_lab.studies.loops.sweep import Journal

from telenano.analysis import wilson
from telenano.testing import invoke
from telenano.wire import ConfigError

TIP = tip_shape(10e-9, math.radians(15.0))
SPRING = Spring(1.0, 100.0, 0.0, False, 0.01)
KIND = KINDS["latex_250"]
FIXED = np.array([[KIND.radius_m, 21.505e-9, 10.7526e-9, 58.9e-9]])
D_M = touch_distance_m(TIP, KIND.radius_m, 0.0)


def placed_by(seed: int, delay_ticks: int, **changes: float) -> tuple[float, np.ndarray, int]:
    """Return how far a hand leaves a particle from its goal [m], its state, and how long it took, over plain delays."""
    random = np.random.Generator(np.random.PCG64(seed))
    place, goal = np.array([2.5 * D_M, 0.0]), np.array([2.5 * D_M, 6e-7])
    plan, state = np.zeros(push_hand.PLAN), np.zeros(push_hand.STATE)
    plan[[push_hand.GOAL_X, push_hand.GOAL_Y]], plan[push_hand.D] = goal, D_M
    plan[push_hand.FRICTION], plan[push_hand.SPEED] = FIXED[0, KINETIC], 600e-9
    plan[push_hand.GAIN] = 0.35 / (0.2 + 2e-3 * delay_ticks)
    plan[push_hand.WAITS], plan[push_hand.LEAVES] = 300 + 2 * delay_ticks, 30e-9
    for name, value in ({"FORCE_ERROR": 0.1, "PLACE_ERROR": 5e-9, "TREMOR": 0.15, "HEADING": 0.05} | changes).items():
        plan[getattr(push_hand, name)] = value
    state[[push_hand.BELIEVED_X, push_hand.BELIEVED_Y]] = place + 1e-8
    hand = push_hand.Hand(
        plan=plan,
        state=state,
        seen=np.zeros(4),
        perceived=np.zeros((200, 4)),
        errors=random.standard_normal((512, 6)),
    )
    ways: list[tuple[float, float]] = [(0.0, 0.0)] * (delay_ticks + 1)
    answers = [(0.0, 0.0, 0.0, 0.0)] * (delay_ticks + 1)
    x, y, moving, tick = 0.0, 0.0, np.array([[*place, 1.0]]), 0
    while state[push_hand.PHASE] != push_hand.DONE and tick < 30_000:
        ways.append(push_hand.hand_moves(hand, tick))
        across, up = ways[-1 - delay_ticks]
        to = (x + 1e-3 * across, y + 1e-3 * up)
        moving, met = push_step(TIP, SPRING, FIXED, moving, (x, y, *to), (0.0, -12e-9), 1e-3)
        x, y = to
        answers.append((x, y, met.push_x_n, met.push_y_n))
        hand.seen[:] = answers[-1 - delay_ticks]
        tick += 1
    return math.dist(moving[0, :2], goal), state, tick


@pytest.mark.check("a simulated hand pushes for a minute, twice")
@pytest.mark.drawn(0.0, "packages/telenano-lab/telenano_lab/studies/", "packages/telenano-lab/telenano_lab/assembly/")
def test_a_hand_places_a_particle_and_takes_longer_over_a_delay() -> None:
    near_m, state, soon = placed_by(1, 0)
    far_m, later_state, later = placed_by(1, 50)
    assert state[push_hand.PHASE] == later_state[push_hand.PHASE] == push_hand.DONE
    assert max(near_m, far_m) < 50e-9 and later > soon


def test_a_hand_without_errors_loses_nothing_and_does_not_touch_what_is_in_its_way_there() -> None:
    error_m, state, _ = placed_by(0, 0, FORCE_ERROR=0.0, PLACE_ERROR=0.0, TREMOR=0.0, HEADING=0.0)
    assert error_m < 20e-9 and state[push_hand.LOSSES] == 0.0


def test_the_direction_of_a_steered_tip_turns_the_particle_to_the_goal() -> None:
    for angle in (-2.5, -0.4, 0.0, 0.3, 1.2):
        x, y = steered(1.0, 0.0, math.cos(angle), math.sin(angle))
        # it goes to the other side of the particle, at most 60 degrees
        assert math.atan2(y, x) == pytest.approx(-math.atan(min(max(2.0 * angle, -math.sqrt(3)), math.sqrt(3))))


def outcome(law: str, seed: int, error_nm: float, **more: Any) -> Outcome:
    fields = {"done": True, "time_s": 9.0, "losses": 1, "peak_n": 2e-8, "press_n": 1e-8} | more
    return Outcome(Trial(law=law, round_trip_ms=50.0, seed=seed), error_nm * 1e-9, **fields)


def test_a_row_counts_what_is_within_fifty_nanometres_and_done() -> None:
    found = [outcome("wave", 0, 10), outcome("wave", 1, 49), outcome("wave", 2, 51), outcome("wave", 3, 1, done=False)]
    (row,) = rows_of(found)
    assert (row.trials, row.placed, row.losses, row.time_s) == (4, 2, 1.0, 9.0)
    assert (row.low, row.high) == wilson(2, 4)
    (figure,) = [push_command.push_figure([row])]
    assert len(figure.axes) == 4


def test_the_interval_is_that_of_wilson() -> None:
    assert wilson(0, 10) == pytest.approx((0.0, 0.2775), abs=1e-4)
    assert wilson(95, 100) == pytest.approx((0.8882, 0.9785), abs=1e-4)
    assert wilson(10, 10)[1] == 1.0 and wilson(0, 0) == (0.0, 1.0)


def test_an_outcome_is_kept_in_the_journal_and_read_again(tmp_path: Path) -> None:
    one = outcome("wave", 3, 12.5)
    journal = Journal(tmp_path / "journal.jsonl", push_study.PUSHES)
    journal.record([one])
    again = Journal(tmp_path / "journal.jsonl", push_study.PUSHES)
    assert again.results == {one.cell.key: one} and read(json.loads(json.dumps(one.as_dict()))) == one


def test_the_trials_over_one_link_come_together_and_an_unknown_law_is_refused() -> None:
    trials = trials_of(("wave", "passivity"), (0.0, 50.0), (0.0, 0.2), 3)
    assert len(trials) == 24 and len(set(trials)) == 24
    links = [(trial.round_trip_ms, trial.loss, trial.seed) for trial in trials]
    assert all(links[i] == links[i + 1] for i in range(0, 24, 2))
    with pytest.raises(ConfigError, match="unknown law 'wvae'"):
        check(Trial(law="wvae", round_trip_ms=0.0))


def test_the_command_writes_page_figure_and_tables(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    kind = push_study.PUSHES._replace(run=lambda trial: outcome(trial.law, trial.seed, 20.0 + trial.seed))
    monkeypatch.setattr(push_study, "PUSHES", kind)
    words = ["study", "push", "--law", "wave", "--delay", "50", "--loss", "0", "--quick", "--workers", "1", "--json"]
    done = invoke([*words, "--out", str(tmp_path / "push")])
    assert done.exit_code == 0, done.output
    (row,) = json.loads(done.stdout)["rows"]
    assert row["placed"] == row["trials"] == 12
    names = {path.name for path in (tmp_path / "push").iterdir()}
    assert {"push.html", "push.json", "push.png", "push.parquet", "journal.jsonl"} <= names


@pytest.mark.parametrize("seeds", ["2", "100"])
def test_two_numbers_of_trials_are_refused_before_any_runs(tmp_path: Path, seeds: str) -> None:
    out = tmp_path / "push"
    done = invoke(["study", "push", "--law", "wave", "--quick", "--seeds", seeds, "--workers", "1", "--out", str(out)])
    assert done.exit_code == 2
    assert "--quick" in done.stderr and "--seeds" in done.stderr
    assert not out.exists()
