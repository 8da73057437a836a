"""Lane keeping with controllers designed from different parameters, on the same simulated car.

The paper's last figures: a controller is only as good as the parameters that it was designed from.
State feedback is exact, so that only the design differs.
"""

from collections.abc import Mapping
from itertools import product
from typing import NamedTuple

import numpy as np

from steerd.car_model.model import Model, Moment, delays
from steerd.car_model.ops import FLOAT
from steerd.car_model.params import Car
from steerd.car_model.path.path_spec import make_figure_eight
from steerd.car_model.rollout import arriving, step
from steerd.car_model.state import ORIGIN, Command
from steerd.controller.build import make_controller
from steerd.controller.config import ControllerConfig
from steerd.controller.design import DesignRefused
from steerd.controller.lane_controller import LaneController, control, start_controller
from steerd.sysid.data.data_checks import Array

STEP = 0.01  # control period [s]
SECONDS = 15.0  # length of a drive [s]
SPEED = 2.0  # greatest speed [m/s]
RADIUS = 1.8  # of the figure eight's circles [m]
OFFSET = 0.15  # first distance from the path [m]
OFFSET_MAX = 2.0  # at a greater lateral error the car has left its lane, and the drive ends [m]
FRICTIONS: Mapping[str, float] = {"standard": 1.0, "low": 0.5}


class Profile(NamedTuple):
    """One controlled drive."""

    design: str  # whose parameters the controller was designed from
    friction: str  # which floor
    rows: Array  # time [s], lateral offset e1 [m] and heading error e2 [rad], (N, 3)
    refused: str = ""  # why there is no drive; empty otherwise

    @property
    def rms(self) -> float:
        """Of the lateral offset [m]."""
        return float(np.sqrt(np.mean(self.rows[:, 1] ** 2))) if len(self.rows) else float("nan")


def drive_lane(controller: LaneController, plant: Car[float]) -> Array:
    """Time, e1 and e2 (N, 3) of a drive; ends early where the car leaves its lane."""
    model: Model[float] = Model(plant)
    moment = Moment(ORIGIN._replace(y=OFFSET, speed=1.0))
    now = start_controller(controller, moment.state, 0)
    commands, late, rows = [Command(0.0, 1.0)], delays(model), []
    for k in range(round(SECONDS / STEP)):
        t_ns = round(k * STEP * 1e9)
        command, report, now = control(controller, now, moment.state, t_ns)
        commands.append(command)
        rows.append((k * STEP, report.e1, report.e2))
        taken = arriving(commands, k + 1, late, STEP)
        moment = step(FLOAT, model, moment, taken, k * STEP, STEP)
        if not abs(report.e1) < OFFSET_MAX:
            break
    return np.array(rows)


def compare_designs(plant: Car[float], designs: Mapping[str, Car[float]]) -> tuple[Profile, ...]:
    """Drive a figure eight with each design on each floor."""
    path, config = make_figure_eight(RADIUS), ControllerConfig(speed=SPEED)
    found = []
    for (name, car), (floor, share) in product(designs.items(), FRICTIONS.items()):
        try:
            controller = make_controller(car, path, config, 1.0 / STEP)
            rows, why = drive_lane(controller, plant._replace(mu=plant.mu * share)), ""
        except (DesignRefused, ValueError) as error:
            rows, why = np.empty((0, 3)), str(error)
        found.append(Profile(name, floor, rows, why))
    return tuple(found)
