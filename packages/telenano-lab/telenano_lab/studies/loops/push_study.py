"""Placing of a particle by a delayed hand: trials in lockstep over links, under each law for the normal direction.

A trial has a particle 1 um from its goal, a link, and a hand (`telenano_lab.assembly.push_hand`) with a reaction time.
The hand presses with a constant force through the law under study, as in every study, and steers the tip over the
sample by rate: the rate is sent with the forward signals of the law, and place and lateral force return with the
answers. If a signal is lost, the last rate continues to count, up to the deadline of the loop.
"""

import functools
import hashlib
import math
import statistics
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from pydantic import Field

from telenano.analysis import wilson
from telenano.lockstep import Rig, Schedule
from telenano.sections import LAWS, AfmConfig, ControllerConfig, HapticConfig
from telenano.settings import Settings, validate
from telenano.wire import ConfigError, known_names
from telenano_lab.assembly import bench, carried_out, new_hand, push_of
from telenano_lab.studies.loops.cells import sources
from telenano_lab.studies.loops.links import symmetric_link
from telenano_lab.studies.loops.sweep import Kind

# A particle is placed if it is within this distance of its goal.
PLACED_M = 50e-9
WAY_M = 1e-6
# Eq. 14 with steps of 10 nm at 30 Hz.
SPEED_M_PER_S = 300e-9
REACTION_S = 0.2
PRESSES_N = 1.2
# A trial ends after at most this time [s].
_LONGEST_S = 40.0
# The time from the start until the hand steers, when the tip has touched the sample [s].
_TOUCHED_S = 1.0

# At the hand this cantilever has 1500 N/m, for which the paper's loop tolerates 95 ms.
_STIFFNESS_N_PER_M = 10.0


class Trial(Settings):
    """One push over one link."""

    law: str = Field(description="Name of the law in the normal direction")
    round_trip_ms: float = Field(ge=0.0, le=1e4, description="Round trip of the link [ms], half of it each way")
    loss: float = Field(0.0, ge=0.0, lt=1.0, description="Share of messages lost each way")
    seed: int = Field(0, ge=0, description="Seed of places, errors and losses")
    reaction_s: float = Field(REACTION_S, ge=1e-3, le=2.0, description="Reaction time of the hand [s]")
    speed_m_per_s: float = Field(SPEED_M_PER_S, gt=0.0, le=1e-5, description="Greatest speed of the tip [m/s]")

    @property
    def key(self) -> str:
        """A digest of the trial and of all sources on which its outcome depends."""
        return hashlib.sha256((self.model_dump_json() + sources()).encode()).hexdigest()[:24]


class Outcome(NamedTuple):
    """The outcome of a trial.

    error_m: the true distance of the particle from its goal at the end [m]. done: whether the hand accepted the place.
    time_s: the time from the touch to that [s], the longest time of a trial if it was not done. losses: how often the
    particle was lost. peak_n, press_n: the greatest forces across the tip and along it [N].
    """

    cell: Trial
    error_m: float
    done: bool
    time_s: float
    losses: int
    peak_n: float
    press_n: float

    @property
    def placed(self) -> bool:
        return self.done and self.error_m <= PLACED_M

    def as_dict(self) -> dict[str, Any]:
        """Return the outcome as plain data; `read` is the inverse."""
        return {**self._asdict(), "cell": self.cell.model_dump(mode="json")}


def read(data: dict[str, Any]) -> Outcome:
    """Return an outcome from plain data."""
    return Outcome(**{**data, "cell": Trial(**data["cell"])})


def check(trial: Trial) -> None:
    """Raise ConfigError for an unknown law."""
    if trial.law not in LAWS:
        raise ConfigError(f"--law: unknown law {trial.law!r}, {known_names(trial.law, LAWS)}")


@functools.lru_cache(maxsize=1)
def _instrument() -> AfmConfig:
    section = bench({"places": [[0.0, 0.0]]}, _STIFFNESS_N_PER_M)
    return validate(AfmConfig, section, "the instrument", "afm_node")


@functools.lru_cache(maxsize=8)
def _rig(law: str) -> Rig:
    points = [{"time_s": 0.2, "force_n": 0.0}, {"time_s": 0.6, "force_n": PRESSES_N}]
    haptic = validate(HapticConfig, {"operator": {"kind": "force_profile", "points": points}}, "the hand")
    controller = validate(ControllerConfig, {"law": law}, "--law", "controller")
    return Rig.of(controller, haptic, _instrument().to_lockstep_params("the instrument", 0.0))


@functools.lru_cache(maxsize=4)
def _schedule(round_trip_s: float, loss: float, seed: int, ticks: int, period_s: float) -> Schedule:
    """Return the arrivals over a link; cached, because the laws are tried over the same one."""
    return Schedule.of(symmetric_link(round_trip_s, 0.0, loss, seed), ticks, period_s)


def run(trial: Trial, longest_s: float = _LONGEST_S) -> Outcome:
    """Run a trial, which ends at most longest_s [s] after the touch."""
    rig, random = _rig(trial.law), np.random.Generator(np.random.PCG64(trial.seed))
    plant, period_s = rig.instrument.plant, rig.period_s
    round_trip_s = 1e-3 * trial.round_trip_ms
    push = push_of(plant, (0.0, 0.0), trial.speed_m_per_s, trial.reaction_s, round_trip_s, 0.6 * PLACED_M)
    bearing, heading = random.uniform(-math.pi, math.pi, 2).tolist()
    place = 2.5 * push.d_m * np.array([math.cos(bearing), math.sin(bearing)])
    goal = place + WAY_M * np.array([math.cos(heading), math.sin(heading)])
    rig = rig.over(plant._replace(start=np.array([[*place.tolist(), 1.0]])))
    settle = math.ceil(_instrument().time_to_place_s(round_trip_s) / period_s)
    begins = round((_TOUCHED_S + 2.0 * round_trip_s) / period_s)
    ticks = settle + begins + round(longest_s / period_s)
    schedule = _schedule(round_trip_s, trial.loss, trial.seed if trial.loss else 0, ticks, period_s)
    push = push._replace(goal_m=(float(goal[0]), float(goal[1])), place_m=(float(place[0]), float(place[1])))
    hand = new_hand(push, random, begins, period_s)
    rig.run(schedule, settle, hand)
    carried = carried_out(hand)
    return Outcome(
        trial,
        error_m=float(np.sqrt(np.sum((carried.place_m - goal) ** 2))),
        done=carried.done,
        time_s=float((carried.done_tick - begins) * period_s) if carried.done else longest_s,
        losses=carried.losses,
        peak_n=carried.peak_n,
        press_n=carried.press_n,
    )


PUSHES = Kind(check, run, read)


class Row(NamedTuple):
    """All trials of a law over a link: the number placed, its share's interval of 95 %, and medians of the rest."""

    law: str
    round_trip_ms: float
    loss: float
    trials: int
    placed: int
    low: float
    high: float
    time_s: float | None
    error_nm: float
    losses: float
    peak_nn: float
    press_nn: float


def trials_of(laws: Sequence[str], round_trips_ms: Sequence[float], losses: Sequence[float], seeds: int) -> list[Trial]:
    """Return all trials; those over one link follow one another, because drawing a random link is slow."""
    return [
        Trial(law=law, round_trip_ms=trip_ms, loss=loss, seed=seed)
        for trip_ms in round_trips_ms
        for loss in losses
        for seed in range(seeds)
        for law in laws
    ]


def rows_of(outcomes: Sequence[Outcome]) -> list[Row]:
    """Return a row for each law and link."""
    groups: dict[tuple[str, float, float], list[Outcome]] = {}
    for one in outcomes:
        groups.setdefault((one.cell.law, one.cell.round_trip_ms, one.cell.loss), []).append(one)
    order = sorted(groups, key=lambda key: (key[0], key[2], key[1]))
    return [_row(*key, groups[key]) for key in order]


def _row(law: str, round_trip_ms: float, loss: float, group: Sequence[Outcome]) -> Row:
    placed = [one for one in group if one.placed]
    low, high = wilson(len(placed), len(group))
    return Row(
        law,
        round_trip_ms,
        loss,
        len(group),
        len(placed),
        low,
        high,
        statistics.median(one.time_s for one in placed) if placed else None,
        1e9 * statistics.median(one.error_m for one in group),
        statistics.fmean(one.losses for one in group),
        1e9 * statistics.median(one.peak_n for one in group),
        1e9 * statistics.median(one.press_n for one in group),
    )
