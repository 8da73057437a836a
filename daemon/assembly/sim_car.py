"""The simulated hardware's own car, of `--sim-car`: a file, or one that a seed hides.

A controller that is designed from the very car that it drives has nothing to learn. With a car of
its own, simulated hardware is to the controller what a car on the floor is.
"""

# Why: docs/decisions/processes-and-time.md#d67

import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from steerd.car_model.car_file import Learned, default_car_path, load_car, update_car
from steerd.car_model.effects import parse_effects
from steerd.car_model.model import Model
from steerd.car_model.params import Car
from steerd.daemon.common.errors import UsageError, refusing
from steerd.daemon.common.screen import clean
from steerd.daemon.settings.config import Settings, load_settings, make_settings
from steerd.daemon.settings.run_options import HIDDEN, recorded_options

SHARES: Mapping[str, float] = {
    "c_sf": 0.15, "c_sr": 0.15, "inertia_z": 0.2, "steer_gain": 0.08,
    "steer_lag": 0.3, "speed_gain": 0.04, "speed_lag": 0.3,
}  # fmt: skip
"""How far a hidden car may lie from the published one, as a share of the value. The axles are where
they are published: a tape measures them, and the mocap body was placed by them."""
BIAS = (0.02, 0.035)
"""Bounds of a hidden car's steering offset, to either side [rad]: 1.1 to 2 degrees, a linkage
that was screwed on by eye."""
DELAY = 0.02  # largest dead time that a hidden car's steering has beyond the published one's [s]
_STREAM = 17  # keeps these numbers apart from those of the simulated instruments' noise


def load_sim_car(spec: str) -> Settings:
    """The true car of a simulation, by a car file or `hidden:SEED`; a SteerdError for neither."""
    if not spec.startswith(HIDDEN):
        return load_settings(spec)
    seed = spec.removeprefix(HIDDEN)
    if not seed.isdecimal():
        what = f"--sim-car {spec}: the seed is a whole number"
        raise UsageError(what, f"--sim-car {HIDDEN}7, or a car file")
    published = load_car(default_car_path())
    car, rng = published.car, np.random.default_rng([_STREAM, int(seed)])
    values = {
        name: getattr(car, name) * rng.uniform(1.0 - share, 1.0 + share)
        for name, share in SHARES.items()
    }
    values["steer_bias"] = rng.choice((-1.0, 1.0)) * rng.uniform(*BIAS)
    values["steer_delay"] = car.steer_delay + rng.uniform(0.0, DELAY)
    updates = {name: Learned(float(f"{value:.4g}")) for name, value in values.items()}
    return make_settings(update_car(Path(f"{spec}.toml"), published, updates))


def make_true_model(settings: Settings, effects: tuple[str, ...]) -> Model[float]:
    """The simulated car: that of the settings, with the effects of `--effect` added.

    A SteerdError where an effect is unknown or its value is invalid.
    """
    file = settings.file
    with refusing("--effect: ", "`steerd effects` lists them"):
        added = parse_effects(",".join(effects)) if effects else []
    return Model(
        file.car,
        (*file.effects, *(effect for effect, _ in added)),
        (*file.values, *(values for _, values in added)),
        file.chassis,
    )


TRUTH = "steerd.truth"  # metadata of a session of simulated hardware: its car, by `make_truth`


def make_truth(model: Model[float]) -> dict[str, str]:
    """The simulated car as a session records it: every value by its name."""
    found = {name: repr(value) for name, value in model.car._asdict().items()}
    for effect, values in zip(model.effects, model.values, strict=True):
        for parameter, value in zip(effect.parameters, values, strict=True):
            found[f"{effect.name}.{parameter.name}"] = repr(value)
    return found | {"chassis": model.chassis.name}


def read_true_car(metadata: Mapping[str, Any]) -> Car[float] | None:
    """The parameters of a session's simulated car; None where there is none."""
    truth = metadata.get(TRUTH, {})
    try:
        return Car(**{name: float(truth[name]) for name in Car._fields})
    except (KeyError, ValueError):
        return None


def read_origin(metadata: Mapping[str, Any], *, own_car: bool = True) -> str:
    """The options of `steerd run` and `collect` that drive the car of a session again.

    Of simulated hardware they name its car and its effects, of a car its port and its mocap; with
    `own_car` also the session's car file: what is designed from another one says itself what its
    car is beyond the equations. There are none for the log of another system.
    """
    options = recorded_options(metadata)
    if options and options.simulated:
        words = ["--sim", "--fast", *(("--sim-car", options.sim_car) if options.sim_car else ())]
    elif options and options.port and options.mocap:
        words = ["--port", options.port, "--mocap", options.mocap]
    else:
        return ""
    if options.sim_car or own_car:
        words += [word for each in options.effects for word in ("--effect", each)]
    file = Path(options.car_file)
    if own_car and file.is_file() and file != default_car_path():
        words += ["--car", str(file)]
    return " ".join(shlex.quote(clean(word)) for word in words)


def compare_truths(named: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """What one car cannot have been: named sessions whose simulated cars differ, in sentences."""
    truths = {name: truth for name, data in named.items() if (truth := data.get(TRUTH))}
    remarks = []
    first, one = next(iter(truths.items()), ("", {}))
    for other, two in truths.items():
        names = [k for k in dict.fromkeys((*one, *two)) if one.get(k) != two.get(k)]
        if names:
            shown = (f"{k} {_short(one.get(k))} and {_short(two.get(k))}" for k in names[:3])
            more = f" and {len(names) - 3} more" if len(names) > 3 else ""
            remarks.append(
                f"{first} and {other} were driven on different simulated cars "
                f"({', '.join(shown)}{more}): one car cannot fit both"
            )
    return remarks


def _short(value: str | None) -> str:
    try:
        return "unset" if value is None else f"{float(value):.4g}"
    except ValueError:
        return str(value)
