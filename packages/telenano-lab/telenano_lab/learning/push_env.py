"""`telenano/Push-v0`: push a particle to a goal; a single environment, and a vector of them.

Lengths are in units of d, the distance at which tip and particle touch, and forces in units of the kinetic friction.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Literal

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from telenano_lab.learning import engine as e

Array = npt.NDArray[np.float64]
Observation = dict[str, npt.NDArray[np.float32]]

# Bound of the observations; an hour at full speed is only 2e4 d.
_LARGEST = 1e6
# Key of the goal that was achieved a step before.
_BEFORE = "achieved_before"
_ARRIVED = e.TOLERANCE_M / e.D_M

ACTIONS = spaces.Box(-1.0, 1.0, (3,), np.float32)
_SPACE: spaces.Space[Any] = spaces.Dict(
    {
        "observation": spaces.Box(-_LARGEST, _LARGEST, (e.OBSERVED,), np.float32),
        "achieved_goal": spaces.Box(-_LARGEST, _LARGEST, (2,), np.float32),
        "desired_goal": spaces.Box(-_LARGEST, _LARGEST, (2,), np.float32),
    }
)


class _Pushing:
    """The common part of the single and the vector environment."""

    def __init__(self, count: int, obs: str, reward: str, longest_s: float) -> None:
        for name, value, choices in (("obs", obs, ("felt", "state")), ("reward", reward, ("progress", "sparse"))):
            if value not in choices:
                raise ValueError(f"{name}={value!r} must be one of {', '.join(choices)}")
        if not 1.0 <= longest_s <= 3600.0:
            raise ValueError(f"longest_s = {longest_s} must lie between 1 and 3600 s")
        self.is_sparse = reward == "sparse"
        self.episodes = e.Episodes(count, longest_s, truth=obs == "state")

    def rewards(self, achieved: Any, desired: Any, before: Any) -> Any:
        """Return the reward of achieved goals, with the shape of all axes but the last.

        It is 0 within the tolerance, and otherwise -1, plus the progress since `before` in d unless the reward is
        sparse.
        """
        now = _distance(achieved, desired)
        more = 0.0 if self.is_sparse or before is None else _distance(before, desired) - now
        if isinstance(now, float):
            return 0.0 if now <= _ARRIVED else more - 1.0
        return np.where(now <= _ARRIVED, 0.0, more - 1.0)


def _named(observations: npt.NDArray[np.float32]) -> Observation:
    """Return the observations of one episode, or of all, as a dict of their parts."""
    goals = e.OBSERVED + 2
    parts = observations[..., : e.OBSERVED], observations[..., e.OBSERVED : goals], observations[..., goals:]
    return {"observation": parts[0], "achieved_goal": parts[1], "desired_goal": parts[2]}


def _distance(a: Any, b: Any) -> Any:
    """Return the distance of two places, or of each pair in two rows of places."""
    if np.ndim(a) == 1:
        # Python floats are faster than NumPy for a single environment.
        (x, y), (p, q) = a.tolist(), b.tolist()
        return math.sqrt((x - p) * (x - p) + (y - q) * (y - q))
    way = np.asarray(a, np.float64) - np.asarray(b, np.float64)
    return np.asarray(np.sqrt(way[..., 0] * way[..., 0] + way[..., 1] * way[..., 1]))


def _before(info: Any) -> Any:
    """Return the goals achieved a step before, from a dict, or from a sequence of dicts as hindsight replay passes."""
    if isinstance(info, Mapping):
        return info.get(_BEFORE)
    if isinstance(info, Sequence | np.ndarray) and len(info) and all(_BEFORE in one for one in info):
        return np.array([one[_BEFORE] for one in info])
    return None


class PushEnv(gymnasium.Env[Observation, npt.NDArray[np.float32]]):
    """A tip with force feedback pushes a particle to a goal.

    The action is the velocity of the tip in x and y, in units of 2 um/s, and its lift (above 0 it is retracted); a step
    takes 20 ms. An episode ends when the believed place of the particle is within a tenth of its diameter of the goal
    while
    the tip stands. info["is_success"] tells whether the particle really is there; no reward or observation depends on
    it.

    Args:
        obs: felt, the knowledge of an instrument; or state, with the true place of the particle, for debugging.
        reward: progress, -1 per step plus the progress in units of d, 0 within the tolerance; or sparse, -1 or 0.
        longest_s: Simulated time after which an episode is truncated [s].
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": []}  # type: ignore[misc]
    render_mode = None

    def __init__(
        self,
        obs: Literal["felt", "state"] = "felt",
        reward: Literal["progress", "sparse"] = "progress",
        longest_s: float = 30.0,
    ) -> None:
        self.observation_space, self.action_space = _SPACE, ACTIONS
        self._pushing = _Pushing(1, obs, reward, longest_s)
        self._last: Observation = {}

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        super().reset(seed=seed)
        self._pushing.episodes.begin(0, self.np_random)
        return self._observed(), {}

    def step(self, action: npt.NDArray[np.float32]) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        episodes = self._pushing.episodes
        if not self._last or episodes.taken[0] >= episodes.steps:
            raise RuntimeError("the episode is over, or none has begun: call reset()")
        before = self._last["achieved_goal"]
        episodes.step(np.asarray(action, np.float64).reshape(1, 3))
        now, state = self._observed(), episodes.state[0]
        error_m = float(state[e.TRUE_ERROR])
        info = {
            _BEFORE: before,
            "losses": int(state[e.LOSSES]),
            "peak_n": float(state[e.PEAK]),
            "is_success": error_m <= e.TOLERANCE_M,
            "true_error_m": error_m,
        }
        reward = float(self.compute_reward(now["achieved_goal"], now["desired_goal"], info))
        arrived = _distance(now["achieved_goal"], now["desired_goal"]) <= _ARRIVED
        done = bool(arrived and state[e.STANDS] > 0.0)
        return now, reward, done, bool(episodes.taken[0] >= episodes.steps), info

    def compute_reward(self, achieved_goal: Any, desired_goal: Any, info: Any) -> Any:
        """Return the reward of goals [d], shape (..., 2); for a progress reward info must have `achieved_before`."""
        return self._pushing.rewards(achieved_goal, desired_goal, _before(info))

    def _observed(self) -> Observation:
        observations = self._pushing.episodes.observations()[0]
        # The caller may modify the returned arrays.
        self._last = _named(observations.copy())
        return _named(observations)


class PushVectorEnv(VectorEnv[Observation, npt.NDArray[np.float32], npt.NDArray[Any]]):
    """Many environments as one compiled step; row i equals a `PushEnv` whose seed is greater by i.

    An ended episode begins again with the next step, which ignores its action.

    Args:
        num_envs: Number of environments.
        obs: As for `PushEnv`.
        reward: As for `PushEnv`.
        longest_s: As for `PushEnv`.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": [], "autoreset_mode": AutoresetMode.NEXT_STEP}  # type: ignore[misc]

    def __init__(
        self,
        num_envs: int = 1,
        obs: Literal["felt", "state"] = "felt",
        reward: Literal["progress", "sparse"] = "progress",
        longest_s: float = 30.0,
    ) -> None:
        self.num_envs = num_envs
        self.single_observation_space, self.single_action_space = _SPACE, ACTIONS
        self.observation_space, self.action_space = batch_space(_SPACE, num_envs), batch_space(ACTIONS, num_envs)
        self._pushing = _Pushing(num_envs, obs, reward, longest_s)
        self._random = [seeding.np_random(None)[0] for _ in range(num_envs)]
        self._ended = np.zeros(num_envs, np.bool_)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin all episodes; an integer seed is that of the first row, a sequence has one for each."""
        if seed is not None:
            seeds = [seed + row for row in range(self.num_envs)] if isinstance(seed, int) else list(seed)
            self._random = [seeding.np_random(one)[0] for one in seeds]
        for row, random in enumerate(self._random):
            self._pushing.episodes.begin(row, random)
        self._ended[:] = False
        return _named(self._pushing.episodes.observations()), {}

    def step(
        self, actions: npt.NDArray[np.float32]
    ) -> tuple[Observation, npt.NDArray[Any], npt.NDArray[Any], npt.NDArray[Any], dict[str, Any]]:
        pushing, episodes, fresh = self._pushing, self._pushing.episodes, self._ended
        before = _named(episodes.observations())["achieved_goal"]
        # An ended row begins again after the step of the others.
        episodes.taken[fresh] = 0
        episodes.step(np.ascontiguousarray(actions, np.float64))
        for row in np.flatnonzero(fresh).tolist():
            episodes.begin(row, self._random[row])
        now = _named(episodes.observations())
        rewards = pushing.rewards(now["achieved_goal"], now["desired_goal"], before)
        rewards[fresh] = 0.0
        arrived = _distance(now["achieved_goal"], now["desired_goal"]) <= _ARRIVED
        terminated = arrived & (episodes.state[:, e.STANDS] > 0.0) & ~fresh
        truncated = (episodes.taken >= episodes.steps) & ~fresh
        self._ended = terminated | truncated
        error_m = episodes.state[:, e.TRUE_ERROR].copy()
        info = {
            _BEFORE: before,
            "losses": episodes.state[:, e.LOSSES].astype(int),
            "peak_n": episodes.state[:, e.PEAK].copy(),
            "is_success": error_m <= e.TOLERANCE_M,
            "true_error_m": error_m,
        }
        return now, np.asarray(rewards, np.float64), terminated, truncated, info
