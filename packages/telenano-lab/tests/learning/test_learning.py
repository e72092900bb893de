"""The environment to learn in: its contract, that it tells no truth, and that one and many give the same."""

import math
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from telenano_lab.learning import PUSH, engine
from telenano_lab.learning.baselines import RandomPolicy, evaluate, steered_push, straight_push
from telenano_lab.learning.push_env import PushEnv, PushVectorEnv


@pytest.fixture(autouse=True)
def plain(monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> None:
    """Take the plain form of the control step, which gives the same bits and need not be compiled."""
    if "compiled_step" not in request.fixturenames:
        for name in ("advance", "_believe", "tell"):
            step = getattr(engine, name)
            monkeypatch.setattr(engine, name, getattr(step, "py_func", step))


@pytest.fixture
def compiled_step() -> None:
    """Leave the control step compiled."""


@pytest.mark.parametrize("obs", ["felt", "state"])
def test_it_keeps_the_contract_of_gymnasium(obs: str) -> None:
    check_env(gymnasium.make(PUSH, obs=obs, longest_s=2.0).unwrapped, skip_render_check=True)


def test_one_and_many_are_made_by_name() -> None:
    env = gymnasium.make(PUSH)
    assert isinstance(env.unwrapped, PushEnv)
    seen, _ = env.reset(seed=1)
    assert set(seen) == {"observation", "achieved_goal", "desired_goal"}
    many = gymnasium.make_vec(PUSH, num_envs=3)
    assert isinstance(many, PushVectorEnv)
    seen, _ = many.reset(seed=1)
    assert seen["observation"].shape == (3, 10) and many.observation_space.contains(seen)


def actions(count: int, seed: int = 0) -> np.ndarray:
    """Return a walk of the tip near the particle, mostly down."""
    random = np.random.Generator(np.random.PCG64(seed))
    return random.uniform([-1.0, -1.0, -1.0], [1.0, 1.0, 0.3], (count, 3)).astype(np.float32)


def test_a_row_of_many_is_one_with_the_next_seed_and_the_next_episode_too() -> None:
    many, ones = PushVectorEnv(3, longest_s=1.0), [PushEnv(longest_s=1.0) for _ in range(3)]
    seen, _ = many.reset(seed=7)
    last = [one.reset(seed=7 + row)[0] for row, one in enumerate(ones)]
    over = [False] * 3
    for action in actions(120):
        batch = np.stack([action, -action, 0.5 * action])
        seen, rewards, terminated, truncated, info = many.step(batch)
        for row, one in enumerate(ones):
            if over[row]:
                last[row], found = one.reset()[0], (0.0, False, False)
            else:
                last[row], *found, facts = one.step(batch[row])
                assert facts["true_error_m"] == info["true_error_m"][row]
            assert all(np.array_equal(last[row][key], seen[key][row]) for key in seen)
            assert tuple(found[:3]) == (rewards[row], terminated[row], truncated[row])
            over[row] = bool(found[1] or found[2])


def test_nothing_that_an_agent_is_told_depends_on_where_the_particle_is_until_it_is_felt() -> None:
    """Another true place changes what is judged, and neither observation nor reward nor the end of the episode."""
    env, other = PushEnv(), PushEnv()
    env.reset(seed=3)
    other.reset(seed=3)
    other._pushing.episodes.moving[0, 0, :2] += 40e-9
    random = np.random.Generator(np.random.PCG64(1))
    for step in range(100):
        # retracted, and then down in a corner
        action = np.array([*random.uniform(-1.0, 1.0, 2), 1.0 if step < 70 else -1.0], np.float32)
        one, two = env.step(action), other.step(action)
        assert all(np.array_equal(one[0][key], two[0][key]) for key in one[0])
        assert one[1:4] == two[1:4]
        assert one[4]["true_error_m"] != two[4]["true_error_m"]
    state = PushEnv(obs="state")
    seen, _ = state.reset(seed=3)
    assert seen["achieved_goal"].tolist() == [0.0, 0.0]


def test_a_reward_is_that_of_the_goals_for_one_and_for_many() -> None:
    for reward in ("progress", "sparse"):
        env = PushEnv(reward=reward)  # type: ignore[arg-type]
        env.reset(seed=5)
        infos, achieved, desired, rewards = [], [], [], []
        for action in actions(40):
            seen, given, _, _, info = env.step(action)
            assert given == env.compute_reward(seen["achieved_goal"], seen["desired_goal"], info)
            infos.append(info)
            achieved.append(seen["achieved_goal"])
            desired.append(seen["desired_goal"])
            rewards.append(given)
        # as hindsight replay asks
        again = env.compute_reward(np.array(achieved), np.array(desired), np.array(infos))
        assert again.tolist() == rewards
        assert env.compute_reward(np.array(achieved), np.array(achieved), {}).tolist() == [0.0] * 40
        assert env.compute_reward(np.zeros(2), np.ones(2), {}) == -1.0


def test_what_it_does_not_know_is_refused_in_words() -> None:
    for wrong in ({"obs": "image"}, {"reward": "dense"}, {"longest_s": 0.0}):
        with pytest.raises(ValueError, match=next(iter(wrong))):
            PushEnv(**wrong)  # type: ignore[arg-type]
    env = PushEnv()
    with pytest.raises(RuntimeError, match="reset"):
        env.step(np.zeros(3, np.float32))


def test_a_script_that_steers_by_what_it_feels_places_the_particle() -> None:
    found = evaluate(steered_push, range(6))
    assert found.successes >= 4 and found.low < found.successes / 6 < found.high
    assert found.time_s is not None and 1.0 < found.time_s < 30.0
    assert evaluate(RandomPolicy(), range(3), longest_s=2.0).successes == 0


@pytest.mark.endurance
def test_the_scripts_over_a_hundred_seeds(compiled_step: None) -> None:
    steered, straight = evaluate(steered_push, range(100)), evaluate(straight_push, range(100))
    assert steered.successes > straight.successes
    assert steered.low > 0.7


@pytest.mark.endurance
def test_the_compiled_step_gives_the_same_bits(compiled_step: None, monkeypatch: pytest.MonkeyPatch) -> None:
    def course() -> list[Any]:
        env = PushVectorEnv(4)
        env.reset(seed=2)
        return [env.step(np.tile(action, (4, 1)))[0]["observation"].tobytes() for action in actions(300)]

    fast = course()
    for name in ("advance", "_believe", "tell"):
        step = getattr(engine, name)
        monkeypatch.setattr(engine, name, getattr(step, "py_func", step))
    assert course() == fast


def test_the_units_are_those_of_the_usual_particle() -> None:
    assert 1e9 * float(engine.D_M) == pytest.approx(333.48 - 5.0 * math.tan(math.radians(15.0)), rel=1e-4)
    assert 1e9 * float(engine.F_N) == pytest.approx(10.7526, rel=1e-4)
