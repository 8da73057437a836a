"""One compiled car that holds every effect of the library, each at its null.

At its nulls an effect changes nothing, bit for bit, so every hypothesis is a choice of which
parameters of this one car are free: one compilation serves all candidates and all their pairs.
"""

# Why: docs/decisions/diagnosis.md#d30

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from steerd.car_model.car_file import CarFile
from steerd.car_model.effect import Effect
from steerd.car_model.effects import EFFECTS
from steerd.car_model.model import Model
from steerd.car_model.native.windows import Kernels, make_kernels, parameter_vector
from steerd.car_model.params import Car
from steerd.car_model.planar import make_planar
from steerd.sysid.data.dataset import Run
from steerd.sysid.inference import constants as c
from steerd.sysid.inference.knowledge import Knowledge, knowledge_of_section

Array = NDArray[np.float64]

NO_SLIP = 1e6
"""Slip stiffness of wheels that turn as fast as the ground passes, to a tenth of a millimetre."""


@dataclass(frozen=True, eq=False)
class Superset:
    """The base car with every effect of the library switched on at its null.

    Attributes:
        kernels: the compiled car.
        base: (P,) parameters of the base; an effect that the base has keeps its values.
        nulls: what each effect's parameters are when it is not a hypothesis: the base's values.
        sd: standard errors of the base by parameter name, as far as they are known.
        knowledge: the joint covariance that healthy drives gave it, if they did.
        wheelbase: measured distance of the axles [m]: of `lf` and `lr`, one follows from the other.
    """

    kernels: Kernels
    base: Array
    nulls: dict[str, tuple[float, ...]]
    sd: dict[str, float]
    knowledge: Knowledge | None = None
    wheelbase: float | None = None

    @property
    def effects(self) -> tuple[Effect, ...]:
        """Every effect, in the order of the parameters."""
        return self.kernels.effects

    def places(self, effect: str) -> list[int]:
        """Indices of an effect's parameters."""
        names = self.kernels.names
        return [i for i, name in enumerate(names) if name.startswith(f"{effect}.")]


def prescribe_speed(model: Model[float], runs: Sequence[Run]) -> Model[float]:
    """The car whose speed follows a measured speed at once, where there is no command to explain.

    A speed from poses is the body's and not the wheels': no slip lies between, and no driven front
    axle rolls along its own wheels.
    """
    sources = {run.speed_source for run in runs}
    if sources <= {"command"}:
        return model
    car: Car[float] = model.car._replace(
        speed_lag=0.0, drive_delay=0.0, accel_max=1e3, decel_max=1e3
    )
    if sources == {"pose"} and model.chassis.drive:
        return model._replace(car=car._replace(c_x=NO_SLIP), chassis=make_planar("rear"))
    return model._replace(car=car)


def make_superset(base: CarFile | Model[float], runs: Sequence[Run]) -> Superset:
    """The superset about a base car.

    Where a run has no speed command its measured speed is prescribed. The acceleration of a
    measured speed is mostly noise, so loads and slip do not follow it then.
    """
    sd = dict(base.sd) if isinstance(base, CarFile) else {}
    given = base.model if isinstance(base, CarFile) else base
    model, stated = prescribe_speed(given, runs), set[str]()
    own = dict(zip((e.name for e in model.effects), model.values, strict=True))
    if any(run.speed_source != "command" for run in runs):
        model = model._replace(car=model.car._replace(cog_height=0.0))
        pairs = zip(Car._fields, model.car, given.car, strict=True)
        stated = {name for name, now, before in pairs if now != before}
        stated |= {e.name for e in EFFECTS.values() if e.follows_acceleration}
        own = {name: values for name, values in own.items() if name not in stated}
    effects = tuple(EFFECTS.values())
    nulls = {e.name: own.get(e.name, e.nulls) for e in effects}
    values = tuple(nulls[e.name] for e in effects)
    full: Model[float] = Model(Car(*model.car), effects, values, model.chassis)
    kernels = make_kernels(effects, model.chassis)
    return _known(Superset(kernels, parameter_vector(full), nulls, sd), base, stated)


def _known(superset: Superset, base: CarFile | Model[float], stated: Collection[str]) -> Superset:
    """The superset about what the base's healthy drives taught, if that is known.

    What a prescribed speed states, of parameters or effects, stays.

    Raises:
        ValueError: the base's `knowledge` is not what identify writes.
    """
    if not isinstance(base, CarFile):
        return superset
    known = knowledge_of_section(base.sections.get("knowledge", {}))
    if known is None:
        return superset
    names, parameters = superset.kernels.names, superset.base.copy()
    for name, value in zip(known.names, known.values, strict=False):
        if name.partition(".")[0] in stated:
            continue
        parameters[names.index(name)] = value
    nulls = {e.name: tuple(parameters[superset.places(e.name)].tolist()) for e in superset.effects}
    known = replace(known, covariance=c.KNOWN_WIDER**2 * known.covariance)
    return replace(superset, base=parameters, nulls=nulls, knowledge=known)
