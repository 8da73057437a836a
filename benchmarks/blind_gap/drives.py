"""How the hidden car is driven: open-loop manoeuvres of three tempers, and laps of a route.

Nothing here is steerd's: manoeuvres are drawn piece by piece from a menu, laps follow the plant's
own pure pursuit on noisy poses.
"""

from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from benchmarks.blind_gap.plant import STEP, TICK, Array, Noise, Orders

LEAD = 1500
"""Steps of lead-in before the recording starts: 1.5 s in which the first command settles."""
POSITION_SD, YAW_SD = 0.7e-3, 2e-3
ACCEL_SD, YAW_ACCEL_SD = 0.4, 2.5
_NOISE_TIME = 0.08
"""Correlation time of the disturbances [s]."""
_BASE = 0.33
_STEER_MOST = 0.33


@dataclass(frozen=True, slots=True)
class Temper:
    """How hard a drive is.

    Attributes:
        slow: lowest speed [m/s].
        fast: highest speed [m/s].
        lateral: lateral acceleration to stay below [m/s^2].
        smooth: time constant by which commands are softened [s].
        tempo: scale of the steering frequencies.
    """

    slow: float
    fast: float
    lateral: float
    smooth: float
    tempo: float


TEMPERS = {
    "rich": Temper(0.8, 3.4, 4.5, 0.0, 1.0),
    "medium": Temper(0.8, 2.5, 2.5, 0.08, 0.7),
    "gentle": Temper(0.7, 1.8, 1.2, 0.3, 0.35),
}


def _softened(values: Array, time: float) -> Array:
    """A first-order low pass, started at rest on the first value."""
    if time <= 0.0:
        return values
    keep = float(np.exp(-STEP * TICK / time))
    out, _ = lfilter([1.0 - keep], [1.0, -keep], values, zi=[keep * values[0]])
    return np.asarray(out)


def _speed_plan(temper: Temper, ticks: int, rng: np.random.Generator) -> Array:
    """Levels held for 0.8 to 2.5 s, reached by a step or along a ramp."""
    plan, now, at = np.empty(ticks), float(rng.uniform(temper.slow, temper.fast)), 0
    while at < ticks:
        size = int(rng.uniform(80, 250))
        level = float(rng.uniform(temper.slow, temper.fast))
        ramp = int(rng.choice((1, 40, 100)))
        rise = np.clip(np.arange(1, size + 1) / ramp, 0.0, 1.0)
        piece = now + (level - now) * rise
        plan[at : at + size] = piece[: ticks - at]
        now, at = float(piece[-1]), at + size
    return _softened(plan, temper.smooth)


def _steer_shape(temper: Temper, size: int, rng: np.random.Generator) -> Array:
    """One manoeuvre within -1 to 1: step, slalom, chirp, ramp or random switching."""
    t = np.arange(size) * STEP * TICK
    sign = float(rng.choice((-1.0, 1.0)))
    kind = int(rng.integers(5))
    if kind == 0:
        return np.full(size, sign * rng.uniform(0.3, 1.0))
    if kind == 1:
        rate = temper.tempo * rng.uniform(0.4, 2.0)
        return np.asarray(sign * rng.uniform(0.4, 1.0) * np.sin(2.0 * np.pi * rate * t))
    if kind == 2:
        low, high = 0.3 * temper.tempo, 3.5 * temper.tempo
        phase = 2.0 * np.pi * (low * t + 0.5 * (high - low) * t * t / t[-1])
        return np.asarray(sign * rng.uniform(0.4, 0.9) * np.sin(phase))
    if kind == 3:
        return np.asarray(sign * (2.0 * t / t[-1] - 1.0))
    held = max(int(rng.uniform(15, 50) / temper.tempo), 1)
    levels = rng.choice((-1.0, -0.5, 0.0, 0.5, 1.0), size // held + 1)
    return np.repeat(levels, held)[:size]


def _steer_plan(temper: Temper, speed: Array, rng: np.random.Generator) -> Array:
    """Manoeuvres of 1 to 3 s one after the other, scaled to the lateral acceleration allowed."""
    shape, at = np.empty(len(speed)), 0
    while at < len(speed):
        size = int(rng.uniform(100, 300))
        shape[at : at + size] = _steer_shape(temper, size, rng)[: len(speed) - at]
        at += size
    most = np.minimum(temper.lateral * _BASE / np.maximum(speed, 0.5) ** 2, _STEER_MOST)
    return _softened(shape * most, temper.smooth)


def make_open_loop(temper: str, seconds: float, rng: np.random.Generator) -> tuple[Array, Array]:
    """Commanded wheel angle and speed at 100 Hz, lead-in included."""
    kind, lead = TEMPERS[temper], LEAD // TICK
    ticks = round(seconds / (STEP * TICK))
    speed = _speed_plan(kind, ticks, rng)
    steer = _steer_plan(kind, speed, rng)
    steer[:20] *= np.linspace(0.0, 1.0, 20)
    return (
        np.concatenate([np.full(lead, steer[0]), steer]),
        np.concatenate([np.full(lead, speed[0]), speed]),
    )


def make_route(name: str, rng: np.random.Generator) -> Array:
    """A closed route as rows x, y, curvature, about 5 cm apart.

    `oval`, `eight` and `bean` are what cars are identified on; `star` is another route.
    """
    u = np.linspace(0.0, 2.0 * np.pi, 4001)
    size = float(rng.uniform(0.9, 1.1))
    if name == "eight":
        x, y = 3.2 * np.sin(u), 1.7 * np.sin(2.0 * u)
    else:
        wave = {"oval": (2, 0.25), "bean": (3, 0.18), "star": (5, 0.09)}[name]
        radius = 2.3 * (1.0 + wave[1] * np.cos(wave[0] * u + rng.uniform(0.0, 6.28)))
        x, y = radius * np.cos(u), radius * np.sin(u)
    if rng.random() < 0.5:
        y = -y
    return _evenly(size * x, size * y)


def _evenly(x: Array, y: Array) -> Array:
    """Points at even spacing along a closed line, with its curvature."""
    s = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(x), np.diff(y)))])
    count = round(s[-1] / 0.05)
    at = np.arange(count) * (s[-1] / count)
    x, y = np.interp(at, s, x), np.interp(at, s, y)
    step = s[-1] / count
    dx, dy = (np.roll(v, -1) - np.roll(v, 1) for v in (x, y))
    ddx, ddy = (np.roll(v, -1) - 2.0 * v + np.roll(v, 1) for v in (x, y))
    bend = (dx * ddy - dy * ddx) * 4.0 / (2.0 * step * np.hypot(dx, dy) ** 2)
    return np.column_stack([x, y, bend])


def make_noise(
    seconds: float, rng: np.random.Generator, pose_scale: float = 1.0, process_scale: float = 1.0
) -> Noise:
    """Coloured disturbances (Ornstein-Uhlenbeck) and white pose errors, lead-in included."""
    n = LEAD + round(seconds / STEP)
    keep = float(np.exp(-STEP / _NOISE_TIME))
    white = rng.standard_normal((n, 3)) * np.sqrt(1.0 - keep * keep)
    coloured = lfilter([1.0], [1.0, -keep], white, axis=0)
    process = process_scale * np.array([ACCEL_SD, ACCEL_SD, YAW_ACCEL_SD]) * coloured
    pose = rng.standard_normal((n // TICK, 3)) * [POSITION_SD, POSITION_SD, YAW_SD]
    return Noise(np.ascontiguousarray(process), pose_scale * pose)


def make_spells(seconds: float, length: float, every: float, rng: np.random.Generator) -> Array:
    """1 in each millisecond of a failure of that length that comes about every so often [s]."""
    n = LEAD + round(seconds / STEP)
    spells = np.zeros(n)
    at = LEAD + int(rng.uniform(0.3, 1.0) * every / STEP)
    while length > 0.0 and at < n:
        spells[at : at + round(length / STEP)] = 1.0
        at += int(rng.uniform(0.6, 1.4) * every / STEP)
    return spells


def make_orders(
    drive: str,
    seconds: float,
    rng: np.random.Generator,
    route: Array | None = None,
    freeze: float = 0.0,
    cut: float = 0.0,
) -> Orders:
    """Orders of one run.

    Args:
        drive: a temper (`rich`, `medium`, `gentle`).
        seconds: length of the recording.
        rng: where the drive comes from.
        route: rows x, y, curvature to lap in closed loop; None for open-loop driving.
        freeze: length of the servo's freezes [s].
        cut: length of the motor's drop-outs [s].
    """
    steer, speed = make_open_loop(drive, seconds, rng)
    line = np.zeros((0, 3)) if route is None else route
    held = make_spells(seconds, freeze, 1.5, rng)
    dead = make_spells(seconds, cut, 3.0, rng)
    lateral = 0.8 * TEMPERS[drive].lateral
    return Orders(steer, speed, np.ascontiguousarray(line), lateral, held, dead)


def make_start(orders: Orders, rng: np.random.Generator) -> Array:
    """x, y, yaw, speed at the start: on the route, or anywhere within a metre."""
    if not len(orders.route):
        x, y = rng.uniform(-1.0, 1.0, 2)
        return np.array([x, y, rng.uniform(-np.pi, np.pi), orders.speed[0]])
    at = int(rng.integers(len(orders.route)))
    here, ahead = orders.route[at], orders.route[(at + 1) % len(orders.route)]
    yaw = np.arctan2(ahead[1] - here[1], ahead[0] - here[0])
    return np.array([here[0], here[1], yaw, min(orders.speed[0], 1.0)])
