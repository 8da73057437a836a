"""What is random: instruments' noise and disturbances on the way, learnt by maximum likelihood.

The covariance of a window's errors is a sum of a few known shapes with unknown sizes: white noise
of each instrument, coloured pushes along, across and about the car through the car's own response,
and the slip of the wheel whose speed is read. The starts and the hypothesis are marginalised, so a
good fit on few data does not look like small noise.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg.lapack import dtrtri
from scipy.optimize import minimize

from steerd.sysid.data.data_checks import Array
from steerd.sysid.inference.constants import NOISE_KEPT
from steerd.sysid.inference.disturbance_response import PIECE, responses
from steerd.sysid.inference.predictor import FREE_STATES, Linear, Predictor

MEMORY = 0.1  # correlation time of the pushes [s]
WINDOWS_MOST = 60  # windows that are enough to learn from
_INSTRUMENTS = 4
WHEEL_SLIP = 0.005
"""Slip of the driven wheel per speed and acceleration, before it is learnt [s^2/m].

A wheel that drives or brakes turns v a / (mu g C) faster than the car moves: 0.0045 v a for tyres
with C = 22. The base equations know no slip, and taken at its word it passes for pose latency. So
every window may have a coefficient of its own, as large as this."""
WHEEL_LEAST = 0.01  # wheel speed says no more than this of the car's, beside its slip [m/s]
_LEAST = np.array([1e-5, 1e-5, WHEEL_LEAST, 1e-4, 1e-3, 1e-3, 1e-3, 1e-5])
_MOST = np.array([0.05, 0.05, 0.5, 0.5, 20.0, 20.0, 200.0, 0.05])
_START = np.array([1e-3, 2e-3, 0.02, 0.05, 0.3, 0.3, 2.0, WHEEL_SLIP])
"""First guesses; what an instrument that no drive had is taken to be."""
LOUDER = 1.3  # instruments that are noisier than known by this factor are believed to be
_WILDEST, _PUSHED = 100.0, 50.0
"""Derivative by a window's start, and response to a unit push, beyond which it shows no noise;
ordinary windows have 2 to 14, and .1 to 1.4."""
_ROUNDS = 40
_ENOUGH = 1e-7  # share of the log-likelihood below which a step is the last: 0.01 nats or so
_KEYS = ("position", "yaw", "wheel_speed", "yaw_rate", "push_along", "push_across", "push_about",
         "wheel_slip")  # fmt: skip


@dataclass(frozen=True)
class Noise:
    """Sizes of what is random."""

    # Standard deviations by `steerd.sysid.data.windows.GROUPS`: [m], [rad], [m/s], [rad/s]
    instruments: tuple[float, float, float, float]
    pushes: tuple[float, float, float]  # along, across [m/s^2] and about the car [rad/s^2]
    wheel_slip: float = WHEEL_SLIP  # of the driven wheel's slip per speed and acceleration [s^2/m]

    @property
    def sizes(self) -> Array:
        """All eight standard deviations."""
        return np.array([*self.instruments, *self.pushes, self.wheel_slip])


def noise_of_sizes(sizes: Array) -> Noise:
    """The reverse of `Noise.sizes`."""
    a, b, c, d, e, f, g, h = (float(s) for s in sizes)
    return Noise((a, b, c, d), (e, f, g), h)


def usual_noise(signals: Array) -> Noise:
    """What noise is taken to be before it is learnt; `signals` (4,) as of `estimate_noise`."""
    return noise_of_sizes(np.concatenate([np.maximum(signals, _LEAST[:4]), _START[4:]]))


def signal_noise(signals: Array) -> Noise:
    """Instruments alone, as noisy as their signals (4,); whatever else acts is a discrepancy."""
    return noise_of_sizes(np.concatenate([signals, np.zeros(4)]))


def slip_shape(predictor: Predictor, error: Array) -> Array:
    """Covariance (W, D, D) of the wheel speed for a unit slip coefficient of each window.

    Speed and acceleration are the predicted ones: measurements less the `error` (W, D).
    """
    speed = predictor.pad(predictor.layout.values) - error
    wheel = (predictor.channel == 3) & (predictor.padded.there > 0.0)
    slip = np.zeros(wheel.shape)
    for w in np.flatnonzero(wheel.sum(axis=1) > 1):
        v, t = speed[w, wheel[w]], predictor.layout.row_t[predictor.padded.row[w, wheel[w]]]
        slip[w, wheel[w]] = v * np.gradient(v, t)
    return np.asarray(slip[:, :, None] * slip[:, None, :])


def pushed(seen: Array, sizes: Sequence[float], memory: float = MEMORY) -> Array:
    """Covariance (W, D, D) of pushes of these sizes, correlated over `memory` [s].

    The responses to each are `seen` (inputs, W, D, pieces).
    """
    at = np.arange(seen.shape[3]) * PIECE
    kernel = np.exp(-np.abs(at[:, None] - at[None, :]) / memory)
    each = [size * response for size, response in zip(sizes, seen, strict=True)]
    coloured = np.concatenate([response @ kernel for response in each], axis=2)
    return np.asarray(coloured @ np.concatenate(each, axis=2).transpose(0, 2, 1))


def shapes(seen: Array) -> list[Array]:
    """Covariance (W, D, D) of a unit push of each input."""
    return [pushed(response[None], [1.0]) for response in seen]


def instrument_rows(predictor: Predictor) -> Array:
    """(4, W, D) 1 where a row is of a group."""
    group = np.maximum(predictor.channel - 1, 0)
    rows: Array = np.stack([(group == g) * predictor.padded.there for g in range(_INSTRUMENTS)])
    return rows


def instrument_variance(predictor: Predictor, noise: Noise) -> Array:
    """(W, D) variances of the readings; 1 where there is none."""
    rows, padded = instrument_rows(predictor), predictor.padded
    white = np.einsum("g,gwd->wd", noise.sizes[:_INSTRUMENTS] ** 2, rows)
    return np.asarray(white / padded.merged + (1.0 - padded.there))


def covariance(predictor: Predictor, noise: Noise, seen: Array, error: Array) -> Array:
    """(W, D, D) covariance of the errors; 1 where there is no row.

    `seen` (3, W, D, pieces) are the responses to pushes; `error` (W, D) as in `slip_shape`.
    """
    out = pushed(seen, noise.pushes) + noise.wheel_slip**2 * slip_shape(predictor, error)
    width = range(out.shape[1])
    out[:, width, width] += instrument_variance(predictor, noise)
    return out


def learn_noise(
    predictor: Predictor, parameters: Array, x: Array, linear: Linear, guess: Noise | None = None
) -> Noise:
    """Sizes under which the errors of a fitted hypothesis are most likely, sought from a guess.

    Windows that the hypothesis explains badly pull less (Student's t), so that a gap in a few
    places does not pass for noise everywhere; where the car spins beyond all bounds, none does.
    Given are the car (P,), the windows' starts (W, 7), and errors and derivatives there.
    """
    seen = responses(predictor, parameters, x, (0, 1, 2))
    calm = np.abs(linear.by_x).max(axis=(1, 2)) < _WILDEST
    tame = np.flatnonzero(calm & (np.abs(seen).max(axis=(0, 2, 3)) < _PUSHED))
    tame = tame if len(tame) else np.arange(predictor.layout.count)
    chosen = tame[np.unique(np.linspace(0, len(tame) - 1, WINDOWS_MOST).round().astype(int))]
    shaped = [v[chosen] for v in (*shapes(seen), slip_shape(predictor, linear.error))]
    error, known = (part[chosen] for part in predictor.about_guess(x, linear))
    rows, there = instrument_rows(predictor)[:, chosen], predictor.padded.there[chosen]
    first = (guess.sizes if guess else _START).clip(_LEAST * 1.01, _MOST * 0.99)
    known[:, range(known.shape[1]), range(known.shape[1])] += 1.0 - there
    sizes = likeliest_sizes(first, (_LEAST, _MOST), (error, known, rows, shaped, there))
    absent = rows.sum(axis=(1, 2)) == 0
    sizes[:_INSTRUMENTS][absent] = first[:_INSTRUMENTS][absent]
    return noise_of_sizes(sizes)


Parts = tuple[Array, Array, Array, Sequence[Array], Array]


def likeliest_sizes(first: Array, within: tuple[Array, Array], given: Parts) -> Array:
    """Standard deviations of the parts of a covariance by maximum likelihood (Student's t).

    The search begins at `first`, and ends within two bounds. Given are the errors (W, D), what is
    known of their covariance (W, D, D), 1 in each row of instruments (G, W, D), the shapes
    (W, D, D) of the other parts, and 1 where there is a row (W, D).
    """
    found = minimize(
        _likelihood, np.log(first), given, jac=True, method="L-BFGS-B",
        bounds=np.log(within).T, options={"maxiter": _ROUNDS, "ftol": _ENOUGH},
    )  # fmt: skip
    return np.asarray(np.exp(found.x))


def inverse_factors(covariances: Array) -> Array:
    """(W, D, D) inverses of the lower Cholesky factors: they make such errors white."""
    return np.stack([dtrtri(each, lower=1)[0] for each in np.linalg.cholesky(covariances)])


def _likelihood(
    logs: Array, error: Array, known: Array, rows: Array, shaped: Sequence[Array], there: Array
) -> tuple[float, Array]:
    """Negative log-likelihood of the sizes and its slope by their logarithms."""
    squares, instruments = np.exp(2.0 * logs), len(rows)
    cov = known + sum(s * v for s, v in zip(squares[instruments:], shaped, strict=True))
    width = range(cov.shape[1])
    cov[:, width, width] += np.einsum("g,gwd->wd", squares[:instruments], rows)
    white = inverse_factors(cov)
    inverse = white.transpose(0, 2, 1) @ white
    pulled = np.matmul(inverse, error[:, :, None])[:, :, 0]
    square, dof = (error * pulled).sum(axis=1), there.sum(axis=1)
    weight = 2.0 / (1.0 + square / dof)
    halves = -np.log(np.diagonal(white, axis1=1, axis2=2)).sum()
    value = halves + float((dof * np.log1p(square / dof)).sum())
    spread = np.diagonal(inverse, axis1=1, axis2=2)
    slope = [(own * (spread - weight[:, None] * pulled**2)).sum() for own in rows]
    for v in shaped:
        bent = (np.matmul(v, pulled[:, :, None])[:, :, 0] * pulled).sum(axis=1)
        slope.append((inverse * v).sum() - weight @ bent)
    return value, np.array(slope) * squares


def noisier_of(noise: Noise, signals: Array) -> Noise:
    """Known noise where these drives' own signals are not clearly noisier; else theirs.

    Those are `signals` (4,), as of `estimate_noise`; what is slow does not show in them.
    """
    sizes = noise.sizes
    sizes[:4] = np.where(signals > LOUDER * sizes[:4], signals, sizes[:4])
    return noise_of_sizes(sizes)


def calibrated(noise: Noise, left: float, should: float = 1.0) -> Noise:
    """Noise under which drives without a gap leave what they should of the whitened error.

    What a likelihood over windows of different harshness calls typical is more than most of them
    hold; taken as it is, it costs the test its power. The drives leave `left` per degree of freedom
    and should leave `should` (`noise_share`): by another measure than the floor's, healthy drives
    would lie above it.
    """
    return noise_of_sizes(np.maximum(noise.sizes * np.sqrt(left / should), _LEAST))


def noise_share(predictor: Predictor, wheel: float) -> float:
    """What noise leaves of the whitened error per degree of freedom of the drives it is learnt on.

    Wheel speed is trusted less than it deserves (`WHEEL_LEAST`), so its readings leave less; the
    noise of its own signal is `wheel` [m/s].
    """
    counts = instrument_rows(predictor).sum(axis=(1, 2))
    worth = np.array([1.0, 1.0, min(1.0, (wheel / WHEEL_LEAST) ** 2), 1.0])
    free = FREE_STATES * predictor.layout.count
    share = (counts @ worth - free) / max(float(counts.sum()) - free, 1.0)
    return float(max(share, 0.1))


def noise_floor(predictor: Predictor, wheel: float) -> float:
    """What noise alone should leave of other drives; `wheel` as in `noise_share`."""
    return NOISE_KEPT * noise_share(predictor, wheel)


def noise_section(noise: Noise) -> dict[str, float]:
    """A car file's `[noise]` table."""
    return dict(zip(_KEYS, noise.sizes.tolist(), strict=True))


def noise_of_section(table: Mapping[str, Any]) -> Noise | None:
    """Noise from a car file's `[noise]` table, None if it has none.

    Raises:
        ValueError: a number is missing or not positive.
    """
    if not table:
        return None
    sizes = {_KEYS[-1]: WHEEL_SLIP, **table}
    missing = [key for key in _KEYS if not float(sizes.get(key, 0.0)) > 0.0]
    if missing:
        raise ValueError(f"[noise] {missing[0]} must be a positive number")
    return noise_of_sizes(np.array([float(sizes[key]) for key in _KEYS]))
