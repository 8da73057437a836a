"""Windows of a healthy drive and how they are weighed, for the tests of likelihood and search."""

from collections.abc import Sequence

import pytest

from steerd.sysid.data.dataset import Run
from steerd.sysid.inference.augmented_car import AugmentedCar, make_augmented_car
from steerd.sysid.inference.likelihood import Likelihood, make_likelihood
from steerd.sysid.inference.noise import Noise
from steerd.sysid.inference.predictor import open_predictor
from steerd.sysid.inference.space import make_space

NOISE = Noise((7e-4, 2e-3, 0.02, 0.05), (0.4, 0.4, 2.5), 1e-4)
"""What `tests/unit/conftest.py` adds to its drives."""
FEW = ("lf", "c_sf", "steer_gain", "steer_bias", "speed_gain")  # base parameters without kinks


def likelihood_of(augmented: AugmentedCar, runs: Sequence[Run]) -> Likelihood:
    """The windows of such drives about a car, weighed by the noise that they have."""
    predictor = open_predictor(augmented, runs)
    return make_likelihood(predictor, predictor.augmented.base, predictor.guess, NOISE)


@pytest.fixture(scope="session")
def likelihood(drive, base) -> Likelihood:
    runs = drive("", runs=2, seconds=6.0, seed=7)
    return likelihood_of(make_augmented_car(base, runs), runs)


healthy = pytest.fixture(lambda likelihood: likelihood.predictor, scope="session")
small = pytest.fixture(lambda healthy: make_space(healthy.augmented, FEW), scope="session")
