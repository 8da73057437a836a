"""Windows of a healthy drive and how they are weighed, for the tests of likelihood and search."""

import pytest

from steerd.sysid.inference.augmented_car import make_augmented_car
from steerd.sysid.inference.likelihood import Likelihood, make_likelihood
from steerd.sysid.inference.noise import Noise
from steerd.sysid.inference.predictor import Predictor, open_predictor
from steerd.sysid.inference.space import make_space

NOISE = Noise((7e-4, 2e-3, 0.02, 0.05), (0.4, 0.4, 2.5), 1e-4)
"""What `tests/unit/conftest.py` adds to its drives."""
FEW = ("lf", "c_sf", "steer_gain", "steer_bias", "speed_gain")  # base parameters without kinks


@pytest.fixture(scope="session")
def healthy(drive, base) -> Predictor:
    runs = drive("", runs=2, seconds=6.0, seed=7)
    return open_predictor(make_augmented_car(base, runs), runs)


@pytest.fixture(scope="session")
def likelihood(healthy) -> Likelihood:
    guess = healthy.guess.copy()
    return make_likelihood(healthy, healthy.augmented.base, guess, NOISE)


small = pytest.fixture(lambda healthy: make_space(healthy.augmented, FEW), scope="session")
