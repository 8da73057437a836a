"""Sweeps that are planned, and one that was driven."""

import pytest

from steerd.car_model.car_file import default_car_path, load_car
from steerd.daemon.many.sweep.plan import make_sweep_plan


@pytest.fixture(scope="session")
def car():
    """The F1TENTH car."""
    return load_car(default_car_path())


@pytest.fixture(scope="session")
def make_plan(car):
    """A plan of these tables."""

    def make(vary, **more):
        return make_sweep_plan(car, {"vary": vary, **more})

    return make
