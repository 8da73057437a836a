"""Logs of a fleet over weeks, some cars of which change on a day that no one knows beforehand.

Drives of 20 s come from the compiled simulator with mocap noise and are imported like a lab's own
logs, with the time of day of their recording; the cars differ from each other as real ones do.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from steerd.car_model.car_file import default_car_path, load_car
from steerd.car_model.native.windows import (
    STATES,
    HeldCommands,
    make_kernels,
    make_window_blocks,
    march,
    parameter_vector,
    view_by_window,
)
from steerd.car_model.params import DEFAULT_CAR, Car
from steerd.daemon.imports.csv_log import import_csv
from steerd.daemon.imports.import_map import load_map

STEP, SECONDS, DAY = 0.01, 20.0, 86_400.0
FIRST = 1_772_366_400.0
"""Noon of the first day: 2026-03-01 [UNIX s]."""
NOISE = (3e-4, 3e-4, 1e-3)
"""Of a pose [m, m, rad]."""
SPREAD = {"steer_gain": 0.04, "steer_bias": 0.01, "c_sf": 0.3, "speed_gain": 0.02}
MAP = """[columns]
t = "t"
x = "x"
y = "y"
yaw = "yaw"
steer_cmd = "steer"
speed_cmd = "speed"
[session]
car = "{car}"
"""


class Hidden(NamedTuple):
    """What happens to a car: from a day on, a parameter is larger by so much."""

    car: str
    parameter: str
    day: int
    step: float


def make_car(name: str, seed: int) -> Car[float]:
    """A car of the fleet."""
    rng = np.random.default_rng([seed, *name.encode()])
    own = {key: getattr(DEFAULT_CAR, key) + sd * rng.normal() for key, sd in SPREAD.items()}
    return DEFAULT_CAR._replace(**own)


def make_log(car: Car[float], begin: float, seed: list[int]) -> NDArray[np.float64]:
    """Rows of time, pose with noise, and commands."""
    rng = np.random.default_rng(seed)
    t = STEP * np.arange(round(SECONDS / STEP))
    chirp = np.sin(rng.uniform(1.0, 1.6) * t + 0.1 * t * t + rng.uniform(0.0, 6.0))
    speed = 1.6 + 0.5 * np.sin(rng.uniform(0.4, 0.7) * t)
    commands = np.column_stack([rng.uniform(0.17, 0.23) * chirp, speed])
    blocks = make_window_blocks(np.array([[0, len(t), 0]]), np.zeros(1))
    model = load_car(default_car_path()).model._replace(car=car)  # its tyres level off
    kernels, held = make_kernels(model.effects, model.chassis), HeldCommands(commands, STEP)
    first = np.zeros((1, STATES + kernels.memory))
    first[0, 3] = 1.0
    path = march(kernels, parameter_vector(model), first, held, blocks, len(t))
    poses = view_by_window(path, 1)[0, :-1, :3] + rng.normal(0.0, NOISE, (len(t), 3))
    return np.column_stack([begin + t, poses, commands])


def make_fleet(
    folder: Path, cars: int, days: int, hidden: tuple[Hidden, ...], seed: int = 0
) -> list[Path]:
    """One session of each car on each day; a folder for each car."""
    written = []
    for number in range(cars):
        name = f"car{number + 1}"
        home = folder / name
        home.mkdir(parents=True, exist_ok=True)
        the_map = home / "map.toml"
        the_map.write_text(MAP.format(car=name))
        for day in range(days):
            car = make_car(name, seed)
            for change in hidden:
                if change.car == name and day >= change.day:
                    value = getattr(car, change.parameter) + change.step
                    car = car._replace(**{change.parameter: value})
            table, out = home / "log.csv", home / f"day{day:02}.mcap"
            rows = make_log(car, FIRST + day * DAY, [seed, number, day])
            header = "t,x,y,yaw,steer,speed"
            np.savetxt(table, rows, "%.9f", ",", header=header, comments="")
            import_csv(table, load_map(the_map), out, lambda done: None)
            table.unlink()
            written.append(out)
        the_map.unlink()
    return written
