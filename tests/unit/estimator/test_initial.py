import math

import numpy as np
import pytest

from steerd.estimator.config import FilterConfig
from steerd.estimator.initial import initial_belief
from steerd.estimator.sensors import Measurement, make_pose

CONFIG = FilterConfig()
MS = 1_000_000


def poses_on_a_curve(
    seed: int, speed: float, yaw: float, yaw_rate: float, slip: float, count: int = 10
) -> list[Measurement]:
    """Poses at 100 Hz that end at the origin with the given motion."""
    rng = np.random.default_rng(seed)
    out = []
    for i in range(count):
        t = (i - count + 1) * 0.01
        psi, course = yaw + yaw_rate * t, yaw + slip + 0.5 * yaw_rate * t
        n = rng.standard_normal(3)
        x = speed * t * math.cos(course) + CONFIG.pose_position_sd * n[0]
        y = speed * t * math.sin(course) + CONFIG.pose_position_sd * n[1]
        wrapped = math.remainder(psi + CONFIG.pose_yaw_sd * n[2], math.tau)
        out.append(make_pose(10**12 + i * 10 * MS, x, y, wrapped))
    return out


@pytest.mark.parametrize(
    ("speed", "yaw", "yaw_rate", "slip"),
    [(0.0, 0.4, 0.0, 0.0), (2.0, 3.1, 1.0, 0.03), (-1.5, -2.0, 0.4, 0.0), (0.3, 1.0, -0.5, 0.0)],
)
def test_first_belief_covers_the_truth(speed, yaw, yaw_rate, slip):
    truth = np.array([0.0, 0.0, yaw, speed, yaw_rate, slip])
    errors = []
    for seed in range(50):
        belief = initial_belief(CONFIG, poses_on_a_curve(seed, speed, yaw, yaw_rate, slip), 0.0)
        error = belief.mean[:6] - truth
        error[2] = math.remainder(error[2], math.tau)
        errors.append(error / np.sqrt(np.diag(belief.covariance)[:6]))
    assert np.abs(errors).max() < 4.0
    assert np.abs(np.mean(errors, axis=0)).max() < 1.0


@pytest.mark.parametrize("index", range(10))
@pytest.mark.parametrize("shift", [(0.5, 0.0, 0.0), (0.0, 0.0, math.pi)])
def test_one_wrong_pose_stops_the_start(index, shift):
    poses = poses_on_a_curve(1, 1.0, 0.0, 0.0, 0.0)
    x, y, yaw = (a + b for a, b in zip(poses[index].values, shift, strict=True))
    poses[index] = make_pose(poses[index].t_ns, x, y, yaw)
    assert initial_belief(CONFIG, poses, None) is None


def test_poses_far_apart_in_time_do_not_start_a_filter():
    poses = [make_pose(i * 100 * MS, 0.0, 0.0, 0.0) for i in range(10)]
    assert initial_belief(CONFIG, poses, None) is None
    assert initial_belief(CONFIG, [poses[0]] * 10, None) is None


def test_a_carried_car_starts_without_slip():
    poses = [make_pose(i * 10 * MS, 0.0, 0.01 * i, 0.0) for i in range(10)]
    belief = initial_belief(CONFIG, poses, None)
    assert belief.mean[5] == 0.0
