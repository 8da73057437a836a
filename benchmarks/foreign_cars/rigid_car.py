"""What can be drawn of, and be wrong with, a car of rigid wheels that slide by Coulomb friction."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from benchmarks.blind_gap.effects import Values


@dataclass(frozen=True, slots=True)
class RigidCar:
    """Friction of the tyres, payload [kg], share of yaw inertia, drag [1/s], slope of the floor."""

    mu: float
    payload: float = 0.0
    inertia: float = 1.0
    drag: float = 0.0
    slope_x: float = 0.0
    slope_y: float = 0.0


EFFECTS: Mapping[str, Callable[[RigidCar, Values], RigidCar]] = {
    "tyre_friction": lambda car, v: replace(car, mu=v["ratio"] * car.mu),
    "mass": lambda car, v: replace(car, payload=car.payload + v["payload"]),
    "yaw_inertia": lambda car, v: replace(car, inertia=v["ratio"] * car.inertia),
    "rolling_drag": lambda car, v: replace(car, drag=car.drag + v["drag"]),
    "floor_slope": lambda car, v: replace(car, slope_x=v["x"], slope_y=v["y"]),
}
"""How each effect changes it."""
