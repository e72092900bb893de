"""Scripted agents for `telenano/Push-v0`, which use the observations alone, and the evaluation of their success."""

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from telenano.analysis import wilson
from telenano_lab.assembly import steered
from telenano_lab.learning import engine
from telenano_lab.learning.push_env import PushVectorEnv

Action = tuple[float, float, float]
# A policy maps the observation of an episode, the believed place and the goal to an action.
Policy = Callable[[Sequence[float], Sequence[float], Sequence[float]], Action]

# Distance that the tip moves in a step at full speed, in d.
_STEP = engine.SPEED_M_PER_S * engine.CONTROL_S / engine.D_M
# Lengths are in units of d, and forces in units of the usual friction.
_HIGH = engine.HIGH_M / engine.D_M
_LOW = engine.LOW_M / engine.D_M
# A larger force is a contact with a particle.
_TOUCHED = 0.15
# The tip moves behind the particle by this distance.
_BEHIND = 1.3
# A particle this near to its goal has arrived.
_NEAR = 0.02
# A particle further aside than this would be passed before it reaches its goal.
_MOST_ASIDE = math.radians(70.0)
_STANDS: Action = (0.0, 0.0, -1.0)


def steered_push(observation: Sequence[float], believed: Sequence[float], goal: Sequence[float]) -> Action:
    """Move behind the particle, lower the tip, and push the particle so that it turns towards the goal."""
    return _pushed(observation, believed, goal, steers=True)


def straight_push(observation: Sequence[float], believed: Sequence[float], goal: Sequence[float]) -> Action:
    """Move behind the particle, lower the tip, and push along the line to the goal."""
    return _pushed(observation, believed, goal, steers=False)


def _pushed(observation: Sequence[float], believed: Sequence[float], goal: Sequence[float], *, steers: bool) -> Action:
    x, y, z, _, force_x, force_y = observation[:6]
    to_x, to_y = goal[0] - believed[0], goal[1] - believed[1]
    left = math.sqrt(to_x * to_x + to_y * to_y)
    if left <= _NEAR:
        return _STANDS
    along_x, along_y = to_x / left, to_y / left
    from_x, from_y = believed[0] - x, believed[1] - y
    ahead, aside = from_x * along_x + from_y * along_y, from_x * along_y - from_y * along_x
    size = math.sqrt(force_x * force_x + force_y * force_y)
    if z < 0.5 * _HIGH and size > _TOUCHED:
        ahead_x, ahead_y = -force_x / size, -force_y / size
        if ahead_x * along_x + ahead_y * along_y > math.cos(_MOST_ASIDE):
            heading = steered(ahead_x, ahead_y, to_x, to_y) if steers else (along_x, along_y)
            speed = min(0.5 * left / _STEP, 1.0)
            return speed * heading[0], speed * heading[1], -1.0
    if 0.5 < ahead < 1.6 and abs(aside) < 0.25:
        # Behind the particle: lower the tip and move on.
        speed = 1.0 if z < _LOW + 0.05 else 0.0
        length = math.sqrt(from_x * from_x + from_y * from_y)
        return speed * from_x / length, speed * from_y / length, -1.0
    return _over(x, y, z, believed[0] - _BEHIND * along_x, believed[1] - _BEHIND * along_y)


def _over(x: float, y: float, z: float, to_x: float, to_y: float) -> Action:
    """Move to a place with the tip retracted."""
    if z < 0.95 * _HIGH:
        return 0.0, 0.0, 1.0
    way_x, way_y = to_x - x, to_y - y
    way = math.sqrt(way_x * way_x + way_y * way_y)
    speed = min(way / _STEP, 1.0) / max(way, 1e-9)
    return speed * way_x, speed * way_y, 1.0


class RandomPolicy:
    """Actions drawn at random."""

    def __init__(self, seed: int = 0) -> None:
        self._random = np.random.Generator(np.random.PCG64(seed))

    def __call__(self, observation: Sequence[float], believed: Sequence[float], goal: Sequence[float]) -> Action:
        x, y, lift = self._random.uniform(-1.0, 1.0, 3).tolist()
        return x, y, lift


class Evaluation(NamedTuple):
    """The results of episodes: their number, the successes with their interval of 95 %, and further figures.

    time_s: median simulated time of the successes [s], None without any; losses: mean per episode; error_m: median true
    distance of the particles from their goals at the end [m].
    """

    episodes: int
    successes: int
    low: float
    high: float
    time_s: float | None
    losses: float
    error_m: float


def evaluate(policy: Policy, seeds: Sequence[int], **options: Any) -> Evaluation:
    """Return the results of a policy in one episode per seed; options are those of `PushEnv`."""
    env = PushVectorEnv(len(seeds), **options)
    seen, _ = env.reset(seed=list(seeds))
    count, open_ = len(seeds), np.ones(len(seeds), np.bool_)
    times, errors = np.zeros(count), np.zeros(count)
    succeeded, losses = np.zeros(count, np.bool_), np.zeros(count)
    step = 0
    while open_.any():
        seen, _, terminated, truncated, info = env.step(_actions(policy, seen, open_))
        step += 1
        ends = open_ & (terminated | truncated)
        succeeded[ends] = info["is_success"][ends]
        errors[ends], losses[ends], times[ends] = (
            info["true_error_m"][ends],
            info["losses"][ends],
            step * engine.CONTROL_S,
        )
        open_ &= ~ends
    low, high = wilson(int(succeeded.sum()), count)
    time_s = float(np.median(times[succeeded])) if succeeded.any() else None
    return Evaluation(count, int(succeeded.sum()), low, high, time_s, float(losses.mean()), float(np.median(errors)))


def _actions(
    policy: Policy, seen: dict[str, npt.NDArray[np.float32]], wanted: npt.NDArray[np.bool_]
) -> npt.NDArray[np.float32]:
    rows = zip(*(seen[key].tolist() for key in ("observation", "achieved_goal", "desired_goal")), strict=True)
    stands = (0.0, 0.0, 1.0)
    return np.array([policy(*row) if one else stands for row, one in zip(rows, wanted, strict=True)], np.float32)
