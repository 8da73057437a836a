"""A learner about the default car, windows as quadratic forms, and drives of the hidden plant."""

from collections.abc import Callable, Iterable

import numpy as np
import pytest

from benchmarks.blind_gap.car import make_car
from benchmarks.live_changes import plant
from steerd.car_model.car_file import default_car_path, load_car
from steerd.car_model.effects import find_effect
from steerd.sim_gap.online.learner import SETTLED, Change, Learner, State, fold, make_learner
from steerd.sim_gap.online.naming import Finding
from steerd.sim_gap.online.samples import Sample
from steerd.sim_gap.online.tracking import Loss, Reference, Track
from steerd.sim_gap.verdict.confidence import Cause
from steerd.sysid.inference.noise import Noise
from steerd.sysid.inference.space import make_space

NUISANCE = ("lf", "c_sf", "steer_lag")
EFFECTS = ("steer_bias", "steer_gain", "marker_offset", "tyre_friction")
DOF = 30

learner = pytest.fixture(lambda: make_learner(load_car(default_car_path())), scope="session")


@pytest.fixture(scope="session")
def reference(learner: Learner) -> Reference:
    noise = Noise((1e-3, 2e-3, 0.02, 0.05), (0.1, 0.1, 0.7))
    return Reference(learner.augmented, make_space(learner.augmented, NUISANCE, EFFECTS), noise)


def follow(
    learner: Learner, samples: Iterable[Sample], state: State | None = None
) -> tuple[State, int]:
    """What a learner makes of samples, from a state on, and how often it reports."""
    state, reports = state or State(), 0
    for sample in samples:
        state, due = fold(learner, state, sample)
        reports += due
    return state, reports


learn = pytest.fixture(lambda: lambda *given: follow(*given)[0], scope="session")


def change(
    effect, *after, verdict="named", sure=0.95, beside=(), windows=SETTLED, together=0.0, sd=0.0005,
    **more,
):  # fmt: skip
    """A change of a car: what it is named and how sure that is, and its parameters now."""
    found = find_effect(effect)
    each = zip(found.parameters, after, strict=True)
    parameters = {p.name: (value, sd, p.unit) for p, value in each}
    cause = Cause(effect, "", found.family, parameters, sure, beside, "")
    finding = Finding(verdict, cause if verdict == "named" else None, max(sure, together))
    seen = ((0.0, None),) * windows
    return Change(0.0, 1.0, None, seen, finding, **{"was": found.nulls, **more})


@pytest.fixture
def track(reference: Reference) -> Track:
    n = reference.space.nuisance
    prior = np.linalg.inv(reference.space.covariance[:n, :n])
    return Track(400.0 * prior, np.zeros(n), prior)


@pytest.fixture
def windows(reference: Reference) -> Callable[..., list[Loss]]:
    """Windows about a car of which some coordinates are off: `windows(12, steer_bias=0.02)`."""

    def make(count: int, left: float = 1.0, seed: int = 3, **off: float) -> list[Loss]:
        rng = np.random.default_rng(seed)
        truth, free = np.zeros(len(reference.space.centre)), reference.space.chart.free
        for name, value in off.items():
            first = next(i for i, each in enumerate(free) if each.startswith(f"{name}."))
            truth[first] = value
        looks = []
        for number in range(count):
            slopes = rng.standard_normal((DOF, len(truth))) / reference.space.spread
            h = 40.0 * slopes.T @ slopes
            best = truth + np.linalg.solve(np.linalg.cholesky(h).T, rng.standard_normal(len(truth)))
            square = left * DOF + float(best @ h @ best)
            looks.append(Loss(0.5 * number, square, DOF, h @ best, h))
        return looks

    return make


@pytest.fixture(scope="session")
def drives() -> Callable[..., list[Sample]]:
    """What a hidden car sends: `drives(seconds)`, or `drives(seconds, "steer_bias", at)`."""

    def make(seconds: float, name: str = "", at: float = 0.0) -> list[Sample]:
        car = make_car(np.random.default_rng(5))
        hit = plant.Change(name, at, plant.changed(car, name)) if name else None
        return list(plant.drive(car, seconds, np.random.default_rng(6), hit))

    return make
