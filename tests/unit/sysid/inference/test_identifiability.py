"""What a covariance says of parameters: what is identifiable, and why the rest is not."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize

from steerd.car_model.effects import EFFECTS
from steerd.car_model.model import Model
from steerd.car_model.native.windows import parameter_vector
from steerd.car_model.params import DEFAULT_CAR, GRAVITY
from steerd.car_model.planar import make_planar
from steerd.sysid.inference import augmented_car
from steerd.sysid.inference.chart import make_chart
from steerd.sysid.inference.identifiability import combinations, estimates, estimates_with_sds
from steerd.sysid.inference.places import DISCS, RADII, suspicious_discs
from steerd.sysid.inference.search import step_within
from steerd.sysid.paper import NAMES as TYRES

CAR = DEFAULT_CAR._replace(lf=0.16, steer_gain=0.95)
SD = {"lf": 0.002, "lr": 0.1, "steer_gain": 0.01, "steer_delay": 0.001, "tyre_saturation.q": 0.1}


def test_noise_that_passes_for_transients_tells_no_compliance():
    """Known to a third of itself, after a start with tyres three times as soft."""
    p = parameter_vector(Model(DEFAULT_CAR._replace(c_sf=3.0)))
    chart = make_chart((), p, TYRES)
    z = chart.coordinates(parameter_vector(Model(DEFAULT_CAR._replace(c_sf=9.0))))
    sd = np.array([1e-5, 1e-5, 0.3 * z[2], 1e-3])
    assert not estimates(chart, z, np.diag(sd**2))["c_sf"].identifiable


def test_nothing_is_told_while_a_length_sits_at_its_bound():
    names = ("lf", "lr", "inertia_z")
    prior = parameter_vector(Model(DEFAULT_CAR))
    chart = make_chart((), prior, names, 0.33)
    small = np.diag([1e-4, 1e-4]) ** 2
    for lr, told in ((0.17, True), (0.325, False)):
        z = chart.coordinates(parameter_vector(Model(DEFAULT_CAR._replace(lr=lr))))
        found = estimates(chart, z, small)
        assert all(e.identifiable is told for e in found.values())
        assert all(("at its bound" in e.manoeuvre) is not told for e in found.values())


@pytest.mark.parametrize(("free", "wheelbase"), [("lf", None), ("lr", None), ("lf", 0.33)])
def test_a_sum_is_as_unsure_as_the_one_length_that_is_free(free, wheelbase):
    chart = make_chart((), parameter_vector(Model(DEFAULT_CAR)), (free, "c_sr"), wheelbase)
    found = combinations(chart, chart.coordinates(chart.prior), np.diag([1e-6, 1e-20]), 2.0)
    sure = 1e-10 * 4.0 / (DEFAULT_CAR.mu * GRAVITY)
    wanted = [sure if wheelbase else 1e-3, 1e-3 if wheelbase or free == "lr" else sure]
    assert [each.sd for each in found] == pytest.approx(wanted, rel=1e-3)


def _estimates(effects, values, sd):
    model = Model(CAR, effects, values, make_planar("rear"))
    return estimates_with_sds(effects, parameter_vector(model), sd)


def test_known_to_a_few_percent_is_identifiable_and_what_may_be_the_bodys_place_to_be_weighed():
    found = _estimates((EFFECTS["tyre_saturation"],), ((0.8, 0.0),), SD)
    assert (set(found), found["lf"].value, found["lf"].sd) == (set(SD), 0.16, 0.002)
    assert found["tyre_saturation.q"].value == 0.8
    assert (found["lf"].identifiable, found["lf"].manoeuvre) == (True, "")
    assert not found["lr"].identifiable  # 0.1 m of 0.17 m
    assert found["steer_delay"].identifiable
    effects = (EFFECTS["tyre_saturation"], EFFECTS["marker_offset"])
    sd = {**SD, "lf": 0.02, "marker_offset.forward": 0.02}
    found = _estimates(effects, ((0.8, 0.0), (0.02, 0.0)), sd)
    for name in ("lf", "lr", "marker_offset.forward"):
        assert not found[name].identifiable
        assert "weighing both axles" in found[name].manoeuvre
    assert found["steer_gain"].manoeuvre == ""


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
        each = augmented_car.inflate_each(covariance, pulls)
        wide.append(np.sqrt(np.diag(each)))
    np.testing.assert_allclose(np.median(wide, axis=0), np.std(found, axis=0), rtol=0.15)
    scale, before = np.sqrt(np.diag(each)), np.sqrt(np.diag(covariance))
    correlation = covariance / np.outer(before, before)
    np.testing.assert_allclose(each / np.outer(scale, scale), correlation, rtol=1e-9)
    assert (scale >= before * (1.0 - 1e-12)).all()


# Where the floor is suspicious: a patch is found by the errors in it, and nothing else is.
def drive(rng, count=120):
    """Places of windows along rounds of a track of 8 by 4 m, and what noise leaves of each."""
    phase = rng.uniform(0.0, 2.0 * np.pi, count)
    where = np.column_stack([4.0 * np.cos(phase), 2.0 * np.sin(phase)])
    return where + 0.2 * rng.normal(size=(count, 2)), rng.chisquare(12, count) / 12.0


@pytest.mark.parametrize("radius", [0.8, 1.5, 2.2])
@pytest.mark.parametrize("seed", range(5))
def test_the_first_disc_lies_on_the_patch(seed, radius):
    rng = np.random.default_rng([seed, 7])
    where, badness = drive(rng)
    centre = where[rng.integers(len(where))]
    inside = np.linalg.norm(where - centre, axis=1) < radius
    badness[inside] *= rng.uniform(3.0, 3000.0, inside.sum())
    *middle, found = suspicious_discs(where, badness)[0]
    assert np.linalg.norm(middle - centre) < radius
    named = np.linalg.norm(where - middle, axis=1) < found
    assert (named & inside).sum() > 0.6 * max(named.sum(), inside.sum())


@given(st.integers(0, 2**32), st.floats(-100.0, 100.0), st.floats(-np.pi, np.pi))
def test_it_does_not_matter_where_the_floor_has_its_origin(seed, shift, angle):
    where, badness = drive(np.random.default_rng(seed), 40)
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    here = suspicious_discs(where, badness)
    there = suspicious_discs(where @ turn + shift, badness)
    assert [disc[2] for disc in here] == [disc[2] for disc in there]
    at, moved = (np.array([disc[:2] for disc in discs]).reshape(-1, 2) for discs in (here, there))
    assert np.allclose(at @ turn + shift, moved, atol=1e-9)


def test_discs_are_few_and_none_lies_in_another():
    discs = suspicious_discs(*drive(np.random.default_rng(3), 300))
    assert 1 < len(discs) <= DISCS
    for k, (x, y, radius) in enumerate(discs):
        assert radius in RADII
        for a, b, other in discs[:k]:
            assert np.hypot(x - a, y - b) > max(radius, other)


@pytest.mark.parametrize(("where", "badness"), [
    (np.zeros((0, 2)), np.zeros(0)), (np.array([[1.0, 2.0]]), np.array([9.0])),
    (np.zeros((6, 2)), np.arange(6.0)), (np.arange(12.0).reshape(6, 2), np.ones(6)),
], ids=["no window", "one window", "the car stood", "all alike"])  # fmt: skip
def test_where_no_place_differs_there_is_no_disc(where, badness):
    assert suspicious_discs(where, badness) == []


# What healthy drives tell about a base travels beside its car file.
NAMES = ("lf", "lr", "steer_gain", "scrub.drag")


def known(seed: int = 0) -> augmented_car.BasePrior:
    root = np.random.default_rng(seed).standard_normal((4, 6)) * [[1e-3], [2e-3], [0.01], [0.3]]
    values, covariance = np.array([1e-3, -2e-3, 0.1]), np.diag([1e-6, 2e-6, 0.1])
    slope = augmented_car.Control("floor_slope", values, covariance, 0.02)
    values, left = (0.16, 0.17, 1.01, 0.2), (0.3, {"accel_max": 3.2})
    return augmented_car.BasePrior(NAMES, root @ root.T, values, (slope,), *left)


@pytest.mark.parametrize("seed", range(5))
def test_what_is_known_survives_the_car_file(seed: int) -> None:
    before = known(seed)
    after = augmented_car.knowledge_of_section(augmented_car.knowledge_section(before))
    for name in ("names", "values", "size", "least"):
        assert getattr(after, name) == getattr(before, name)
    sd = np.sqrt(np.diag(before.covariance))
    away = np.abs(after.covariance - before.covariance) / np.outer(sd, sd)
    assert away.max() < 2e-5
    assert np.linalg.eigvalsh(after.covariance).min() > 0.0
    [one], [other] = before.controls, after.controls
    assert (one.effect, one.gain) == (other.effect, other.gain)
    np.testing.assert_allclose(other.values, one.values)
    np.testing.assert_allclose(other.covariance, one.covariance)


@pytest.mark.parametrize("key", ["names", "sd", "correlation", "values"])
def test_a_damaged_section_is_refused(key: str) -> None:
    table = augmented_car.knowledge_section(known())
    for damaged in ({k: v for k, v in table.items() if k != key}, {**table, key: "?"}):
        with pytest.raises(ValueError, match="knowledge"):
            augmented_car.knowledge_of_section(damaged)
    wrong = (
        {"nothing": [[0.0], [[1.0]], 0.1]}, {"mass": [[0.0], [[-1.0]], 0.1]},
        {"mass": [[0.0, 1.0], [[1.0]], 0.1]}, {"mass": [[0.0], [[1.0]], np.nan]}, "?",
        {"accel_limit": [[9.0], [[-1.0]], 0.1]}, {"mass": [[0.0, 1.0], [[0.0] * 2] * 2, 0.1]},
    )  # fmt: skip
    others = {"size": np.nan}, {"least": {"accel_max": np.inf}}, {"least": 3.0}
    for damaged in (*({"controls": each} for each in wrong), *others):
        with pytest.raises(ValueError, match="knowledge"):
            augmented_car.knowledge_of_section({**table, **damaged})
    assert augmented_car.knowledge_of_section({}) is None


# The step within bounds.
def _quadratic(seed: int, n: int) -> tuple[np.ndarray, ...]:
    """A convex quadratic with strongly correlated coordinates, a point and bounds about it."""
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((n, n)) @ np.diag(10.0 ** rng.uniform(-2.0, 2.0, n))
    h = root @ root.T + 1e-6 * np.eye(n)
    slope = root @ rng.standard_normal(n) * 10.0 ** rng.uniform(-1.0, 2.0)
    z = rng.standard_normal(n)
    low, high = z - rng.choice([0.0, 0.01, 1.0], n), z + rng.choice([0.0, 0.01, 1.0], n)
    return h, slope, z, low, high


@settings(deadline=None, max_examples=200)
@given(seed=st.integers(0, 10**6), n=st.integers(1, 8))
def test_no_step_promises_less_than_nothing_or_leaves_the_bounds(seed: int, n: int) -> None:
    h, slope, z, low, high = _quadratic(seed, n)
    dz = step_within(h, slope, z, low, high)
    assert np.isfinite(dz).all()
    assert (z + dz >= low - 1e-12).all()
    assert (z + dz <= high + 1e-12).all()
    promised = slope @ dz - 0.5 * dz @ h @ dz
    assert promised >= -1e-9 * (1.0 + abs(slope @ dz))


@pytest.mark.parametrize("seed", range(12))
def test_it_is_the_best_step_within_the_bounds(seed: int) -> None:
    """Against another of SciPy's bounded minimisers."""
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((4, 4)) + 2.0 * np.eye(4)
    h, slope = root @ root.T, 3.0 * rng.standard_normal(4)
    low, high = np.full(4, -0.3), np.full(4, 0.3)
    best = minimize(
        lambda d: 0.5 * d @ h @ d - slope @ d, np.zeros(4), jac=lambda d: h @ d - slope,
        bounds=list(zip(low, high, strict=True)),
    )  # fmt: skip
    dz = step_within(h, slope, np.zeros(4), low, high)
    assert slope @ dz - 0.5 * dz @ h @ dz == pytest.approx(-best.fun, rel=1e-5)
    free = step_within(h, slope, np.zeros(4), 1e9 * low, 1e9 * high)
    assert free == pytest.approx(np.linalg.solve(h, slope)), "Newton's where nothing bounds it"


def test_two_coordinates_that_do_the_same_still_give_a_step() -> None:
    """A curvature that is singular to the last digit, with a bound in Newton's way."""
    h = np.array([[1.0, 1.0, 0.0], [1.0, 1.0 - 1e-15, 0.0], [0.0, 0.0, 1.0]])
    slope, edge = np.array([1.0, 1.0, 1.0]), np.full(3, 0.1)
    dz = step_within(h, slope, np.zeros(3), -edge, edge)
    assert np.isfinite(dz).all()
    assert (np.abs(dz) <= 0.1).all()
    assert slope @ dz - 0.5 * dz @ h @ dz > 0.0
