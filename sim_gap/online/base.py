"""A learner for a car file, whether or not it was identified."""

from dataclasses import replace

from steerd.car_model.car_file import CarFile
from steerd.sim_gap.online.learner import Learner
from steerd.sim_gap.online.memory import Memory, remember
from steerd.sysid.inference.chart import RELATIVE
from steerd.sysid.inference.noise import noise_of_section
from steerd.sysid.inference.space import FLOORS, LIMITS
from steerd.sysid.inference.superset import Superset, make_superset

NOT_IDENTIFIED = 20.0
"""Standard errors of a car file that gives none, per the least that any car's are: a tenth of a
stiffness, 0.01 rad of a bias. The first half minute of a drive identifies most of them."""
MEASURED = {"lf": 2.5, "lr": 2.5, "steer_gain": 8.0, "c_x": 2.0}
"""The same for what a ruler, a protractor or the class of the car gives better: along the valley of
a longer car that steers more (see `chart`) a lane would pull them to where no car is."""


def make_learner(car: CarFile, ramp: float = 0.0, memory: Memory | None = None) -> Learner:
    """A learner about a car file.

    Args:
        car: as identified, or its figures as published.
        ramp: limit of the motor controller's setpoint [m/s^2], 0 for none.
        memory: of an earlier drive of this car.

    Raises:
        ValueError: what identify wrote into the file is not what it writes.
    """
    superset = make_superset(car, ())
    if superset.knowledge is None and not superset.sd:
        superset = replace(superset, sd=_published(superset))
    remembered = remember(superset, memory) if memory is not None else ()
    return Learner(superset, noise_of_section(car.sections.get("noise", {})), ramp, remembered)


def _published(superset: Superset) -> dict[str, float]:
    """Standard errors of figures that were published for another car of the class."""
    names = superset.kernels.names
    values = {name: abs(float(superset.base[names.index(name)])) for name in FLOORS}
    return {
        name: MEASURED.get(name, NOT_IDENTIFIED)
        * floor
        * (values[name] if name in RELATIVE else 1.0)
        for name, floor in FLOORS.items()
        if name not in LIMITS
    }
