"""The plants, behind one interface: `drive(plant, commands, seed) -> Log`."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from importlib.util import find_spec
from typing import Generic, Protocol, TypeVar

import numpy as np

from benchmarks.blind_gap.effects import Place, Values
from benchmarks.foreign_cars.drives import Commands
from benchmarks.foreign_cars.effects import WIRED, WIRED_OUTSIDE
from benchmarks.foreign_cars.log import Log
from benchmarks.foreign_cars.own import make_own
from benchmarks.foreign_cars.wiring import Array, Orders, Wiring, make_orders, make_push, observe

Random = np.random.Generator
C = TypeVar("C")


class Plant(Protocol):
    """A car with whatever is wrong with it."""

    @property
    def effects(self) -> frozenset[str]:
        """Effects of the contract that it can have."""

    @property
    def outside(self) -> frozenset[str]:
        """Defects outside the contract that it can have."""

    @property
    def truth(self) -> Values:
        """Lengths, inertia and cornering force per load, as far as they mean something."""

    def with_effect(self, name: str, values: Values) -> "Plant":
        """The car with an effect."""

    def with_outside(self, name: str, strength: float, place: Place) -> "Plant":
        """The car with a defect."""

    def drive(self, commands: Commands, rng: Random) -> Log:
        """Drive it and record."""


@dataclass(frozen=True, slots=True)
class WiredPlant(Generic[C]):
    """A car behind the wiring of these plants; what is wrong is wrong with the one or the other."""

    car: C
    wiring: Wiring
    own: Mapping[str, Callable[[C, Values], C]]  # effects of the car itself
    measure: Callable[[C], Values]  # its lengths [m]
    # Gives rows x, y, yaw of the centre of gravity and the driven wheels' surface speed [m/s]
    simulate: Callable[[C, Wiring, Orders, Array, Array], tuple[Array, Array]]

    @property
    def effects(self) -> frozenset[str]:
        """See `Plant.effects`."""
        return frozenset(WIRED) | frozenset(self.own)

    @property
    def outside(self) -> frozenset[str]:
        """See `Plant.outside`."""
        return frozenset(WIRED_OUTSIDE)

    @property
    def truth(self) -> Values:
        """Lengths [m]."""
        return self.measure(self.car)

    def with_effect(self, name: str, values: Values) -> "WiredPlant[C]":
        """See `Plant.with_effect`."""
        if name in WIRED:
            return replace(self, wiring=WIRED[name](self.wiring, values))
        return replace(self, car=self.own[name](self.car, values))

    def with_outside(self, name: str, strength: float, place: Place) -> "WiredPlant[C]":
        """See `Plant.with_outside`."""
        return replace(self, wiring=self.wiring._replace(**{WIRED_OUTSIDE[name]: strength}))

    def drive(self, commands: Commands, rng: Random) -> Log:
        """See `Plant.drive`."""
        orders = make_orders(self.wiring, commands, rng)
        push = make_push(commands, rng)
        path, rolling = self.simulate(self.car, self.wiring, orders, push.process, commands.start)
        return observe(self.wiring, commands, path, rolling, push.pose, rng)


class MissingPlantError(RuntimeError):
    """The plant's package is not installed."""


def _mujoco(contact: bool) -> Callable[[Random], Plant]:
    def make(rng: Random) -> Plant:
        from benchmarks.foreign_cars.mujoco_car import make_mujoco

        return make_mujoco(contact, rng)

    return make


def _commonroad(rng: Random) -> Plant:
    from benchmarks.foreign_cars.commonroad_car import make_commonroad

    return make_commonroad(rng)


def _bullet(rng: Random) -> Plant:
    from benchmarks.foreign_cars.bullet_car import make_bullet

    return make_bullet(rng)


def _box2d(rng: Random) -> Plant:
    from benchmarks.foreign_cars.box2d_car import make_box2d

    return make_box2d(rng)


def _racecar(rng: Random) -> Plant:
    from benchmarks.foreign_cars.racecar import make_racecar

    return make_racecar(rng)


_MAKERS: dict[str, tuple[str, Callable[[Random], Plant]]] = {
    "own": ("numba", make_own),
    "mujoco": ("mujoco", _mujoco(False)),
    "mujoco-contact": ("mujoco", _mujoco(True)),
    "commonroad": ("vehiclemodels", _commonroad),
    "bullet": ("pybullet", _bullet),
    "box2d": ("Box2D", _box2d),
    "racecar": ("safety_gymnasium", _racecar),
}
PLANTS = tuple(_MAKERS)


def make_plant(name: str, seed: int) -> Plant:
    """A healthy car of a plant; the seed is the car.

    Args:
        name: one of `PLANTS`.
        seed: which car.

    Raises:
        MissingPlantError: its package is not installed.
    """
    package, make = _MAKERS[name]
    if find_spec(package) is None:
        raise MissingPlantError(f"plant {name} needs {package}: pip install --group foreign")
    return make(np.random.default_rng([PLANTS.index(name), seed]))


def drive(plant: Plant, commands: Commands, seed: int) -> Log:
    """Drive a car and record; the seed is all that is random in it.

    Args:
        plant: the car.
        commands: wheel angle and speed at 100 Hz.
        seed: of disturbances, noise and failures.
    """
    return plant.drive(commands, np.random.default_rng(seed))
