"""How strong an effect must be to show: 1.5, 4 and 12 times the least detectable strength.

A reference session (8 rich runs of 12 s) is driven without noise by the healthy car and by the car
with the effect. In windows of 1 s the difference of the poses, in each window's own start frame, is
whitened with the covariance that disturbances and mocap errors give, freed of start errors and of
what the base car's parameters could explain within their identification errors. Five standard
deviations of that are the least detectable strength. The results live in `severities.json`.
"""

import json
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.blind_gap.car import PlantCar
from benchmarks.blind_gap.drives import LEAD, make_noise, make_orders, make_start
from benchmarks.blind_gap.effects import EFFECTS, Hidden, Place
from benchmarks.blind_gap.plant import Array, Noise, Orders, simulate

FILE = Path(__file__).with_name("severities.json")
MULTIPLES = (1.5, 4.0, 12.0)
FIVE_SIGMA = 5.0
_RUNS, _SECONDS, _WINDOW, _SAMPLE = 8, 12.0, 1000, 50
_DRAWS = 6
_GRID = 14
_NUISANCE: tuple[tuple[str, float, float], ...] = (
    ("lf", 0.0, 0.003), ("lr", 0.0, 0.003), ("stiff_front", 0.0, 0.005),
    ("stiff_rear", 0.0, 0.005), ("inertia_z", 0.0, 0.01), ("steer_gain", 0.0, 0.002),
    ("steer_bias", 1e-4, 0.0), ("steer_lag", 1e-3, 0.0), ("steer_delay", 4e-4, 0.0),
    ("speed_gain", 0.0, 0.001), ("drive_lag", 1e-3, 0.0),
)  # fmt: skip
"""Base parameters and what their identification leaves open: absolute or relative error."""


@dataclass(frozen=True, slots=True)
class Reference:
    """The reference session: orders and starts of its runs, healthy windows, whitening."""

    orders: tuple[Orders, ...]
    starts: tuple[Array, ...]
    windows: Array
    weights: Array
    nuisance: Array


def _quiet() -> Noise:
    noise = make_noise(_SECONDS, np.random.default_rng(0))
    return Noise(np.zeros_like(noise.process), np.zeros_like(noise.pose))


def _cut(poses: Array) -> Array:
    """Windows (n, 60) of poses (steps, 3), each in the frame of its first pose."""
    pieces = []
    for first in range(LEAD, len(poses) - _WINDOW, _WINDOW):
        yaw0 = poses[first, 2]
        piece = poses[first + _SAMPLE : first + _WINDOW + 1 : _SAMPLE] - poses[first]
        c, s = np.cos(yaw0), np.sin(yaw0)
        along, left = c * piece[:, 0] + s * piece[:, 1], c * piece[:, 1] - s * piece[:, 0]
        pieces.append(np.concatenate([along, left, piece[:, 2]]))
    return np.array(pieces)


def _seen(car: PlantCar, poses: Array) -> Array:
    """Noise-free poses per step through marker offset, misalignment and latency."""
    late = round(car.pose_delay * 1000)
    old = np.concatenate([np.repeat(poses[:1], late, axis=0), poses[: len(poses) - late]])
    c, s = np.cos(old[:, 2]), np.sin(old[:, 2])
    shift = np.column_stack(
        [c * car.marker_x - s * car.marker_y, s * car.marker_x + c * car.marker_y]
    )
    return np.column_stack([old[:, :2] + shift, old[:, 2] + car.marker_yaw])


def _drive(
    car: PlantCar, orders: Iterable[Orders], starts: Iterable[Array], noise: Callable[[], Noise]
) -> Array:
    """Windows of every run of a session."""
    runs = []
    for order, start in zip(orders, starts, strict=True):
        trace = simulate(car, start, LEAD, order, noise())
        runs.append(_cut(_seen(car, trace.states[:, :3])))
    return np.concatenate(runs)


def _start_columns(window: Array) -> Array:
    """What errors of the start pose and speed do to a window: (60, 4)."""
    n = len(window) // 3
    x, y, yaw = window[:n], window[n : 2 * n], window[2 * n :]
    zero, one = np.zeros(n), np.ones(n)
    t = np.arange(1, n + 1) * _SAMPLE * 1e-3
    coast = 0.1 * (1.0 - np.exp(-t / 0.1))
    return np.column_stack(
        [
            np.concatenate([one, zero, zero]),
            np.concatenate([zero, one, zero]),
            np.concatenate([-y, x, one]),
            np.concatenate([coast * np.cos(yaw), coast * np.sin(yaw), zero]),
        ]
    )


def _weights(windows: Array, errors: Array) -> Array:
    """Inverse covariance of each window with its start columns taken out: (n, 60, 60)."""
    cov = errors.T @ errors / len(errors)
    n = windows.shape[1] // 3
    cov += np.diag(np.repeat([0.7e-3, 0.7e-3, 2e-3], n) ** 2)
    inverse = np.linalg.inv(0.95 * cov + 0.05 * np.diag(np.diag(cov)))
    weights = []
    for window in windows:
        j = inverse @ _start_columns(window)
        weights.append(inverse - j @ np.linalg.solve(_start_columns(window).T @ j, j.T))
    return np.array(weights)


def make_reference(seed: int = 7) -> Reference:
    """Drive the reference session and work out its noise and its nuisance directions."""
    rng = np.random.default_rng(seed)
    orders = tuple(make_orders("rich", _SECONDS, rng) for _ in range(_RUNS))
    starts = tuple(make_start(order, rng) for order in orders)
    car, quiet = PlantCar(), _quiet()
    windows = _drive(car, orders, starts, lambda: quiet)
    noisy = [
        _drive(car, orders, starts, lambda: make_noise(_SECONDS, rng)) - windows
        for _ in range(_DRAWS)
    ]
    weights = _weights(windows, np.concatenate(noisy))
    nuisance = []
    for name, absolute, relative in _NUISANCE:
        step = absolute + relative * getattr(car, name)
        other = car._replace(**{name: getattr(car, name) + step})
        nuisance.append(_drive(other, orders, starts, lambda: quiet) - windows)
    return Reference(orders, starts, windows, weights, np.array(nuisance))


def strength_norm(reference: Reference, car: PlantCar) -> float:
    """How many standard deviations a car is from the healthy one in the reference session."""
    quiet = _quiet()
    change = _drive(car, reference.orders, reference.starts, lambda: quiet) - reference.windows
    weighted = np.einsum("nij,nj->ni", reference.weights, change)
    own = float(np.sum(change * weighted))
    mixed = np.einsum("kni,ni->k", reference.nuisance, weighted)
    both = np.einsum("kni,nij,lnj->kl", reference.nuisance, reference.weights, reference.nuisance)
    left = own - mixed @ np.linalg.solve(both + np.eye(len(mixed)), mixed)
    return float(np.sqrt(max(left, 0.0)))


def _spot(reference: Reference, effect: Hidden) -> Place:
    """A place on the first run's way for effects that need one."""
    trace = simulate(PlantCar(), reference.starts[0], LEAD, reference.orders[0], _quiet())
    x, y = trace.states[LEAD + 4000, :2]
    return Place(1.0, 0.6, float(x), float(y)) if effect.needs_place else Place(1.0, 0.6)


def find_strengths(reference: Reference, effect: Hidden) -> dict[str, float]:
    """Strengths whose norm is 5 sigma and its multiples; capped at the strong end.

    The norm is made non-decreasing along a geometric grid and interpolated in logarithms.
    """
    place = _spot(reference, effect)
    grid = np.geomspace(effect.weak, effect.strong, _GRID)
    norms = [
        strength_norm(reference, effect.apply(PlantCar(), effect.values(float(v), place)))
        for v in grid
    ]
    rising = np.maximum.accumulate(np.maximum(norms, 1e-6)) * (1.0 + 1e-9 * np.arange(_GRID))

    def at(norm: float) -> float:
        return float(np.exp(np.interp(np.log(norm), np.log(rising), np.log(grid))))

    names = dict(zip(("small", "medium", "large"), MULTIPLES, strict=True))
    found = {name: at(FIVE_SIGMA * multiple) for name, multiple in names.items()}
    return {"five_sigma": at(FIVE_SIGMA), **found, "strongest_sigma": float(rising[-1])}


def measure(names: Iterable[str] = ()) -> dict[str, dict[str, float]]:
    """Strengths of these effects (all by default)."""
    reference = make_reference()
    wanted = tuple(names) or tuple(EFFECTS)
    return {
        name: {
            key: float(f"{value:.4g}")
            for key, value in find_strengths(reference, EFFECTS[name]).items()
        }
        for name in wanted
    }


def save_severities(path: Path = FILE) -> None:
    """Measure and write the table that the bank uses."""
    path.write_text(json.dumps(measure(), indent=1) + "\n")


def sigmas(measured: dict[str, float], strength: float) -> float:
    """How many standard deviations a strength alone is off the healthy car's in the reference.

    Interpolated (and continued) in logarithms between the strengths that were measured.

    Args:
        measured: an effect's row of the table.
        strength: positive; what is capped at the strong end counts as that.
    """
    strongest = measured["strongest_sigma"]
    known = {measured["five_sigma"]: FIVE_SIGMA}
    for name, multiple in zip(("small", "medium", "large"), MULTIPLES, strict=True):
        known.setdefault(measured[name], min(FIVE_SIGMA * multiple, strongest))
    at = np.log(sorted(known))
    norm = np.log([known[value] for value in sorted(known)])
    x = float(np.log(strength))
    i = int(np.clip(np.searchsorted(at, x), 1, len(at) - 1))
    slope = (norm[i] - norm[i - 1]) / (at[i] - at[i - 1])
    return min(float(np.exp(norm[i - 1] + slope * (x - at[i - 1]))), strongest)


def load_severities(path: Path = FILE) -> dict[str, dict[str, float]]:
    """The measured table.

    Raises:
        OSError: there is none.
    """
    table: dict[str, dict[str, float]] = json.loads(path.read_text())
    return table
