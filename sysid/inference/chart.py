"""Coordinates in which the fit is straight: wheelbase, lr, compliances 1/C, logarithms of scales.

A steady circle fixes sums of (L, lr, 1/Cf, 1/Cr); in these the long valley of the circle problem is
straight, in the parameters themselves it is curved (the optimisers crawl). See
`docs/reference/identification.md#i3.1` and `docs/reference/identification.md#i4.1`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from steerd.car_model.effect import Effect
from steerd.car_model.native.trace import parameter_names
from steerd.car_model.params import DEFAULT_CAR, PARAMETERS
from steerd.car_model.params import wheelbase as length_of
from steerd.sysid.data.data_checks import Array, Mask

INVERSE = frozenset({"c_sf", "c_sr", "c_x"})
LOGARITHM = frozenset({"mu", "mass", "speed_gain", "steer_rate"})
RELATIVE = INVERSE | LOGARITHM | {"inertia_z", "steer_gain"}
"""What is judged by its relative error.

Inertia and steering gain are coordinates as they are: a car that is longer, slides more, has more
inertia and steers more, all by one factor, barely differs from the first (only its slip angle
does), and that long valley is straight in (L, lr, 1/C, I, gain).
"""
SPREAD = {
    "steer_bias": 0.05, "steer_delay": 0.03, "steer_lag": 0.05, "drive_delay": 0.05,
    "speed_lag": 0.1, "pose_delay": 0.02, "cog_height": 0.05, "steer_min": 0.1, "steer_max": 0.1,
    "accel_max": 5.0, "decel_max": 5.0, "lf": 0.2, "lr": 0.2,
}  # fmt: skip
"""Prior standard deviation of what is neither a compliance nor a logarithm, in its own unit."""
LENGTHS = frozenset(
    {"lf", "lr", "cog_height", "marker_offset.forward", "marker_offset.left", "cog_offset.offset"}
)
"""What is as uncertain as the car is long: the spreads are those of a car of the default's size."""
SPREAD_RELATIVE = 1.0  # prior standard deviation of compliances, logarithms and inertia, relative
SPREAD_GAIN = 0.3  # the same for the two gains, relative
WHEELBASE = "wheelbase"


@dataclass(frozen=True, eq=False)
class Chart:
    """Between coordinates and parameters."""

    names: tuple[str, ...]  # of all parameters
    prior: Array  # (P,) parameters about which the weak priors lie; the fixed ones stay there
    free: tuple[str, ...]  # names of the free ones
    wheelbase: float | None  # known [m]: then one of lf and lr follows from the other
    low: Array  # (P,) bounds of the parameters
    high: Array  # (P,)
    spread: Array  # (n,) prior standard deviation of the coordinates

    @property
    def labels(self) -> tuple[str, ...]:
        """What each coordinate is called."""
        words = {"lf": WHEELBASE} if self.paired else {}
        words |= {name: f"1/{name}" for name in INVERSE}
        words |= {name: f"log {name}" for name in LOGARITHM}
        return tuple(words.get(name, name) for name in self.free)

    @property
    def paired(self) -> bool:
        """Whether the first of lf and lr stands for their sum."""
        return "lf" in self.free and "lr" in self.free

    @cached_property
    def _places(self) -> list[int]:
        """Of the free parameters among all."""
        return [self.names.index(name) for name in self.free]

    @cached_property
    def _inverse(self) -> Mask:
        return np.array([name in INVERSE for name in self.free], bool)

    @cached_property
    def _log(self) -> Mask:
        return np.array([name in LOGARITHM for name in self.free], bool)

    @cached_property
    def _following(self) -> tuple[int, int] | None:
        """Which of the axles' distances is what the other leaves of their sum, and that other."""
        front, rear = self.names.index("lf"), self.names.index("lr")
        if not self.paired and (self.wheelbase is None or not {"lf", "lr"} & set(self.free)):
            return None
        return (front, rear) if "lr" in self.free else (rear, front)

    def coordinates(self, parameters: Array) -> Array:
        """Coordinates (n,) of parameters (P,)."""
        z = parameters[self._places].astype(float)
        z[self._inverse] = 1.0 / z[self._inverse]
        z[self._log] = np.log(z[self._log])
        if self.paired:
            z[self.free.index("lf")] += parameters[self.names.index("lr")]
        return z

    def parameters(self, z: Array) -> Array:
        """Parameters (P,) of coordinates (n,)."""
        p, own = self.prior.copy(), z.astype(float)
        own[self._inverse] = 1.0 / own[self._inverse]
        own[self._log] = np.exp(np.clip(own[self._log], -20.0, 20.0))
        p[self._places] = own
        if following := self._following:
            one, other = following
            p[one] = (p[one] if self.wheelbase is None else self.wheelbase) - p[other]
        return p

    def own_slopes(self, z: Array) -> Array:
        """Derivative (n,) of each free parameter by its own coordinate."""
        p = self.parameters(z)[self._places]
        return np.where(self._inverse, -(p**2), np.where(self._log, p, 1.0))

    def slopes(self, z: Array) -> Array:
        """Derivative (P, n) of the parameters by the coordinates."""
        slopes = np.zeros((len(self.prior), len(z)))
        slopes[self._places, range(len(z))] = self.own_slopes(z)
        if following := self._following:
            one, other = following
            slopes[one] -= slopes[other]
        return slopes

    def bounds(self) -> tuple[Array, Array]:
        """Lowest and highest coordinates (n,) each."""
        ends = np.array([self.coordinates(self.low), self.coordinates(self.high)])
        return ends.min(axis=0), ends.max(axis=0)

    def sds(self, z: Array, covariance: Array) -> Array:
        """Standard errors (P,) of the parameters, zero for the fixed ones, of the coordinates'."""
        slopes = self.slopes(z)
        variance = np.einsum("pi,ij,pj->p", slopes, covariance, slopes)
        return np.asarray(np.sqrt(np.maximum(variance, 0.0)))


def places_of(names: Sequence[str], effect: str) -> list[int]:
    """Where an effect's parameters stand among the names of parameters."""
    return [i for i, name in enumerate(names) if name.startswith(f"{effect}.")]


def effect_scales(effects: Sequence[Effect]) -> dict[str, float]:
    """Prior scale of every parameter of effects, by `effect.parameter`."""
    return {f"{e.name}.{p.name}": p.scale for e in effects for p in e.parameters}


def make_chart(
    effects: Sequence[Effect], prior: Array, free: Sequence[str], wheelbase: float | None = None
) -> Chart:
    """Coordinates for some free parameters.

    Args:
        effects: what is switched on.
        prior: (P,) parameters about which the weak priors lie.
        free: names as in `trace.parameter_names`.
        wheelbase: known distance of the axles [m].

    Raises:
        ValueError: a name is unknown or appears twice.
    """
    names = parameter_names(tuple(effects))
    unknown = [name for name in free if name not in names]
    if unknown or len(set(free)) < len(free):
        raise ValueError(f"free parameters must be among {', '.join(names)}, each once: {unknown}")
    chosen = tuple(free)
    if wheelbase is not None and {"lf", "lr"} <= set(chosen):
        chosen = tuple(name for name in chosen if name != "lf")
    limits = [(p.low, p.high) for p in PARAMETERS]
    limits += [(p.low, p.high) for e in effects for p in e.parameters]
    low, high = np.array(limits).T
    chart = Chart(names, prior.astype(float), chosen, wheelbase, low, high, np.empty(0))
    own = effect_scales(effects)
    z, length = chart.coordinates(prior), relative_length(names, prior)
    spread = []
    for value, name in zip(z, chosen, strict=True):
        if name in RELATIVE or name.endswith("gain"):
            share = SPREAD_GAIN if name.endswith("gain") else SPREAD_RELATIVE
            spread.append(share * (1.0 if name in LOGARITHM else abs(value)))
        else:
            size = length if name in LENGTHS else 1.0
            spread.append(size * (own.get(name) or SPREAD[name]))
    return replace(chart, spread=np.array(spread))


def relative_length(names: Sequence[str], parameters: Array) -> float:
    """Wheelbase of a car (P,) per the default car's."""
    both = parameters[names.index("lf")] + parameters[names.index("lr")]
    return float(both / length_of(DEFAULT_CAR))
