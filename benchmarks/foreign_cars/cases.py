"""Cases: a car, two healthy drives of it, and three later ones with something hidden."""

import hashlib
import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.blind_gap.effects import EFFECTS, Place, draw_place
from benchmarks.foreign_cars.drives import PUSH, SECONDS, Commands, make_commands
from benchmarks.foreign_cars.effects import label_of, strength_of
from benchmarks.foreign_cars.log import MAP, Log, write_csv
from benchmarks.foreign_cars.plants import PLANTS, Plant, drive, make_plant

Json = dict[str, Any]

HEALTHY, LATER = 2, 3
_CELL = 2.0
"""Grid on which the most driven place is looked for [m]."""


@dataclass(frozen=True, slots=True)
class Case:
    """One case; everything follows from it.

    Attributes:
        plant: one of `PLANTS`.
        seed: which car, and its healthy drives.
        number: which case of that car: its later drives.
        hidden: effects or one defect, each with its size; empty if nothing is wrong.
        temper: of all its drives.
        seconds: length of each drive.
        push: disturbances, per those of the blind test.
    """

    plant: str
    seed: int
    number: int = 0
    hidden: tuple[tuple[str, str], ...] = ()
    temper: str = "rich"
    seconds: float = SECONDS
    push: float = PUSH

    @property
    def name(self) -> str:
        """A name that does not show what is hidden."""
        return hashlib.sha256(json.dumps(asdict(self)).encode()).hexdigest()[:12]

    @property
    def car(self) -> str:
        """Name of the car and its healthy drives, shared by all of its cases."""
        return f"{self.plant}-{self.seed}-{self.temper}-{self.seconds:g}-{self.push:g}"

    @property
    def kind(self) -> str:
        """`null`, `single`, `pair` or `outside`."""
        if not self.hidden:
            return "null"
        if self.hidden[0][0] not in EFFECTS:
            return "outside"
        return "single" if len(self.hidden) == 1 else "pair"


def read_case(row: Json) -> Case:
    """A case from its row of a list."""
    return Case(**{**row, "hidden": tuple((str(n), str(s)) for n, s in row["hidden"])})


def _seeds(case: Case, what: str, index: int) -> tuple[np.random.Generator, int]:
    """Source of one drive's manoeuvres, and the seed of its noise."""
    words = [PLANTS.index(case.plant), case.seed, {"healthy": 1, "later": 2}[what], index]
    if what == "later":
        words.append(case.number)
    plan, noise = np.random.SeedSequence(words).spawn(2)
    return np.random.default_rng(plan), int(noise.generate_state(1)[0])


def _commands(case: Case, what: str, index: int) -> tuple[Commands, int]:
    rng, seed = _seeds(case, what, index)
    return make_commands(case.temper, case.seconds, rng, case.push), seed


def healthy_logs(case: Case) -> list[Log]:
    """Drives of the car with nothing wrong."""
    plant = make_plant(case.plant, case.seed)
    return [drive(plant, *_commands(case, "healthy", i)) for i in range(HEALTHY)]


def _most_driven(logs: list[Log]) -> tuple[float, float]:
    """Middle of the cell of the floor in which the drives spent most time [m]."""
    places = np.concatenate([log.poses[:, :2] for log in logs])
    cells, counts = np.unique(np.round(places / _CELL), axis=0, return_counts=True)
    x, y = cells[int(np.argmax(counts))] * _CELL
    return float(x), float(y)


def _needs_place(name: str) -> bool:
    return name in ("grip_patch", "moving_patch")


def _place(case: Case, plant: Plant, orders: list[tuple[Commands, int]]) -> Place:
    """Sign, direction and spot of what is hidden; the spot lies where the car drives."""
    words = [PLANTS.index(case.plant), case.seed, 3, case.number]
    place = draw_place(np.random.default_rng(words))
    if not any(_needs_place(name) for name, _ in case.hidden):
        return place
    x, y = _most_driven([drive(plant, *order) for order in orders])
    return Place(place.sign, place.angle, x, y)


def hide(plant: Plant, case: Case, place: Place) -> tuple[Plant, list[Json]]:
    """The car with what is hidden in the case, and the labels.

    Raises:
        KeyError: the plant does not have the effect or defect.
    """
    labels = []
    for name, size in case.hidden:
        values = label_of(name, size, place)
        strength = strength_of(name, size)
        if name in EFFECTS:
            plant = plant.with_effect(name, values)
        else:
            plant = plant.with_outside(name, strength, place)
        labels.append({"effect": name, "size": size, "strength": strength, "parameters": values})
    return plant, labels


def later_logs(case: Case) -> tuple[list[Log], list[Json]]:
    """Drives of the car with the hidden effects, and their labels."""
    plant = make_plant(case.plant, case.seed)
    orders = [_commands(case, "later", i) for i in range(LATER)]
    ill, labels = hide(plant, case, _place(case, plant, orders))
    return [drive(ill, *order) for order in orders], labels


def write_logs(folder: Path, stem: str, logs: list[Log]) -> list[Path]:
    """Write drives as tables with their import map.

    Raises:
        OSError: the folder does not take them.
    """
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "map.toml").write_text(MAP)
    paths = [folder / f"{stem}-{i}.csv" for i in range(1, len(logs) + 1)]
    for path, log in zip(paths, logs, strict=True):
        write_csv(path, log)
    return paths
