"""The stepping environment: the same episode again, its ends, its errors."""

import numpy as np
import pytest

import steerd
from steerd.daemon.analysis.environment import OBSERVED

pytestmark = pytest.mark.slow


def follow(observation):
    """A lane keeper of one line."""
    e1, e2, curvature, *_ = observation
    return 0.33 * curvature - 0.8 * e1 - e2, 1.0


def episode(env, seed, policy=follow):
    observation, _ = env.reset(seed=seed)
    rows = []
    while True:
        observation, reward, terminated, truncated, info = env.step(policy(observation))
        rows.append([*observation, reward])
        if terminated or truncated:
            return np.array(rows), terminated, truncated, info


@pytest.fixture(scope="module")
def env():
    return steerd.Environment(path="circle:radius=2", duration=2.0)


def test_the_same_seed_and_actions_give_the_same_episode(env):
    one, terminated, truncated, info = episode(env, 4)
    assert (terminated, truncated, info["t"]) == (False, True, pytest.approx(2.0))
    assert one.shape == (200, len(OBSERVED) + 1)
    assert np.array_equal(one, episode(env, 4)[0])
    assert not np.array_equal(one, episode(env, 5)[0])
    assert np.abs(one[:, 0]).max() < 0.1
    with pytest.raises(steerd.SteerdError, match="episode is over"):
        env.step((0.0, 0.0))


def test_leaving_the_lane_terminates_the_episode():
    env = steerd.Environment(path="circle:radius=2", duration=8.0)
    _, terminated, truncated, info = episode(env, 4, lambda _: (-0.26, 1.0))
    assert (terminated, truncated) == (True, False)
    assert 0.5 < -info["state"].e1 < 0.55
    assert 0.0 < info["t"] < 8.0
