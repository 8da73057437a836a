"""What the data identify, and the manoeuvre that would identify the rest."""

# Why: docs/decisions/identification.md#d58

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from steerd.car_model.effect import Effect
from steerd.car_model.params import GRAVITY
from steerd.sysid.data.data_checks import Array
from steerd.sysid.inference.chart import INVERSE, RELATIVE, SPREAD, Chart, make_chart

RELATIVE_MAX = 0.05  # a length, stiffness or scale is known whose error is below this share of it
SPREAD_MAX = 0.2  # all else is known when its standard error is below this share of its prior's
GAIN_MIN = 8.0
"""A direction is identifiable when the data shrink its prior standard deviation by more than this;
less can be an artefact: noise that free initial states take for transients looks informative."""
DOUBT = 0.2
"""No tyre is so stiff that its compliance is known better than this before any data [rad]. Priors
lie about the start: circles from a start with large stiffness would seem to show lengths."""
EXTREME = 2.0  # a stiffness within this factor of a bound is no tyre's
BOUNDED = ("lf", "lr", "inertia_z", "steer_gain", "speed_gain")
"""What no car has at a bound; stiffnesses have doubts of their own there, and zero is a time."""
AT_BOUND = 1e-3  # this share of it away is still at the bound
SUM_MAX = 0.02  # a sum is known when its error, doubts included, is below this share of it

_SHOWING = "a drive that lets this effect show"
_TWO_SPEEDS = "constant steering at two or more speeds (`steerd collect --plan mixed`)"
_STEPS = "step steers or a steering chirp at 1 to 3 m/s (`steerd collect --plan steps`)"
_SPEED_STEPS = "speed steps on a straight (`steerd collect --plan mixed`)"
_STRAIGHT = "slow bends of several radii at one low speed (`steerd collect --plan circles`)"
MANOEUVRES: Mapping[str, str] = {
    "lf": _TWO_SPEEDS, "lr": _TWO_SPEEDS, "c_sf": _TWO_SPEEDS, "c_sr": _TWO_SPEEDS,
    "mu": "nothing: only its products with c_sf and c_sr show in this model; fix it",
    "inertia_z": _STEPS, "mass": "nothing: only its ratio to inertia_z shows; weigh the car",
    "cog_height": "hard braking and accelerating in bends",
    "steer_gain": _STRAIGHT, "steer_bias": "any straight stretch",
    "steer_delay": _STEPS, "steer_lag": _STEPS, "steer_rate": "large, sudden steps of steering",
    "steer_min": "commands beyond the right stop", "steer_max": "commands beyond the left stop",
    "speed_gain": "a straight of known length, with wheel speed recorded",
    "speed_lag": _SPEED_STEPS, "drive_delay": _SPEED_STEPS,
    "accel_max": "a large step up in speed", "decel_max": "a large step down in speed",
    "pose_delay": "changes of direction, with a gyro recorded",
}  # fmt: skip
"""What would identify each parameter of the car."""
BODY_OR_COG = ("lf", "lr", "marker_offset.forward")
"""The centre of gravity between the axles, and the mocap body's place on the car."""
WEIGH = "weighing both axles (`--fix lr=METRES`): drives may mistake the mocap body's place for it"
ANOTHER_END = f"another car explains these drives as well: {_TWO_SPEEDS}"
"""What would identify one that two fits, as good as each other, place differently."""


@dataclass(frozen=True)
class Estimate:
    """One parameter."""

    value: float  # the estimate
    sd: float  # its standard error; of what is not identifiable, with all doubts
    identifiable: bool  # whether the data identify it; if not, the value is largely the prior's
    manoeuvre: str = ""  # what would identify it; empty when it is identifiable


@dataclass(frozen=True)
class Combination:
    """A sum of coordinates that the data fix better than its members."""

    text: str  # the sum
    value: float  # its value
    sd: float  # its standard error
    known: bool = True  # whether that is small enough to call the sum known


def _estimate(
    name: str, value: float, sd: float, doubt: float, prior: float, would: str = ""
) -> Estimate:
    """An estimate, known where its standard error is small by its value or by the one before.

    Args:
        name: of the parameter.
        value: its estimate.
        sd: its standard error; `doubt` with all doubts, by which it is judged.
        doubt: see `sd`.
        prior: its standard deviation before any data.
        would: what would identify it; empty for what is usual.
    """
    relative = name in RELATIVE or name in ("lf", "lr")
    if doubt < (RELATIVE_MAX * abs(value) if relative else SPREAD_MAX * prior):
        return Estimate(value, sd, True)
    return Estimate(value, max(sd, doubt), False, would or MANOEUVRES.get(name, _SHOWING))


def _scale(chart: Chart, z: Array) -> Array:
    """By how much each coordinate could be off before any data (n,).

    For a compliance no more than lets a gain of `GAIN_MIN` mean that it is known: what noise passes
    for fixes it to a share of itself (a sixth, on circles), and against the wide prior of a start
    with soft tyres that would look like knowledge.
    """
    stiff = np.array([name in INVERSE for name in chart.free])
    own = GAIN_MIN * RELATIVE_MAX * np.abs(z)
    return np.where(stiff, np.minimum(chart.spread, own), chart.spread)


def _without_unidentifiable(chart: Chart, z: Array, covariance: Array) -> Array:
    """The covariance, unidentifiable directions left as their priors have them, or doubt does."""
    scale = _scale(chart, z)
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    stiff = [name in INVERSE for name in chart.free]
    wider = np.where(stiff, np.maximum(DOUBT, chart.spread), chart.spread) / scale
    values = np.where(values > GAIN_MIN**-2, (wider**2) @ vectors**2, values)
    return np.asarray((vectors * values) @ vectors.T * np.outer(scale, scale))


def _inflate_at_bounds(chart: Chart, z: Array, covariance: Array) -> Array:
    """The covariance with stiffnesses near their bounds in doubt, and what hangs on them.

    A fit that ends there has slid along a valley as far as it goes; how sharp the valley is at its
    end says nothing about the place along it.
    """
    inflated = covariance.copy()
    low, high = chart.bounds()
    for i, name in enumerate(chart.free):
        if name in INVERSE and not EXTREME * low[i] < z[i] < high[i] / EXTREME:
            along = covariance[:, i] / covariance[i, i]
            inflated += DOUBT**2 * np.outer(along, along)
    return inflated


def _careful(chart: Chart, z: Array, covariance: Array) -> Array:
    """The covariance with both doubts: about directions that no data show, and at bounds."""
    return _inflate_at_bounds(chart, z, _without_unidentifiable(chart, z, covariance))


def _at_bound(chart: Chart, parameters: Array, moving: Sequence[str]) -> str:
    """What to do where a fit ended at the bound of a length, an inertia or a gain; empty elsewhere.

    It would have gone on to a car that cannot be, and what it calls the rest goes with that.
    """
    for name in (n for n in BOUNDED if n in moving):
        i = chart.names.index(name)
        low, high = chart.low[i] * (1.0 + AT_BOUND), chart.high[i] * (1.0 - AT_BOUND)
        if not low < parameters[i] < high:
            return f"{name} ends at its bound, no car is like that: check signs and axes"
    return ""


def estimates(chart: Chart, z: Array, covariance: Array) -> dict[str, Estimate]:
    """Every free parameter with its standard error and whether the data identify it."""
    parameters = chart.parameters(z)
    covariances = covariance, _careful(chart, z, covariance), np.diag(chart.spread**2)
    sds = np.stack([chart.sds(z, each) for each in covariances], axis=1).tolist()
    rows = zip(chart.names, parameters.tolist(), sds, strict=True)
    moving = {name: (value, *errors) for name, value, errors in rows if errors[-1] > 0.0}
    if stuck := _at_bound(chart, parameters, tuple(moving)):
        every = moving.items()
        return {n: Estimate(value, max(sd, d), False, stuck) for n, (value, sd, d, _) in every}
    return {name: _estimate(name, *numbers) for name, numbers in moving.items()}


def estimates_with_sds(
    effects: Sequence[Effect], parameters: Array, sds: Mapping[str, float]
) -> dict[str, Estimate]:
    """The same of parameters (P,) whose standard errors, by name, are known already."""
    chart = make_chart(effects, parameters, tuple(sds))
    priors = chart.sds(chart.coordinates(parameters), np.diag(chart.spread**2))
    rows = zip(chart.names, parameters.tolist(), priors.tolist(), strict=True)
    known = {name: (value, prior) for name, value, prior in rows}
    out = {}
    for name, sd in sds.items():
        value, prior = known[name]
        out[name] = _estimate(name, value, sd, sd, prior, WEIGH if name in BODY_OR_COG else "")
    return out


def silent_estimates(chart: Chart, names: Sequence[str]) -> dict[str, Estimate]:
    """What nothing in the drives excites: as believed, and as uncertain as before."""
    hint = f"the speed was never changed: {_SPEED_STEPS}"
    values = dict(zip(chart.names, chart.prior.tolist(), strict=True))
    return {n: Estimate(values[n], SPREAD[n], False, hint) for n in names}


def combinations(
    chart: Chart, z: Array, covariance: Array, speed: float
) -> tuple[Combination, ...]:
    """The two sums that a steady circle at `speed` fixes, with their standard errors.

    In steady turning `tan(steer) R = L + (v^2 / mu g)(1/Cf - 1/Cr)` and the slip at the centre of
    gravity is `lr - v^2 / (mu g Cr)` over R: linear in the coordinates. Where other parameters are
    free as well (the steering's gain), a circle need not fix them: see `Combination.known`.
    """
    p = dict(zip(chart.names, chart.parameters(z), strict=True))
    share = speed**2 / (p["mu"] * GRAVITY)
    weights = {
        "L + (v^2/mu g)(1/Cf - 1/Cr)": np.array([1.0, 1.0, share, -share]),
        "lr - v^2/(mu g Cr)": np.array([0.0, 1.0, 0.0, -share]),
    }
    names = ("lf", "lr", "c_sf", "c_sr")
    known = np.array([p["lf"], p["lr"], 1.0 / p["c_sf"], 1.0 / p["c_sr"]])
    slopes = chart.slopes(z)[[chart.names.index(name) for name in names]]
    slopes[2:] *= -(known[2:, None] ** 2)
    careful = _careful(chart, z, covariance)
    out = []
    for text, parts in weights.items():
        row = parts @ slopes
        if np.any(row):
            value = float(parts @ known)
            sd, doubt = (float(np.sqrt(row @ c @ row)) for c in (covariance, careful))
            out.append(Combination(text, value, sd, max(sd, doubt) < SUM_MAX * abs(value)))
    return tuple(out)
