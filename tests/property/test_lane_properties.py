"""Lane errors: their rates are their derivatives, and they know neither place nor side."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from steerd.car_model.chassis import derivative
from steerd.car_model.ops import FLOAT
from steerd.car_model.params import DEFAULT_CAR
from steerd.car_model.path.path import Path, project
from steerd.car_model.path.path_spec import parse_path
from steerd.car_model.single_track import SINGLE_TRACK
from steerd.car_model.state import State
from steerd.controller.lane_keeper import LaneErrors, lane_errors

EIGHT = parse_path("figure8")
LEFT, RIGHT = parse_path("circle:radius=1.4"), parse_path("circle:radius=-1.4")

SHARES = st.floats(0.05, 0.95)
OFFSETS = st.floats(-0.3, 0.3)
HEADINGS = st.floats(-0.8, 0.8)
SPEEDS = st.floats(0.0, 4.0)
YAW_RATES = st.floats(-3.0, 3.0)
SLIPS = st.floats(-0.2, 0.2)


def beside(path: Path, share: float, e1: float, e2: float) -> tuple[int, float, float, float]:
    i = int(share * len(path.x))
    yaw = path.yaw[i]
    return i, path.x[i] - e1 * math.sin(yaw), path.y[i] + e1 * math.cos(yaw), yaw + e2


def errors_at(path: Path, state: State[float], hint: int) -> LaneErrors:
    return lane_errors(state, project(path, state.x, state.y, hint))


@settings(max_examples=100, deadline=None, derandomize=True)
@given(SHARES, OFFSETS, HEADINGS, SPEEDS, YAW_RATES, SLIPS)
def test_rates_are_the_derivatives_of_the_errors(share, e1, e2, speed, yaw_rate, slip):
    hint, x, y, yaw = beside(EIGHT, share, e1, e2)
    state = State(x, y, yaw, speed, yaw_rate, slip, 0.0)
    rates = derivative(SINGLE_TRACK, FLOAT, DEFAULT_CAR, state, 0.0, 0.0)
    h = 1e-3

    def moved(by: float) -> LaneErrors:
        there = state._replace(x=x + by * rates.x, y=y + by * rates.y, yaw=yaw + by * rates.yaw)
        return errors_at(EIGHT, there, hint)

    before, now, after = moved(-h), errors_at(EIGHT, state, hint), moved(h)
    assert now.e1_rate == pytest.approx((after.e1 - before.e1) / (2.0 * h), abs=2e-3)
    assert now.e2_rate == pytest.approx((after.e2 - before.e2) / (2.0 * h), abs=2e-2)


@settings(max_examples=50, deadline=None, derandomize=True)
@given(SHARES, OFFSETS, HEADINGS, SPEEDS, YAW_RATES, SLIPS)
def test_left_is_the_mirror_image_of_right(share, e1, e2, speed, yaw_rate, slip):
    hint, x, y, yaw = beside(LEFT, share, e1, e2)
    left = errors_at(LEFT, State(x, y, yaw, speed, yaw_rate, slip, 0.0), hint)
    right = errors_at(RIGHT, State(x, -y, -yaw, speed, -yaw_rate, -slip, 0.0), hint)
    assert right == pytest.approx(tuple(-value for value in left), abs=1e-9)
