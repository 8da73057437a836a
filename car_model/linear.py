"""The car about straight driving: Rajamani's lane errors, sampled systems.

Everything comes from the exact Jacobian of the single-track equations. About straight driving,
where controllers are designed, every chassis has the same one (tested), so a controller designed
here is designed for the car that is simulated.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from steerd.car_model.native.library import load_function, model_label
from steerd.car_model.params import Car
from steerd.car_model.single_track import SINGLE_TRACK
from steerd.car_model.state import ORIGIN, State

Matrix = NDArray[np.float64]

_YAW_RATE, _SLIP, _WHEEL = 4, 5, 6  # rows and columns of the Jacobian
_TAYLOR_TERMS = 14  # of a matrix whose norm is at most a half: the rest is below 1e-16


class LaneErrorModel(NamedTuple):
    """`d/dt (e1, e1', e2, e2') = a e + b_steer wheel + b_curvature curvature`."""

    a: Matrix  # 4 x 4
    b_steer: Matrix  # 4, per rad of road-wheel angle
    b_curvature: Matrix
    """4, per 1/m of path curvature: Rajamani's B2 (per desired yaw rate) times the speed."""


class Sampled(NamedTuple):
    """`x[k+1] = a x[k] + b u[k - whole] + b_late u[k - whole - 1]`."""

    a: Matrix
    b: Matrix
    b_late: Matrix
    whole: int  # full periods of dead time


def rates_and_jacobian(
    car: Car[float], state: State[float], wheel: float, accel: float
) -> tuple[list[float], Matrix]:
    """Rates of the single-track car's chassis states, and their derivatives.

    Args:
        car: The car's parameters.
        state: Where it is; `state.steer` plays no part (`wheel` does).
        wheel: Road-wheel angle [rad].
        accel: Longitudinal acceleration [m/s^2].

    Returns:
        The six rates, as `chassis.derivative` gives them, and their derivatives (6, 8) by the first
        six states, wheel and acceleration.

    Raises:
        LibraryError: The library was not built.
    """
    p, given, found = np.array(car), np.array([*state, wheel, accel]), np.empty((9, 6))
    tangent = load_function(model_label((), SINGLE_TRACK), "tangent")
    tangent(p.ctypes.data, given.ctypes.data, found.ctypes.data)
    return found[0].tolist(), found[1:].reshape(6, 8)


def lane_error_model(car: Car[float], speed: float) -> LaneErrorModel:
    """Rajamani's error dynamics of the CoG against a path, at constant speed [m/s].

    With `e1' = v (slip + e2)` and `e2' = yaw_rate - v curvature`, the lateral Jacobian gives
    Rajamani, Vehicle Dynamics and Control, eq. 2.45 (there C is per tyre: 2 C is ours per axle).

    Raises:
        ValueError: The speed is not positive.
    """
    if not speed > 0.0:
        raise ValueError(f"lane errors need a positive speed, not {speed}")
    jacobian = rates_and_jacobian(car, ORIGIN._replace(speed=speed), 0.0, 0.0)[1]
    lateral = jacobian[np.ix_([_SLIP, _YAW_RATE], [_SLIP, _YAW_RATE, _WHEEL])].tolist()
    (slip_slip, slip_yaw, slip_steer), (yaw_slip, yaw_yaw, yaw_steer) = lateral
    v = speed
    return LaneErrorModel(
        a=np.array(
            [
                [0.0, 1.0, 0.0, 0.0],
                [0.0, slip_slip, -v * slip_slip, v * (slip_yaw + 1.0)],
                [0.0, 0.0, 0.0, 1.0],
                [0.0, yaw_slip / v, -yaw_slip, yaw_yaw],
            ]
        ),
        b_steer=np.array([0.0, v * slip_steer, 0.0, yaw_steer]),
        b_curvature=np.array([0.0, v * v * slip_yaw, 0.0, v * yaw_yaw]),
    )


def sample(a: Matrix, b: Matrix, period: float, delay: float = 0.0) -> Sampled:
    """Zero-order hold over `period` seconds, its input arriving `delay` seconds late.

    Astrom and Wittenmark, Computer-Controlled Systems, section 2.3.

    Args:
        a: n x n, continuous.
        b: n x m, continuous.
        period: Sampling period [s].
        delay: Dead time of the input [s], any number of periods.

    Raises:
        ValueError: The period is not positive or the delay is negative.
    """
    if not (period > 0.0 and delay >= 0.0):
        raise ValueError(f"cannot sample every {period} s with a delay of {delay} s")
    whole = math.floor(delay / period)
    late = delay - whole * period
    first, held_late = _held(a, b, late)
    rest, held = _held(a, b, period - late)
    return Sampled(rest @ first, held, rest @ held_late, whole)


def _held(a: Matrix, b: Matrix, span: float) -> tuple[Matrix, Matrix]:
    """`exp(a span)` and the integral of `exp(a s) b` over the span (Van Loan)."""
    n, m = b.shape
    block = np.zeros((n + m, n + m))
    block[:n, :n], block[:n, n:] = a, b
    grown = _exponential(block * span)
    return grown[:n, :n], grown[:n, n:]


def _exponential(matrix: Matrix) -> Matrix:
    """By scaling, Taylor's series and squaring; SciPy's takes half a second to load."""
    halvings = max(0, math.frexp(float(np.abs(matrix).sum(axis=1).max(initial=0.0)))[1] + 1)
    part = matrix / 2.0**halvings
    term = total = np.eye(len(matrix))
    for k in range(1, _TAYLOR_TERMS + 1):
        term = term @ part / k
        total = total + term
    for _ in range(halvings):
        total = total @ total
    return total


def augmented(sampled: Sampled) -> tuple[Matrix, Matrix]:
    """The sampled system with its past inputs as states: `(a, b)` of `x, u[k-1], u[k-2], ...`.

    Nothing is added when there is no dead time.
    """
    n, m = sampled.b.shape
    pasts = sampled.whole + (1 if np.any(sampled.b_late) else 0)
    a = np.zeros((n + pasts * m, n + pasts * m))
    b = np.zeros((n + pasts * m, m))
    a[:n, :n] = sampled.a
    for age, effect in ((sampled.whole, sampled.b), (sampled.whole + 1, sampled.b_late)):
        if age == 0:
            b[:n] = effect
        elif age <= pasts:
            a[:n, n + (age - 1) * m : n + age * m] = effect
    if pasts:
        b[n : n + m] = np.eye(m)
        a[n + m :, n : n + (pasts - 1) * m] = np.eye((pasts - 1) * m)
    return a, b
