"""The compiled filter once more, in Python: the reference that tests hold it against.

The equations are `car_model.prediction`'s, evaluated number by number; the update is filterpy's
extended Kalman filter. No drive loads this.
"""

# Why: docs/decisions/filter-and-controller.md#d8

import math
from bisect import bisect_right
from collections.abc import Mapping, Sequence

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter  # noqa: TID251

from steerd.car_model.chassis import Chassis
from steerd.car_model.params import Car
from steerd.car_model.prediction import (
    LONGEST_STEP_NS,
    MOST_STEPS,
    SIZE,
    STEEPEST,
    ActuatorMotion,
    recorded_piece,
    recorded_step,
)
from steerd.car_model.state import State
from steerd.car_model.tape import Tape, program
from steerd.estimator.compiled import Link, Prediction
from steerd.estimator.config import FilterConfig
from steerd.estimator.history import History, dead_times
from steerd.estimator.initial import SECONDS, Array, Belief, make_belief
from steerd.estimator.sensors import ABSURD, Kind, Measurement, Sensor

_NEVER_NS = 1 << 62


class Reference:
    """As `compiled.Kernel`."""

    def __init__(
        self,
        car: Car[float],
        chassis: Chassis,
        config: FilterConfig,
        sensors: Mapping[Kind, Sensor],
    ) -> None:
        tape = Tape()
        constants = Car(*map(tape.constant, car))
        self._piece = program(*recorded_piece(tape, constants))
        self._step = program(*recorded_step(tape, constants, chassis))
        self._density = config.noise_density
        self._sensors = sensors
        self._late = dead_times(car)

    def drive(
        self, history: History, steer: float, speed: float, start_ns: int, end_ns: int
    ) -> ActuatorMotion:
        """Steering and drive from `start_ns` to `end_ns`, from angle `steer` and `speed`."""
        times, known = history.times, len(history.times)
        steer_late, drive_late = self._late
        turn = bisect_right(times, start_ns - steer_late)
        push = bisect_right(times, start_ns - drive_late)
        so_far: tuple[float, ...] = (steer, 0.0, 0.0, 1.0, 1.0, 0.0)
        begin, steered = start_ns, False
        while begin < end_ns:
            next_turn = times[turn] + steer_late if turn < known else _NEVER_NS
            next_push = times[push] + drive_late if push < known else _NEVER_NS
            end = min(next_turn, next_push, end_ns)
            steering = history.commands[turn - 1] if turn else None
            driving = history.commands[push - 1] if push else None
            steered, driven = steering is not None, driving is not None
            orders = (
                steering.steer if steering else 0.0, float(steered),
                driving.speed if driving else 0.0, float(driven),
            )  # fmt: skip
            so_far = self._piece(*orders, speed, (end - begin) * SECONDS, *so_far)
            turn, push, begin = turn + (next_turn == end), push + (next_push == end), end
        now, turned, gained, by_steer, by_speed, turned_by_steer = so_far
        span = (end_ns - start_ns) * SECONDS
        by = (by_steer, turned_by_steer / span, (by_speed - 1.0) / span)
        return ActuatorMotion(now, turned / span, gained / span, *by, steered)

    def propagate(
        self, state: State[float], driven: ActuatorMotion, density: Sequence[float], h: float
    ) -> tuple[Array, Array, Array]:
        """One step of `h` seconds from a mean, under what the actuators do and noise.

        Gives the mean (7,), its Jacobian by the mean before, and the noise that entered.
        """
        numbers = np.array(self._step(*state, *driven[:-1], *density, h))
        transition, noise = numbers[SIZE:].reshape(2, SIZE, SIZE)
        return numbers[:SIZE], transition, noise

    def predict(self, history: History, first: Belief, start_ns: int, stop_ns: int) -> Prediction:
        """The belief at `stop_ns` from the one of `start_ns`.

        The division into steps depends on the two instants alone, so that fusing the same
        measurements in any order of arrival takes the same steps. In a gap that is too long for
        short steps they grow: what is fast fades in the first ones.
        """
        span = stop_ns - start_ns
        count = min(-(-span // LONGEST_STEP_NS), MOST_STEPS)
        power = 1
        while power < STEEPEST and span > LONGEST_STEP_NS * count**power:
            power += 1
        begin, mean, covariance = start_ns, first.mean, first.covariance
        for i in range(1, count + 1):
            end = start_ns + span * i**power // count**power
            state: State[float] = State(*mean.tolist())
            driven = self.drive(history, state.steer, state.speed, begin, end)
            # a servo that nothing drives stays where it is
            density = (*self._density[:-1], self._density[-1] if driven.steered else 0.0)
            mean, F, Q = self.propagate(state, driven, density, (end - begin) * SECONDS)
            covariance = F @ covariance @ F.T + Q
            begin = end
        return _make_prediction(mean, covariance)

    def fuse(
        self, history: History, first: Belief, start_ns: int, chain: Sequence[Measurement]
    ) -> list[Link]:
        """What each measurement of a chain leaves."""
        links: list[Link] = []
        belief = first
        for measurement in chain:
            prior = self.predict(history, belief, start_ns, measurement.t_ns).belief
            links.append(_update(self._sensors[measurement.kind], prior, measurement.values))
            belief, start_ns = links[-1].belief, measurement.t_ns
        return links


def _update(sensor: Sensor, prior: Belief, values: tuple[float, ...]) -> Link:
    """The belief after a reading, or the prior where it is absurd or refused."""
    measured, width = np.array(values), len(values)
    if not (np.abs(measured) < ABSURD).all():
        return Link(prior, math.inf, False)
    matrix = np.zeros((width, SIZE))
    matrix[range(width), sensor.states] = sensor.gain

    def residual(z: Array, expected: Array) -> Array:
        difference: Array = z - expected
        if sensor.yaw_row is not None:
            difference[sensor.yaw_row] = math.remainder(difference[sensor.yaw_row], math.tau)
        return difference

    box = ExtendedKalmanFilter(SIZE, width)
    box.x, box.P = prior.mean, prior.covariance
    noise = np.diag(sensor.variances)
    box.update(measured, lambda _: matrix, lambda x: matrix @ x, noise, residual=residual)
    nis = float(box.y @ box.SI @ box.y)
    believed = nis <= sensor.gate
    belief = make_belief(box.x, 0.5 * (box.P + box.P.T)) if believed else prior
    return Link(belief, nis, believed)


def _make_prediction(mean: Array, covariance: Array) -> Prediction:
    """A belief is sound if it is finite and its covariance positive definite (Cholesky's test)."""
    variances = covariance.diagonal().tolist()
    sds: State[float] = State(*(math.sqrt(v) if v >= 0.0 else math.nan for v in variances))
    (a, b), (_, c) = covariance[:2, :2].tolist()
    worst = 0.5 * (a + c) + math.hypot(0.5 * (a - c), b)
    sound = bool(np.isfinite([*mean, *variances]).all())
    try:
        np.linalg.cholesky(covariance)
    except np.linalg.LinAlgError:
        sound = False
    position_sd = math.sqrt(worst) if worst >= 0.0 else math.nan
    belief = make_belief(mean, covariance)
    return Prediction(belief, State(*mean.tolist()), sds, position_sd, sound)
