"""Gain, centre, delay and stops of the steering are recovered from drives with known ones."""

import numpy as np
import pytest

from steerd.car_model.car_file import default_car_path, load_car
from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.daemon.setup.steering_calibration import calibrate_steering

CAR = load_car(default_car_path()).car


def steered(gain, bias, delay, *, stop=1.0, seed=0, amplitude=0.25):
    t = np.arange(0.0, 40.0, 0.01)
    command = amplitude * np.sin(2 * np.pi * t / 6.0) + 0.02
    wheel = np.clip(gain * np.interp(t - delay, t, command) + bias, -stop, stop)
    speed = np.full_like(t, 1.0)
    slip = (1 / CAR.c_sf - 1 / CAR.c_sr) / (CAR.mu * 9.81)
    w = np.tan(wheel) / (CAR.lf + CAR.lr) * speed / (1 + slip * speed**2 / (CAR.lf + CAR.lr))
    rng = np.random.default_rng(seed)
    return t, speed, w + 0.02 * rng.normal(size=t.size), t, command


@pytest.mark.parametrize(("gain", "bias", "delay"), [(1.0, 0.0, 0.05), (0.85, 0.03, 0.1)])
def test_steering_gain_centre_and_delay(gain, bias, delay):
    found = calibrate_steering(*steered(gain, bias, delay), CAR)
    assert found.gain == pytest.approx(gain, rel=0.01)
    assert found.bias == pytest.approx(bias, abs=0.002)
    assert found.delay == pytest.approx(delay, abs=0.005)
    assert not found.clipped_left
    assert not found.clipped_right


def test_steering_that_meets_its_stops():
    found = calibrate_steering(*steered(1.0, 0.0, 0.05, stop=0.2, amplitude=0.32), CAR)
    assert found.clipped_left
    assert found.clipped_right
    assert (found.left, found.right) == pytest.approx((0.2, -0.2), abs=0.01)
    assert found.gain == pytest.approx(1.0, rel=0.05)


def stepped(hold, *, seed=0, speed=1.0):
    """A drive in bends that change at once, more of them to the left; truth: 1, 0, 60 ms."""
    t = np.arange(0.0, 60.0, 0.01)
    rng = np.random.default_rng(seed)
    levels = rng.choice([0.14, 0.12, 0.09, 0.05, -0.09], size=int(60 / hold) + 1)
    command = levels[(t / hold).astype(int)]
    wheel = np.interp(t - 0.06, t, command)
    for _ in range(2):  # the servo's lag, and what differentiating smooths
        wheel = np.convolve(np.pad(wheel, 10, mode="edge"), np.ones(21) / 21, "valid")
    v = np.full_like(t, speed)
    slip = (1 / CAR.c_sf - 1 / CAR.c_sr) / (CAR.mu * 9.81)
    w = np.tan(wheel) / (CAR.lf + CAR.lr) * v / (1 + slip * v**2 / (CAR.lf + CAR.lr))
    return t, v, w + 0.02 * rng.normal(size=t.size), t, command


@pytest.mark.parametrize("seed", range(4))
def test_steps_of_steering_do_not_dilute_the_gain(seed):
    found = calibrate_steering(*stepped(1.0, seed=seed), CAR)
    assert found.gain == pytest.approx(1.0, abs=0.02)
    assert abs(found.gain - 1.0) < 4 * found.sd_gain + 0.005
    assert found.bias == pytest.approx(0.0, abs=0.002)


def test_steering_that_is_never_followed_or_badly_identified_is_refused():
    with pytest.raises(SteerdError, match="swings too fast"):
        calibrate_steering(*stepped(0.1), CAR)
    t, v, w, tc, command = steered(1.0, 0.0, 0.05, amplitude=0.04)
    noisy = w + np.repeat(np.random.default_rng(1).normal(scale=0.06, size=40), 100)
    with pytest.raises(SteerdError, match="the steering gain is identified to") as caught:
        calibrate_steering(t, v, noisy, tc, command, CAR)
    assert caught.value.code == ExitCode.STOPPED


def test_a_drive_too_fast_for_the_tyre_model_is_warned_of():
    assert calibrate_steering(*stepped(1.5), CAR).warnings == ()
    (warning,) = calibrate_steering(*stepped(1.5, speed=3.0), CAR).warnings
    assert "drive slower" in warning


def test_drives_that_identify_no_steering():
    with pytest.raises(SteerdError, match="as much as commanded") as caught:
        calibrate_steering(*steered(-1.0, 0.0, 0.05), CAR)
    assert "servo_gain" in caught.value.hint
    with pytest.raises(SteerdError, match="barely used"):
        calibrate_steering(*steered(1.0, 0.0, 0.05, amplitude=0.001), CAR)
    t, speed, w, tc, command = steered(1.0, 0.0, 0.05)
    with pytest.raises(SteerdError, match="barely moves"):
        calibrate_steering(t, 0.0 * speed, w, tc, command, CAR)
