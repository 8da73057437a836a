"""One compiled car with every effect of the library, each at its null, and what is known of it.

At its nulls an effect changes nothing, bit for bit, so every hypothesis is a choice of which
parameters of this one car are free: one compilation serves all candidates and all their pairs.

Two things beyond the car's values travel from `identify` to `diagnose`, in the file beside the car
file. The joint covariance of the base's coordinates: lengths, gains and inertia move together, and
an effect must not be named for what the base's own uncertainty covers. And what the model misses of
the healthy drives themselves, as a size of the discrepancy and as what each effect explains there.
"""

# Why: docs/decisions/diagnosis.md#d30

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from steerd.car_model.car_file import CarFile
from steerd.car_model.effect import Effect, Role
from steerd.car_model.effects import EFFECTS
from steerd.car_model.model import Model, believed_car
from steerd.car_model.native.windows import Kernels, make_kernels, model_of, parameter_vector
from steerd.car_model.params import Car
from steerd.car_model.planar import make_planar
from steerd.sysid.data.data_checks import Array
from steerd.sysid.data.dataset import Run
from steerd.sysid.inference import constants as c
from steerd.sysid.inference.chart import places_of

NO_SLIP = 1e6  # slip stiffness of wheels as fast as the ground that passes, to 0.1 mm


class Control(NamedTuple):
    """What healthy drives show of an effect.

    A model that is wrong a little everywhere lets an effect explain a little of any drive.
    """

    effect: str  # its name
    values: Array  # (k,) of its parameters that explain healthy drives best; `covariance` (k, k)
    covariance: Array
    gain: float  # what that gains there per window, chance included [nats]


@dataclass(frozen=True, eq=False)
class BasePrior:
    """What is known of a base."""

    names: tuple[str, ...]  # of the base's free parameters, in the coordinates' order (see `chart`)
    covariance: Array  # (n, n) of the coordinates
    values: tuple[float, ...] = ()  # that the covariance lies about; empty: the base's own
    controls: tuple[Control, ...] = ()  # what the healthy drives show of effects
    size: float = 0.0  # of the discrepancy that the healthy drives leave
    # Coordinates of limits, by name, below which the healthy drives rule them out
    least: Mapping[str, float] = field(default_factory=dict)

    def part(self, names: Sequence[str]) -> Array:
        """Covariance of some of the coordinates, in this order."""
        places = [self.names.index(name) for name in names]
        return np.asarray(self.covariance[np.ix_(places, places)])


def inflate_each(covariance: Array, pulls: Array) -> Array:
    """The covariance with each coordinate as wide as its own scores make it, correlations kept.

    This is the sandwich of White (1982), coordinate by coordinate, never narrower than before: with
    about as many coordinates as pieces no direction is separated from chance, but a single
    coordinate's standard error is known from p pieces to one part in sqrt(2 p).

    Args:
        covariance: (n, n) as curvature gives it.
        pulls: (p, n) scores of pieces of driving.
    """
    away, pieces = pulls - pulls.mean(axis=0), max(float(len(pulls)), 2.0)
    scores = away.T @ away * pieces / (pieces - 1.0)
    robust = np.einsum("ij,jk,ik->i", covariance, scores, covariance)
    wider = np.sqrt(np.maximum(robust / np.diag(covariance), 1.0))
    return np.asarray(covariance * np.outer(wider, wider))


def knowledge_section(known: BasePrior) -> dict[str, Any]:
    """The table `knowledge` of the file beside a car file: names, deviations, correlations."""
    sd = np.sqrt(np.diag(known.covariance))
    correlation = known.covariance / np.outer(sd, sd)
    rows = [[round(float(c), 6) for c in row[: i + 1]] for i, row in enumerate(correlation)]
    return {
        "names": list(known.names),
        "sd": [float(f"{v:.6g}") for v in sd],
        "correlation": rows,
        "values": [float(f"{v:.9g}") for v in known.values],
        "controls": {
            one.effect: [
                _rounded(one.values),
                [_rounded(row) for row in one.covariance],
                round(one.gain, 4),
            ]
            for one in known.controls
        },
        "size": known.size,
        "least": dict(known.least),
    }


def _rounded(row: Array) -> list[float]:
    return [float(f"{v:.6g}") for v in row]


def knowledge_of_section(table: Mapping[str, Any]) -> BasePrior | None:
    """BasePrior from the table that `knowledge_section` makes, None if it is empty.

    Raises:
        ValueError: the table is no covariance.
    """
    if not table:
        return None
    try:
        names = tuple(str(name) for name in table["names"])
        sd = np.array(table["sd"], float)
        rows = table["correlation"]
        correlation = np.zeros((len(names),) * 2)
        for i, row in enumerate(rows):
            correlation[i, : i + 1] = row
        values = tuple(float(v) for v in table["values"])
        controls = tuple(
            Control(str(name), np.array(own, float), np.array(spread, float), float(gain))
            for name, (own, spread, gain) in table.get("controls", {}).items()
        )
        size = float(table.get("size", 0.0))
        least = {str(name): float(v) for name, v in table.get("least", {}).items()}
    except (AttributeError, IndexError, KeyError, TypeError, ValueError) as error:
        raise ValueError(f"[knowledge] is not what identify writes ({error})") from error
    correlation += np.tril(correlation, -1).T
    shaped = len(rows) == len(sd) == len(values) == len(names)
    shaped &= all(_is_control(one) for one in controls)
    finite = np.isfinite([size, *least.values(), *correlation.flat]).all()
    if not (shaped and finite and (sd > 0.0).all()):
        raise ValueError("[knowledge] is not what this version's identify writes: identify again")
    # Rounding may leave a tiny negative eigenvalue; a covariance has none.
    spectrum, axes = np.linalg.eigh(correlation)
    correlation = (axes * np.maximum(spectrum, 1e-8)) @ axes.T
    covariance = correlation * np.outer(sd, sd)
    return BasePrior(names, covariance, values, controls, size, least)


def _is_control(one: Control) -> bool:
    """Whether values and covariance are those of an effect of the library."""
    if one.effect not in EFFECTS or one.covariance.shape != (len(one.values),) * 2:
        return False
    effect, numbers = EFFECTS[one.effect], [*one.values, *one.covariance.flat, one.gain]
    if len(one.values) != len(effect.parameters) or not np.isfinite(numbers).all():
        return False
    least = np.linalg.eigvalsh(one.covariance).min()
    return bool(least > 0.0 or (effect.zero_gradient and least == 0.0))


@dataclass(frozen=True, eq=False)
class AugmentedCar:
    """The base car with every effect of the library switched on at its null."""

    kernels: Kernels  # the compiled car
    base: Array  # (P,) parameters of the base; an effect that the base has keeps its values
    sd: dict[str, float]  # standard errors of the base by parameter name, as far as they are known
    knowledge: BasePrior | None = None  # the covariance that healthy drives gave it, if they did
    wheelbase: float | None = None  # measured [m]: of `lf` and `lr`, one follows from the other

    @property
    def effects(self) -> tuple[Effect, ...]:
        """Every effect, in the order of the parameters."""
        return self.kernels.effects

    def places(self, effect: str) -> list[int]:
        """Indices of an effect's parameters."""
        return places_of(self.kernels.names, effect)

    def values(self, effect: str) -> tuple[float, ...]:
        """The base's own values of an effect's parameters: its null, or what the base has of it."""
        return tuple(self.base[self.places(effect)].tolist())

    def folded(self, parameters: Array) -> Car[float]:
        """The car (P,) with those effects folded in that are changes of its parameters."""
        return believed_car(model_of(self.kernels, parameters))


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


def make_augmented_car(base: CarFile | Model[float], runs: Sequence[Run]) -> AugmentedCar:
    """The augmented car about a base car.

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
    poses = [run.pose.values[:, :2] for run in runs]
    middle = dict(zip("xy", np.concatenate(poses).mean(axis=0), strict=True)) if poses else {}
    values = tuple(own.get(e.name, _nulls(e, middle)) for e in effects)
    full: Model[float] = Model(Car(*model.car), effects, values, model.chassis)
    kernels = make_kernels(effects, model.chassis)
    return _known(AugmentedCar(kernels, parameter_vector(full), sd), base, stated)


def _nulls(effect: Effect, middle: Mapping[str, float]) -> tuple[float, ...]:
    """An effect's nulls, a place amid the drives: where a floor has its origin says nothing."""
    return tuple(
        middle.get(p.name, p.null) if p.role is Role.PLACE else p.null for p in effect.parameters
    )


def _known(
    augmented: AugmentedCar, base: CarFile | Model[float], stated: Collection[str]
) -> AugmentedCar:
    """The augmented car about what the base's healthy drives fitted, if that is known.

    What a prescribed speed states, of parameters or effects, stays.

    Raises:
        ValueError: the base's `knowledge` is not what identify writes.
    """
    if not isinstance(base, CarFile):
        return augmented
    known = knowledge_of_section(base.sections.get("knowledge", {}))
    if known is None:
        return augmented
    names, parameters = augmented.kernels.names, augmented.base.copy()
    for name, value in zip(known.names, known.values, strict=False):
        if name.partition(".")[0] not in stated:
            parameters[names.index(name)] = value
    known = replace(known, covariance=c.KNOWN_WIDER**2 * known.covariance)
    return replace(augmented, base=parameters, knowledge=known)
