"""Coordinates in which the fit is straight: wheelbase, lr, compliances 1/C, logarithms of scales.

A steady circle fixes sums of (L, lr, 1/Cf, 1/Cr); in these the long valley of the circle problem is
straight, in the parameters themselves it is curved (the optimisers crawl). See
`docs/reference/identification.md#i3.1` and `docs/reference/identification.md#i4.1`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from steerd.car_model.effect import Effect
from steerd.car_model.native.trace import parameter_names
from steerd.car_model.params import DEFAULT_CAR, PARAMETERS
from steerd.car_model.params import wheelbase as length_of

Array = NDArray[np.float64]

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
SPREAD_RELATIVE = 1.0
"""Prior standard deviation of compliances, logarithms and inertia, relative."""
SPREAD_GAIN = 0.3
"""The same for the two gains, relative."""
WHEELBASE = "wheelbase"


@dataclass(frozen=True, eq=False)
class Chart:
    """Between coordinates and parameters."""

    names: tuple[str, ...]  # of all parameters
    prior: Array  # (P,) parameters about which the weak priors lie; the fixed ones stay there
    free: tuple[str, ...]  # names of the free ones
    # Known distance of the axles [m]: then of lf and lr, one follows from the other
    wheelbase: float | None
    low: Array  # (P,) bounds of the parameters
    high: Array  # (P,)
    spread: Array  # (n,) prior standard deviation of the coordinates

    @property
    def labels(self) -> tuple[str, ...]:
        """What each coordinate is called."""
        return tuple(self._label(name) for name in self.free)

    @property
    def paired(self) -> bool:
        """Whether the first of lf and lr stands for their sum."""
        return "lf" in self.free and "lr" in self.free

    def _label(self, name: str) -> str:
        if name == "lf" and self.paired:
            return WHEELBASE
        if name in INVERSE:
            return f"1/{name}"
        return f"log {name}" if name in LOGARITHM else name

    def _places(self) -> list[int]:
        return [self.names.index(name) for name in self.free]

    def coordinates(self, parameters: Array) -> Array:
        """Coordinates (n,) of parameters (P,)."""
        z = parameters[self._places()].astype(float)
        for i, name in enumerate(self.free):
            if name == "lf" and self.paired:
                z[i] += parameters[self.names.index("lr")]
            elif name in INVERSE:
                z[i] = 1.0 / z[i]
            elif name in LOGARITHM:
                z[i] = np.log(z[i])
        return z

    def parameters(self, z: Array) -> Array:
        """Parameters (P,) of coordinates (n,)."""
        p = self.prior.copy()
        for value, name, place in zip(z, self.free, self._places(), strict=True):
            log = np.exp(np.clip(value, -20.0, 20.0)) if name in LOGARITHM else value
            p[place] = 1.0 / value if name in INVERSE else log
        front, rear = self.names.index("lf"), self.names.index("lr")
        if self.paired:
            p[front] -= p[rear]
        elif self.wheelbase is not None and {"lf", "lr"} & set(self.free):
            known, follows = (front, rear) if "lf" in self.free else (rear, front)
            p[follows] = self.wheelbase - p[known]
        return p

    def slopes(self, z: Array) -> Array:
        """Derivative (P, n) of the parameters by the coordinates."""
        p, places = self.parameters(z), self._places()
        slopes = np.zeros((len(p), len(z)))
        front, rear = self.names.index("lf"), self.names.index("lr")
        for i, (name, place) in enumerate(zip(self.free, places, strict=True)):
            log = p[place] if name in LOGARITHM else 1.0
            slopes[place, i] = -(p[place] ** 2) if name in INVERSE else log
            if name == "lr" and (self.paired or self.wheelbase is not None):
                slopes[front, i] = -1.0
            if name == "lf" and not self.paired and self.wheelbase is not None:
                slopes[rear, i] = -1.0
        return slopes

    def bounds(self) -> tuple[Array, Array]:
        """Lowest and highest coordinates (n,) each."""
        low, high = self.low[self._places()].copy(), self.high[self._places()].copy()
        for i, name in enumerate(self.free):
            if name == "lf" and self.paired:
                rear = self.names.index("lr")
                low[i], high[i] = low[i] + self.low[rear], high[i] + self.high[rear]
            elif name in INVERSE:
                low[i], high[i] = 1.0 / high[i], 1.0 / low[i]
            elif name in LOGARITHM:
                low[i], high[i] = np.log(low[i]), np.log(high[i])
        return low, high


def effect_scales(effects: Sequence[Effect]) -> dict[str, float]:
    """Prior scale of every parameter of effects, by `effect.parameter`."""
    return {f"{e.name}.{p.name}": p.scale for e in effects for p in e.parameters}


def _bounds(effects: Sequence[Effect]) -> tuple[Array, Array]:
    rows = [(p.low, p.high) for p in PARAMETERS]
    rows += [(p.low, p.high) for e in effects for p in e.parameters]
    low, high = np.array(rows).T
    return low, high


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
    low, high = _bounds(effects)
    chart = Chart(names, prior.astype(float), chosen, wheelbase, low, high, np.empty(0))
    return replace(chart, spread=_spreads(chart, effects))


def _spreads(chart: Chart, effects: Sequence[Effect]) -> Array:
    own = effect_scales(effects)
    z = chart.coordinates(chart.prior)
    spread = []
    for value, name in zip(z, chart.free, strict=True):
        if name in INVERSE:
            spread.append(SPREAD_RELATIVE * abs(value))
        elif name.endswith("gain"):
            spread.append(SPREAD_GAIN * (1.0 if name in LOGARITHM else abs(value)))
        elif name in LOGARITHM:
            spread.append(SPREAD_RELATIVE)
        elif name == "inertia_z":
            spread.append(SPREAD_RELATIVE * abs(value))
        else:
            size = relative_length(chart.names, chart.prior) if name in LENGTHS else 1.0
            spread.append(size * (own.get(name) or SPREAD[name]))
    return np.array(spread)


def relative_length(names: Sequence[str], parameters: Array) -> float:
    """Wheelbase of a car (P,) per the default car's."""
    both = parameters[names.index("lf")] + parameters[names.index("lr")]
    return float(both / length_of(DEFAULT_CAR))
