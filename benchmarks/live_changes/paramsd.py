"""openpilot's parameter filter on the drives of `benchmarks.live_changes`, beside the learner.

python -m benchmarks.live_changes.paramsd rows.jsonl --seeds 20

Written anew from its published equations (`car_kf.py` and `paramsd.py` of openpilot, 2023): an
extended Kalman filter over stiffness factor, steering ratio, angle offset and fast offset, lateral
speed, yaw rate, steering angle and roll, on a linear single-track car. It asks for speed, yaw rate
and steering angle: here the wheel's speed, the pose's turning, and the order as the servo of the
published car would follow it. Its noises are as published, the ratio's per the ratio of 15 that
they were chosen for; `quick` has the wandering of the parameters 10 times as large.
"""

import argparse
import json
from collections import deque
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.blind_gap.car import GRAVITY, make_car
from benchmarks.live_changes.plant import CHANGES, Change, changed, drive
from benchmarks.live_changes.trial import AFTER, FIRST, LAST
from steerd.car_model.params import DEFAULT_CAR
from steerd.sim_gap.online.samples import Ordered, PoseSeen, Rolled, Sample

Array = NDArray[np.float64]

STIFFNESS, RATIO, OFFSET, FAST, U, V, R, STEER, ROLL = range(9)
PUBLISHED = 15.0
"""The ratio that the published noise belongs to."""
_DEG = np.radians(1.0)
WANDER = np.array([
    5e-4, 0.01 / PUBLISHED, 0.02 * _DEG, 0.25 * _DEG, 0.1, 0.01, 0.1 * _DEG, 0.1 * _DEG, _DEG,
])  # fmt: skip
"""Process noise [1/sqrt(s)], and the first standard deviations."""
HELD = ((FAST, 0.0, 10.0 * _DEG), (ROLL, 0.0, _DEG), (RATIO, 1.0, 5.0 / PUBLISHED),
        (STIFFNESS, 1.0, 0.5))  # fmt: skip
"""What it is given every time though nobody measured it: state, value, standard deviation."""
STEER_SD, SPEED_SD, YAW_SD = 0.05 * _DEG, 0.1, 0.05
TURNING = 0.05
"""Time over which the pose's turning is taken [s]."""
QUICK = 10.0
MOVED = {"gain": 0.03, "offset": 0.005, "stiffness": 0.2}
"""What of a healthy car's parameters would make a lab look: a quarter of the true changes."""
HELD_TO = 0.25
"""Converged is an estimate within so much of the change, until the end."""


class Estimate(NamedTuple):
    """At a time [s]: steering gain per the first, offset [rad], stiffness factor."""

    t: float
    gain: float
    offset: float
    stiffness: float


def slope(x: Array) -> tuple[Array, Array]:
    """Rates of the state (9,), and their Jacobian (9, 9)."""
    car = DEFAULT_CAR
    m, j, a, b = car.mass, car.inertia_z, car.lf, car.lr
    load = car.mu * m * GRAVITY / (a + b)
    cf, cr = x[STIFFNESS] * car.c_sf * load * b, x[STIFFNESS] * car.c_sr * load * a
    u, v, r = x[U], x[V], x[R]
    angle = (x[STEER] - x[OFFSET] - x[FAST]) / x[RATIO]
    side = np.array([
        (-(cf + cr) * v - (cf * a - cr * b) * r) / (m * u) + cf * angle / m,
        (-(cf * a - cr * b) * v - (cf * a * a + cr * b * b) * r) / (j * u) + cf * a * angle / j,
    ])  # fmt: skip
    pull = np.array([cf / m, cf * a / j])
    jacobian = np.zeros((9, 9))
    rows = jacobian[[V, R]]
    rows[:, STIFFNESS] = side / x[STIFFNESS]
    rows[:, RATIO] = -pull * angle / x[RATIO]
    rows[:, OFFSET] = rows[:, FAST] = -pull / x[RATIO]
    rows[:, STEER] = pull / x[RATIO]
    rows[:, U] = -(side - pull * angle) / u - np.array([r, 0.0])
    rows[:, V] = [-(cf + cr) / (m * u), -(cf * a - cr * b) / (j * u)]
    rows[:, R] = [-(cf * a - cr * b) / (m * u) - u, -(cf * a * a + cr * b * b) / (j * u)]
    rows[0, ROLL] = -GRAVITY
    jacobian[[V, R]] = rows
    rates = np.zeros(9)
    rates[V], rates[R] = side[0] - u * r - GRAVITY * x[ROLL], side[1]
    return rates, jacobian


def predict(x: Array, p: Array, q: Array, dt: float) -> tuple[Array, Array]:
    """The state `dt` seconds later, in steps short enough for a small car's tyres."""
    steps = max(1, int(np.ceil(dt / 0.0025)))
    for _ in range(steps):
        rates, jacobian = slope(x)
        f = np.eye(9) + jacobian * (dt / steps)
        x, p = x + rates * (dt / steps), f @ p @ f.T + q * (dt / steps)
    return x, p


def observe(x: Array, p: Array, place: int, value: float, sd: float) -> tuple[Array, Array]:
    """One number seen."""
    gain = p[:, place] / (p[place, place] + sd * sd)
    return x + gain * (value - x[place]), p - np.outer(gain, p[place])


def servo_angles(samples: Iterable[Sample]) -> Iterator[tuple[Sample, float]]:
    """Each sample with the angle of the published car's servo then [rad]."""
    car, waiting, angle, last = DEFAULT_CAR, deque[Ordered](), 0.0, 0.0
    order = 0.0
    for sample in samples:
        while waiting and waiting[0].t + car.steer_delay <= sample.t:
            order = waiting.popleft().steer
        angle += (order - angle) * -np.expm1(-(sample.t - last) / car.steer_lag)
        last = sample.t
        if isinstance(sample, Ordered):
            waiting.append(sample)
        yield sample, float(angle)


def run_filter(samples: Iterable[Sample], quick: float = 1.0) -> list[Estimate]:
    """What the filter says at every pose."""
    sd = WANDER.copy()
    sd[:4] *= quick
    x, p, q = np.array([1.0, 1.0, 0, 0, 1.75, 0, 0, 0, 0]), np.diag(sd**2), np.diag(sd**2)
    past: deque[PoseSeen] = deque()
    last, said = None, []
    for sample, angle in servo_angles(samples):
        if isinstance(sample, Rolled):
            x, p = observe(x, p, U, sample.speed, SPEED_SD)
        if not isinstance(sample, PoseSeen):
            continue
        if last is not None:
            x, p = predict(x, p, q, sample.t - last)
        last = sample.t
        past.append(sample)
        while sample.t - past[0].t > TURNING + 1e-6:
            past.popleft()
        if sample.t - past[0].t > 0.5 * TURNING:
            turned = np.angle(np.exp(1j * (sample.yaw - past[0].yaw)))
            x, p = observe(x, p, R, float(turned / (sample.t - past[0].t)), YAW_SD)
        for place, value, held_sd in ((STEER, angle, STEER_SD), *HELD):
            x, p = observe(x, p, place, value, held_sd)
        x[U], x[RATIO], x[STIFFNESS] = max(x[U], 0.5), max(x[RATIO], 0.5), max(x[STIFFNESS], 0.2)
        said.append(Estimate(sample.t, 1.0 / x[RATIO], x[OFFSET], x[STIFFNESS]))
    return said


def judge(said: list[Estimate], at: float, name: str) -> dict[str, Any]:
    """What moved after the change, how far off that is, and since when it was near."""
    before = np.mean([s[1:] for s in said if at - 2.0 <= s.t < at], axis=0)
    later = np.array([s for s in said if s.t >= at])
    moved = {
        "gain": later[:, 1] / before[0] - 1.0,
        "offset": later[:, 2] - before[1],
        "stiffness": later[:, 3] / before[2] - 1.0,
    }
    true = {"steer_gain": ("gain", -0.12), "steer_bias": ("offset", -0.02)}.get(name)
    row: dict[str, Any] = {
        "moved": [key for key, least in MOVED.items() if abs(moved[key][-200:].mean()) > least]
    }
    if true is not None:
        off = np.abs(moved[true[0]] - true[1]) / abs(true[1])
        far = np.flatnonzero(off > HELD_TO)
        since = 0 if not far.size else int(far[-1]) + 1
        row["error"] = float(off[-200:].mean())
        row["converged"] = float(later[since, 0] - at) if since < len(later) else None
    return row


def filter_drive(seed: int, name: str) -> dict[str, dict[str, Any]]:
    """Both filters on the drive that the learner had; without a name for the stretch before."""
    car = make_car(np.random.default_rng([seed, 1]))
    rng = np.random.default_rng([seed, 2])
    at = round(float(rng.uniform(FIRST, LAST)), 2)
    change = Change(name, at, changed(car, name)) if name else None
    samples = list(drive(car, at + AFTER, rng, change))
    found = {"published": run_filter(samples), "quick": run_filter(samples, QUICK)}
    return {kind: judge(said, at, name) for kind, said in found.items()}


def learner_row(row: dict[str, Any]) -> dict[str, Any]:
    """The same of a learner's row; near is when the name stood, its value comes with it."""
    named, said = row["change"], row["final"]
    result: dict[str, Any] = {"moved": said}
    true = {"steer_gain": 0.88, "steer_bias": 0.02}.get(named)
    if true is not None and said[:1] == [named]:
        size = 0.12 if named == "steer_gain" else 0.02
        result["error"] = abs(row["value"] - true) / size
        result["converged"] = row["right"]
    return result


def describe(rows: dict[tuple[str, str], list[dict[str, Any]]]) -> str:
    """One line a change and an estimator."""
    lines = [
        "| change | estimator | drives | error, median | near, of them | median | what moved |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for (name, kind), found in rows.items():
        errors = [row["error"] for row in found if "error" in row]
        times = [row["converged"] for row in found if row.get("converged") is not None]
        times = [t for t in times if t == t]
        words = sorted({word for row in found for word in row["moved"]})
        said = [f"{word} {sum(word in row['moved'] for row in found)}" for word in words]
        error = f"{100.0 * np.median(errors):.0f} %" if errors else ""
        middle = f"{np.median(times):.1f} s" if times else ""
        near = str(len(times)) if errors else ""
        lines.append(
            f"| {name or 'none'} | {kind} | {len(found)} | {error} | {near} | {middle} |"
            f" {', '.join(said) or 'nothing'} |"
        )
    return "\n".join(lines)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("rows", type=Path, help="the learner's, of `benchmarks.live_changes`")
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--changes", nargs="*", default=["", *CHANGES])
    args = parser.parse_args()
    learnt = [json.loads(line) for line in args.rows.read_text().splitlines()]
    table: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for name in args.changes:
        for seed in range(args.seeds):
            for kind, row in filter_drive(seed, name).items():
                table.setdefault((name, kind), []).append(row)
        own = [row for row in learnt if row["change"] == name and row["seed"] < args.seeds]
        if own and name:
            table[(name, "learner")] = [learner_row(row) for row in own]
    print(describe(table))


if __name__ == "__main__":
    main()
