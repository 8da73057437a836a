"""Symmetries of the equations, the tape of random formulas, projection on paths."""

import math
import operator
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from steerd.car_model.chassis import SPEED_DYNAMIC, SPEED_KINEMATIC, Chassis, derivative
from steerd.car_model.linear import rates_and_jacobian
from steerd.car_model.model import Model
from steerd.car_model.ops import FLOAT, Ops
from steerd.car_model.params import DEFAULT_CAR, GRAVITY, PARAMETERS, Car
from steerd.car_model.path.path import Path, locate, project
from steerd.car_model.path.path_spec import parse_path
from steerd.car_model.planar import CHASSIS
from steerd.car_model.rollout import simulate, start
from steerd.car_model.single_track import SINGLE_TRACK
from steerd.car_model.state import Command, State
from steerd.car_model.tape import TAPE, Tape, gradient, program

repeatable = settings(derandomize=True, deadline=None, max_examples=60)


def about(value: float, share: float = 0.3) -> st.SearchStrategy[float]:
    return st.floats(1.0 - share, 1.0 + share).map(lambda ratio: value * ratio)


cars = st.builds(
    Car,
    *(
        about(p.default) if p.default else st.floats(max(p.low, -0.02), min(p.high, 0.02))
        for p in PARAMETERS
    ),
)
states = st.builds(
    State,
    st.floats(-5, 5),
    st.floats(-5, 5),
    st.floats(-4, 4),
    st.floats(-0.5, 5.0),
    st.floats(-4, 4),
    st.floats(-0.4, 0.4),
    st.floats(-0.34, 0.34),
)
wheels = st.floats(-0.4, 0.4)
accels = st.floats(-5.0, 5.0)
drives = st.lists(
    st.builds(Command, st.floats(-0.5, 0.5), st.floats(-0.5, 4.0)), min_size=5, max_size=25
)
STEP = 0.005


def run(
    car: Car[float],
    first: State[float],
    drive: list[Command[float]],
    chassis: Chassis = SINGLE_TRACK,
) -> list[State[float]]:
    model = Model(car, chassis=chassis)
    return [m.state for m in simulate(FLOAT, model, start(model, first, 0.0), drive, STEP)]


def near_a_seam(speed: float) -> bool:
    """Whether a small step in speed crosses a change of formula."""
    return any(abs(speed - seam) < 1e-4 for seam in (SPEED_KINEMATIC, SPEED_DYNAMIC))


@repeatable
@given(cars, states, wheels, accels)
def test_generated_rates_are_the_equations(car, state, wheel, accel):
    rates, _ = rates_and_jacobian(car, state, wheel, accel)
    expected = derivative(SINGLE_TRACK, FLOAT, car, state, wheel, accel)
    assert rates == pytest.approx(tuple(expected), rel=1e-11, abs=1e-11)


@repeatable
@given(cars, states, wheels, accels)
def test_generated_jacobian_is_that_of_central_differences(car, state, wheel, accel):
    if near_a_seam(state.speed):
        state = state._replace(speed=state.speed + 1e-3)
    jacobian = rates_and_jacobian(car, state, wheel, accel)[1]
    point = (*state[:6], wheel, accel)
    width = 1e-6
    for column in range(8):
        ends = []
        for side in (width, -width):
            moved = [v + side * (i == column) for i, v in enumerate(point)]
            at = State(*moved[:6], state.steer)
            ends.append(derivative(SINGLE_TRACK, FLOAT, car, at, moved[6], moved[7]))
        slopes = [(a - b) / (2.0 * width) for a, b in zip(*ends, strict=True)]
        found = [row[column] for row in jacobian]
        scale = 1.0 + max(map(abs, slopes))
        assert found == pytest.approx(slopes, abs=2e-7 * scale)


@repeatable
@given(cars, states, wheels, accels)
def test_above_walking_pace_it_is_commonroads_single_track_model(car, state, wheel, accel):
    """CommonRoad vehicle models, section ST, written out longhand."""
    state = state._replace(speed=SPEED_DYNAMIC + abs(state.speed))
    mu, m, inertia, h = car.mu, car.mass, car.inertia_z, car.cog_height
    lf, lr, c_f, c_r, g = car.lf, car.lr, car.c_sf, car.c_sr, GRAVITY
    v, r, beta = state.speed, state.yaw_rate, state.slip_angle
    front, rear = g * lr - accel * h, g * lf + accel * h
    r_dot = (
        -(mu * m / (v * inertia * (lr + lf))) * (lf**2 * c_f * front + lr**2 * c_r * rear) * r
        + (mu * m / (inertia * (lr + lf))) * (lr * c_r * rear - lf * c_f * front) * beta
        + (mu * m / (inertia * (lr + lf))) * lf * c_f * front * wheel
    )
    beta_dot = (
        ((mu / (v**2 * (lr + lf))) * (c_r * rear * lr - c_f * front * lf) - 1.0) * r
        - (mu / (v * (lr + lf))) * (c_r * rear + c_f * front) * beta
        + (mu / (v * (lr + lf))) * c_f * front * wheel
    )
    rates = derivative(SINGLE_TRACK, FLOAT, car, state, wheel, accel)
    size = 1.0 + abs(r) * 100.0 / v + 300.0 * (abs(beta) + abs(wheel))
    assert rates.yaw_rate == pytest.approx(r_dot, rel=1e-12, abs=1e-12 * size)
    assert rates.slip_angle == pytest.approx(beta_dot, rel=1e-12, abs=1e-12 * size)
    assert rates.x == v * math.cos(state.yaw + beta)
    assert rates.y == v * math.sin(state.yaw + beta)
    assert (rates.yaw, rates.speed) == (r, accel)


every_chassis = pytest.mark.parametrize("chassis", CHASSIS, ids=lambda chassis: chassis.label)


@every_chassis
@repeatable
@given(first=states, drive=drives)
def test_left_and_right_are_mirror_images(chassis, first, drive):
    def mirrored(s: State[float]) -> State[float]:
        return State(s.x, -s.y, -s.yaw, s.speed, -s.yaw_rate, -s.slip_angle, -s.steer)

    there = run(DEFAULT_CAR, first, drive, chassis)
    turned = [c._replace(steer=-c.steer) for c in drive]
    assert list(map(mirrored, run(DEFAULT_CAR, mirrored(first), turned, chassis))) == there


@every_chassis
@repeatable
@given(
    first=states, drive=drives, turn=st.floats(-3, 3), dx=st.floats(-10, 10), dy=st.floats(-10, 10)
)
def test_the_world_has_no_favourite_place_or_direction(chassis, first, drive, turn, dx, dy):
    def moved(s: State[float]) -> State[float]:
        c, d = math.cos(turn), math.sin(turn)
        return s._replace(x=dx + c * s.x - d * s.y, y=dy + d * s.x + c * s.y, yaw=s.yaw + turn)

    there = run(DEFAULT_CAR, first, drive, chassis)
    elsewhere = run(DEFAULT_CAR, moved(first), drive, chassis)
    for a, b in zip(there, elsewhere, strict=True):
        assert tuple(moved(a)) == pytest.approx(tuple(b), abs=1e-9)


@repeatable
@given(states, drives, st.integers(1, 4))
def test_a_run_may_be_cut_anywhere(first, drive, cut):
    car = DEFAULT_CAR._replace(steer_delay=0.0)
    whole = run(car, first, drive)
    assert run(car, whole[cut], drive[cut:]) == whole[cut:]


# Random formulas: the recorded program gives the floats, its derivatives the differences.

often = settings(derandomize=True, deadline=None, max_examples=150)

UNARY = ("sin", "cos", "atan", "tanh", "absolute", "neg", "exp", "sqrt", "tan")
BINARY = ("add", "sub", "mul", "truediv", "minimum", "maximum")


class Formula(NamedTuple):
    """An operation on formulas; a leaf is an input's number or a constant."""

    op: str
    parts: tuple[Any, ...]


def evaluated(ops: Ops[Any], formula: Any, inputs: Sequence[Any]) -> Any:
    """The formula over one number type, kept where every function is smooth and tame."""
    if isinstance(formula, int):
        return inputs[formula]
    if isinstance(formula, float):
        return inputs[0] * 0.0 + formula
    args = [evaluated(ops, part, inputs) for part in formula.parts]
    match formula.op:
        case "neg":
            return -args[0]
        case "add" | "sub" | "mul":
            return getattr(operator, formula.op)(*args)
        case "truediv":
            return args[0] / (1.0 + args[1] * args[1])
        case "sqrt":
            return ops.sqrt(1.0 + args[0] * args[0])
        case "exp" | "tan":
            return getattr(ops, formula.op)(ops.atan(args[0]) * 0.5)
        case "clip":
            return ops.clip(args[0], -0.5, 0.75)
    return getattr(ops, formula.op)(*args)


def grown(parts: st.SearchStrategy[Any]) -> st.SearchStrategy[Any]:
    def made(op: str, count: int) -> st.SearchStrategy[Formula]:
        return st.tuples(*(parts,) * count).map(lambda chosen: Formula(op, chosen))

    return st.one_of(
        st.sampled_from((*UNARY, "clip")).flatmap(lambda op: made(op, 1)),
        st.sampled_from(BINARY).flatmap(lambda op: made(op, 2)),
        made("where_positive", 3),
    )


constants = st.sampled_from([0.0, -0.0, 1.0, -1.0, 0.3, -2.5])
formulas = st.recursive(st.integers(0, 2) | constants, grown, max_leaves=12)
plain = st.floats(-3.0, 3.0, allow_subnormal=False)
WIDTH = 1e-5
points = st.tuples(plain, plain, plain)


def recorded(formula: Any, *, slopes: bool = False) -> Callable[..., tuple[float, ...]]:
    tape = Tape()
    inputs = [tape.symbol(name) for name in "abc"]
    output = tape.node(evaluated(TAPE, formula, inputs))
    return program(inputs, gradient([(output, 1.0)], inputs) if slopes else [output])


@often
@given(formulas, points)
def test_a_record_gives_the_same_values(formula, point):
    expected = evaluated(FLOAT, formula, point)
    near = [evaluated(FLOAT, formula, [v + d for v in point]) for d in (1e-9, -1e-9)]
    size = max(map(abs, (expected, *near)))
    assume(size < 1e6)
    assume(all(abs(n - expected) < 1e-6 * (1.0 + size) for n in near))  # a jump of where_positive
    (found,) = recorded(formula)(*point)
    assert found == pytest.approx(expected, rel=1e-9, abs=1e-9)


@often
@given(formulas, points)
def test_gradients_are_those_of_central_differences(formula, point):
    slopes = recorded(formula, slopes=True)
    found = slopes(*point)
    for i in range(3):
        ends = [[v + s * (k == i) for k, v in enumerate(point)] for s in (WIDTH, -WIDTH)]
        wide, narrow = (difference(formula, point, i, width) for width in (WIDTH, WIDTH / 2.0))
        size = 1.0 + max(abs(v) for v in (*found, wide))
        assume(size < 1e4)
        # No seam near: there differences and slopes barely change from place to place.
        assume(abs(wide - narrow) < 1e-3 * size)
        assume(all(abs(slopes(*end)[i] - found[i]) < 1e-3 * size for end in ends))
        assert found[i] == pytest.approx(wide, abs=2e-3 * size)


def difference(formula: Any, point: Sequence[float], i: int, width: float) -> float:
    """Central difference along input `i`."""
    ends = [[v + s * (k == i) for k, v in enumerate(point)] for s in (width, -width)]
    high, low = (float(evaluated(FLOAT, formula, end)) for end in ends)
    return (high - low) / (2.0 * width)


# Projection against a brute-force search on a fine resampling.

PATHS = {spec: parse_path(spec) for spec in ("circle:radius=1.3", "figure8", "line:length=5")}


def point_beside(path: Path, s: float, offset: float) -> tuple[float, float]:
    i = min(int(s / path.step), len(path.x) - 1)
    yaw = path.yaw[i]
    return path.x[i] - offset * math.sin(yaw), path.y[i] + offset * math.cos(yaw)


def brute_distance(path: Path, x: float, y: float) -> float:
    """Distance to the polygon through the samples (within k step^2 / 8 of the curve)."""
    points = np.column_stack([path.x, path.y])
    ends = np.roll(points, -1, axis=0) if path.closed else points[1:]
    points = points[: len(ends)]
    along = ends - points
    share = np.einsum("ij,ij->i", np.array([x, y]) - points, along) / np.sum(along**2, axis=1)
    nearest = points + np.clip(share, 0.0, 1.0)[:, None] * along
    return float(np.linalg.norm(np.array([x, y]) - nearest, axis=1).min())


@pytest.mark.parametrize("spec", PATHS)
@settings(max_examples=60, deadline=None, derandomize=True)
@given(share=st.floats(0.0, 0.999), offset=st.floats(-0.5, 0.5))
def test_offset_equals_brute_force(spec, share, offset):
    path = PATHS[spec]
    x, y = point_beside(path, share * path.length, offset)
    seen = locate(path, x, y)
    assert seen.distance == pytest.approx(brute_distance(path, x, y), abs=6e-5)
    assert abs(seen.e1) == pytest.approx(seen.distance, abs=1e-12)


@pytest.mark.parametrize("spec", PATHS)
@settings(max_examples=60, deadline=None, derandomize=True)
@given(share=st.floats(0.05, 0.95), offset=st.floats(-0.5, 0.5), behind=st.integers(-12, 12))
def test_the_hint_does_not_matter(spec, share, offset, behind):
    path = PATHS[spec]
    x, y = point_beside(path, share * path.length, offset)
    index = int(share * path.length / path.step)
    near = project(path, x, y, index)
    far = project(path, x, y, (index + behind) % len(path.x))
    assert far.e1 == pytest.approx(near.e1, abs=1e-6)
    assert (far.s - near.s + 1.0) % path.length == pytest.approx(1.0, abs=1e-4)
