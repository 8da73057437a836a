"""Plant a: the blind test's four wheels with all of their structure (`mismatch` 1)."""

from dataclasses import dataclass, replace

import numpy as np

from benchmarks.blind_gap.car import PlantCar, make_car, wheel_inertia
from benchmarks.blind_gap.drives import LEAD, make_noise, make_spells
from benchmarks.blind_gap.effects import EFFECTS, OUTSIDE, Place, Values
from benchmarks.blind_gap.plant import STEP, TICK, Orders, motor_speed, simulate
from benchmarks.foreign_cars.drives import LEAD_TICKS, Commands
from benchmarks.foreign_cars.log import Log

_MISMATCH = 1.0
_WHEEL_SD = 0.01


@dataclass(frozen=True, slots=True)
class OwnPlant:
    """The blind test's plant.

    Attributes:
        car: its numbers.
        freeze: length of the servo's freezes [s].
        cut: length of the motor's drop-outs [s].
        jitter: standard deviation of the poses' stamps [s].
    """

    car: PlantCar
    freeze: float = 0.0
    cut: float = 0.0
    jitter: float = 0.0

    @property
    def effects(self) -> frozenset[str]:
        """Effects that it can have."""
        return frozenset(EFFECTS)

    @property
    def outside(self) -> frozenset[str]:
        """Defects outside the library that it can have."""
        return frozenset(OUTSIDE)

    @property
    def truth(self) -> Values:
        """Lengths [m], yaw inertia [kg m^2], cornering force per load and slip angle [1/rad]."""
        car = self.car
        return {
            "lf": car.lf,
            "lr": car.lr,
            "inertia_z": car.inertia_z + wheel_inertia(car),
            "front": car.mu * car.stiff_front,
            "rear": car.mu * car.stiff_rear,
        }

    def with_effect(self, name: str, values: Values) -> "OwnPlant":
        """The car with an effect of the contract."""
        return replace(self, car=EFFECTS[name].apply(self.car, values))

    def with_outside(self, name: str, strength: float, place: Place) -> "OwnPlant":
        """The car with a defect that no effect describes."""
        kind = OUTSIDE[name]
        return OwnPlant(
            kind.apply(self.car, strength, place),
            kind.freeze * strength,
            kind.cut * strength,
            kind.jitter * strength,
        )

    def drive(self, commands: Commands, rng: np.random.Generator) -> Log:
        """Drive it and record."""
        seconds = (commands.steps - LEAD) * STEP
        held, cut = (
            make_spells(seconds, v, e, rng) for v, e in ((self.freeze, 1.5), (self.cut, 3.0))
        )
        noise, none = make_noise(seconds, rng, process_scale=commands.push), np.zeros((0, 3))
        orders = Orders(commands.steer, commands.speed, none, 0.0, held, cut)
        trace = simulate(self.car, commands.start, LEAD, orders, noise)
        ticks = slice(LEAD_TICKS, None)
        states = trace.states[::TICK][ticks]
        turned = np.array([motor_speed(self.car, state) for state in states])
        believed = turned / (self.car.wheel_scale * self.car.speed_gain)
        t = np.arange(len(states)) * TICK * STEP
        stamps = np.sort(t + self.jitter * rng.standard_normal(len(t)))
        return Log(
            stamps - min(stamps[0], 0.0),
            trace.poses[ticks],
            trace.commands[ticks],
            believed + _WHEEL_SD * rng.standard_normal(len(t)),
        )


def make_own(rng: np.random.Generator) -> OwnPlant:
    """A healthy car."""
    return OwnPlant(make_car(rng, _MISMATCH))
