"""Noise of `steerd identify -o`: learnt where the car moves, as `steerd diagnose` judges."""

import numpy as np

from steerd.car_model.car_file import default_car_path, load_car
from steerd.daemon.analysis.car_output import learn_known
from steerd.sysid.data.dataset import Run, Signal, make_run
from steerd.sysid.data.segments import SPEED_MIN, moving_segments
from steerd.sysid.inference.noise import Noise, noise_section

NOISE = Noise((1e-3, 2e-3, 0.02, 0.03), (0.4, 0.3, 2.0))


def _half_standing() -> Run:
    """20 s, of which the car stands for the first ten."""
    t = np.arange(2000) * 0.01
    speed = np.where(t < 10.0, 0.0, 1.5)
    pose = np.column_stack([np.cumsum(speed) * 0.01, np.zeros((2000, 2))])
    return make_run("half", Signal(t, np.zeros(2000)), Signal(t, speed), Signal(t, pose))


def test_noise_is_learnt_where_the_car_moves(monkeypatch):
    seen = []
    monkeypatch.setattr(
        "steerd.sysid.inference.car_posterior.learn_sections",
        lambda car, runs: (seen.extend(runs), {"noise": noise_section(NOISE)})[1],
    )
    run = _half_standing()
    known = learn_known(load_car(default_car_path()), (run,))
    assert known == {"noise": noise_section(NOISE)}
    assert [r.duration for r in seen] == [r.duration for r in moving_segments([run])]
    assert all(np.all(r.commands[:, 1] > SPEED_MIN) for r in seen)
    assert sum(r.duration for r in seen) < 10.0


def test_a_creeping_car_teaches_nothing():
    t, pace = np.arange(1000) * 0.01, 0.5 * SPEED_MIN
    pose = Signal(t, np.column_stack([pace * t, np.zeros((1000, 2))]))
    run = make_run("creep", Signal(t, np.zeros(1000)), Signal(t, np.full(1000, pace)), pose)
    car = load_car(default_car_path())
    assert learn_known(car, (run,)) == {}
