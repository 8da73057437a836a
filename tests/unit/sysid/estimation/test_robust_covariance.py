"""Standard errors: inflated where residuals are correlated, and by what is in no log."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter

from steerd.car_model.model import Model
from steerd.car_model.params import DEFAULT_CAR, PAPER_CAR
from steerd.sysid.data.dataset import Signal
from steerd.sysid.data.windows import make_layout
from steerd.sysid.estimation.fit import DEFAULT_FREE, TYRES, Options, fit
from steerd.sysid.estimation.robust_covariance import (
    Spread,
    inflate,
    inflate_each,
    row_times,
)

NAMES = (*TYRES, "steer_delay", "speed_lag")


def _matrix(rng, n):
    root = rng.standard_normal((n, n)) * 10.0 ** rng.uniform(-3, 3, n)
    return root.T @ root


@given(st.integers(0, 10**6), st.integers(2, 11), st.floats(5.0, 500.0))
@settings(derandomize=True, deadline=None, max_examples=50)
def test_errors_are_never_narrowed(seed, n, pieces):
    rng = np.random.default_rng(seed)
    covariance = _matrix(rng, n)
    wider = inflate(covariance, Spread(_matrix(rng, n), pieces))
    scale = np.sqrt(np.diag(wider))
    left = (wider - covariance) / np.outer(scale, scale)
    assert np.linalg.eigvalsh(left).min() > -1e-6


def test_scores_of_mere_noise_widen_nothing_and_others_by_as_much_as_they_vary():
    rng = np.random.default_rng(1)
    known = _matrix(rng, 4)
    covariance = np.linalg.inv(known)
    np.testing.assert_allclose(
        inflate(covariance, Spread(1.2 * known, 80.0)), covariance, rtol=1e-6
    )
    np.testing.assert_allclose(
        inflate(covariance, Spread(9.0 * known, 80.0)), 9.0 * covariance, rtol=1e-6
    )


def test_each_standard_error_is_as_wide_as_its_own_scores_and_correlations_stay():
    """The spread of estimates over many draws, where the noise is not what the fit believes."""
    rng = np.random.default_rng(2)
    design = rng.standard_normal((24, 40, 3))
    loud = np.array([1.0, 1.0, 3.0])[rng.integers(0, 3, 24)]
    information = np.einsum("bri,brj->ij", design, design)
    covariance = np.linalg.inv(information)
    found, wide = [], []
    for _ in range(2000):
        noise = rng.standard_normal((24, 40)) * loud[:, None]
        pulls = np.einsum("bri,br->bi", design, noise)
        found.append(covariance @ pulls.sum(axis=0))
        left = noise - design @ found[-1]
        pulls = np.einsum("bri,br->bi", design, left)
        each = inflate_each(covariance, Spread(pulls.T @ pulls, 24.0))
        wide.append(np.sqrt(np.diag(each)))
    np.testing.assert_allclose(np.median(wide, axis=0), np.std(found, axis=0), rtol=0.15)
    scale = np.sqrt(np.diag(each))
    before = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(
        each / np.outer(scale, scale), covariance / np.outer(before, before), rtol=1e-9
    )


def test_every_row_has_its_time(make_drive):
    layout = make_layout([make_drive(Model(DEFAULT_CAR), 4.0, 1)], 2.0)
    times = row_times(layout)
    assert np.isfinite(times).all()
    assert times.min() >= 0.0
    assert times.max() == pytest.approx(2.0, abs=0.02)
    poses = np.isin(layout.group, (0, 1))
    assert (np.diff(times[poses].reshape(-1, 3), axis=1) == 0.0).all()


def _lazy(run, seed, share):
    """The drive with pose noise that forgets slowly, as large as the white one."""
    rng = np.random.default_rng([5, seed])
    white = rng.normal(size=(len(run.pose.t), 2)) * 1e-3
    slow = lfilter([np.sqrt(1.0 - share**2)], [1.0, -share], white, axis=0)
    pose = run.pose.values.copy()
    pose[:, :2] += slow
    return replace(run, pose=Signal(run.pose.t, pose))


def test_noise_that_hangs_together_widens_the_errors(make_drive):
    run = make_drive(Model(DEFAULT_CAR), 30.0, 4)
    options = Options(free=TYRES)
    plain = fit([run], Model(DEFAULT_CAR), options=options)
    slow = fit([_lazy(run, 4, 0.95)], Model(DEFAULT_CAR), options=options)
    grown = {n: slow.estimates[n].sd / plain.estimates[n].sd for n in TYRES}
    assert min(grown.values()) > 1.8
    for name in TYRES:
        estimate = slow.estimates[name]
        assert abs(estimate.value - getattr(DEFAULT_CAR, name)) < 3.0 * estimate.sd, name


def test_a_doubt_adds_what_a_wrong_value_does(make_drive):
    run, wrong = make_drive(Model(DEFAULT_CAR), 20.0, 2), 1e-4
    options = Options(free=NAMES, noise=(1e-3, 2e-3, 0.02, 0.01))
    plain = fit([run], Model(DEFAULT_CAR), options=options)
    late = fit([run], Model(DEFAULT_CAR._replace(drive_delay=wrong)), options=options)
    doubts = replace(options, doubts=(("drive_delay", wrong),))
    doubtful = fit([run], Model(DEFAULT_CAR), options=doubts)
    for name in NAMES:
        before, after = plain.estimates[name], doubtful.estimates[name]
        added = np.sqrt(after.sd**2 - before.sd**2)
        assert added == pytest.approx(abs(late.estimates[name].value - before.value), rel=0.05)
        assert after.value == before.value


def test_a_doubt_about_a_free_parameter_stands_for_itself(make_drive):
    run = make_drive(Model(DEFAULT_CAR), 12.0, 2)
    options = Options(free=NAMES, doubts=(("steer_delay", 3e-3),))
    found = fit([run], Model(DEFAULT_CAR), options=options)
    assert found.estimates["steer_delay"].sd == pytest.approx(3e-3, rel=0.01)


def test_circles_do_not_tell_the_sum_that_hangs_on_the_steering_gain(make_circles):
    still = PAPER_CAR._replace(
        steer_delay=0.0, steer_lag=0.0, steer_rate=1e3, speed_lag=0.0, accel_max=1e3, decel_max=1e3
    )
    runs = make_circles()
    tyres = fit(runs, Model(still), options=Options(free=TYRES))
    assert all(c.known for c in tyres.combinations)
    gain = fit(runs, Model(still), options=Options(free=(*TYRES, "steer_gain")))
    first, second = gain.combinations
    assert not first.known
    assert first.sd > 0.02 * first.value
    assert second.known
    assert "steer_gain" in DEFAULT_FREE
