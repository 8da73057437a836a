"""Are the standard errors of `steerd identify` right on sessions of the whole chain?

python -m benchmarks.identify_sessions --folder DIR --first 9000 --seeds 60 [--plan mixed]

Each seed is a hidden car (stiffnesses, lengths, inertia, gains, lags and dead times drawn), a phase
of its servo's pulses and the noise of `steerd collect --sim --fast`: every byte of both protocols,
loop, gate, simulated VESC and cameras. Its session is identified from the default car, the
wheelbase given. What the folder holds is not driven again; the table is of all that it holds.
"""

import argparse
import contextlib
import io
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple
from unittest.mock import patch

import numpy as np

from steerd.car_model.car_file import Learned, default_car_path, load_car, update_car
from steerd.car_model.model import Model
from steerd.car_model.params import DEFAULT_CAR, Car
from steerd.daemon.assembly.build import make_world_config
from steerd.daemon.cli import main as cli
from steerd.daemon.offline import fast
from steerd.steer_bus.session_read import open_session
from steerd.sysid.data.dataset import read_run
from steerd.sysid.estimation.learn import Task, learn
from steerd.sysid.estimation.outcome import Outcome
from steerd.sysid.estimation.preparation import FitOptions, fit_wheelbase
from steerd.sysid.inference.plain_car import DEFAULT_FREE

NAMES = DEFAULT_FREE
FRAME_NS, STEP_NS = 20_000_000, 1_000_000


class Hidden(NamedTuple):
    """What a seed hides."""

    car: Car[float]
    phase_ns: int


def hide(seed: int) -> Hidden:
    """A car about the default one, and where in a frame its servo's pulses lie."""
    rng = np.random.default_rng([11, seed])

    def near(value: float, share: float) -> float:
        return float(value * rng.uniform(1.0 - share, 1.0 + share))

    base, lr = float(rng.uniform(0.30, 0.36)), float(rng.uniform(0.47, 0.57))
    car = DEFAULT_CAR._replace(
        lf=round(base * (1.0 - lr), 5),
        lr=round(base * lr, 5),
        c_sf=near(4.718, 0.15),
        c_sr=near(5.4562, 0.15),
        inertia_z=near(0.04712, 0.2),
        steer_gain=near(1.0, 0.05),
        steer_bias=float(rng.uniform(-0.01, 0.01)),
        steer_delay=float(rng.uniform(0.010, 0.025)),
        steer_lag=near(0.055, 0.4),
        speed_gain=near(1.0, 0.03),
        speed_lag=near(0.11, 0.4),
    )
    return Hidden(car, int(rng.integers(FRAME_NS // STEP_NS)) * STEP_NS)


@contextlib.contextmanager
def pulsed(phase_ns: int) -> Iterator[None]:
    """Simulated servos have their first pulse so late."""

    def world(*args: Any, **kwargs: Any) -> Any:
        config = make_world_config(*args, **kwargs)
        return replace(config, vesc=replace(config.vesc, servo_phase_ns=phase_ns))

    with patch.object(fast, "make_world_config", world):
        yield


def record(folder: Path, plan: str, seed: int) -> Path:
    """The seed's session, driven unless it is there."""
    session = folder / f"{plan}-{seed}.mcap"
    if session.exists():
        return session
    hidden, car_file = hide(seed), folder / f"{seed}.toml"
    values = {n: Learned(float(getattr(hidden.car, n)), None, "hidden") for n in NAMES}
    hidden_car = update_car(car_file, load_car(default_car_path()), values)
    car_file.write_text(hidden_car.text, encoding="utf-8")
    words = ["collect", "--sim", "--fast", "--plan", plan, "--seed", str(seed)]
    words += ["--car", str(car_file), "--record", str(session)]
    with pulsed(hidden.phase_ns), contextlib.redirect_stdout(io.StringIO()):
        if cli.run_cli(words):
            raise RuntimeError(f"seed {seed}: not driven")
    return session


def identify(session: Path, seed: int) -> Outcome:
    """As `steerd identify SESSION --wheelbase …` does."""
    car = hide(seed).car
    length = car.lf + car.lr
    base = fit_wheelbase(Model(DEFAULT_CAR), length)
    return learn(
        Task((read_run(open_session(session)),), base, FitOptions(wheelbase=length)), lambda: 0.0
    )


def pulls(outcome: Outcome, car: Car[float]) -> list[tuple[float, float]]:
    """Error and standard error of every parameter."""
    rows = [outcome.rows[name] for name in NAMES]
    return [
        (row.value - getattr(car, name), row.sd or np.nan)
        for name, row in zip(NAMES, rows, strict=True)
    ]


def say(found: np.ndarray, cars: list[Car[float]]) -> None:
    """The table; a fit that could not identify a parameter counts like any other."""
    error, sd = found[..., 0], found[..., 1]
    pull = error / sd
    true = np.array([[getattr(car, n) for n in NAMES] for car in cars])
    print(f"{len(found)} sessions")
    heads = ("spread of", "mean", "|error|", "median", "median")
    units = ("error/sd", "error/sd", "< 2 sd", "|error|", "sd")
    for words in (heads, units):
        print(f"{'':12s}" + "".join(f"{word:>11s}" for word in words))
    for k, name in enumerate(NAMES):
        spread = float(np.sqrt(np.mean(pull[:, k] ** 2)))
        inside = float(np.mean(np.abs(pull[:, k]) < 2.0))
        off, width = np.median(np.abs(error[:, k])), np.median(sd[:, k])
        if "_delay" in name or "_lag" in name:
            sizes = f"{1e3 * off:>8.3f} ms{1e3 * width:>8.3f} ms"
        elif name == "steer_bias":
            sizes = f"{1e3 * off:>6.3f} mrad{1e3 * width:>6.3f} mrad"
        else:
            share = 100.0 / np.median(np.abs(true[:, k]))
            sizes = f"{share * off:>9.3f} %{share * width:>9.3f} %"
        print(f"{name:12s}{spread:>11.2f}{pull[:, k].mean():>11.2f}{inside:>11.0%}{sizes}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--folder", type=Path, required=True)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--seeds", type=int, default=60)
    parser.add_argument("--plan", default="mixed")
    parser.add_argument("--drive-only", action="store_true")
    parser.add_argument("--verbose", action="store_true", help="error/sd of every session")
    args = parser.parse_args()
    args.folder.mkdir(parents=True, exist_ok=True)
    found, cars = [], []
    for seed in range(args.first, args.first + args.seeds):
        session = record(args.folder, args.plan, seed)
        if args.drive_only:
            continue
        car = hide(seed).car
        found.append(pulls(identify(session, seed), car))
        cars.append(car)
        if args.verbose:
            print(seed, np.round([a / b for a, b in found[-1]], 1).tolist(), flush=True)
    if found:
        say(np.array(found), cars)


if __name__ == "__main__":
    main()
