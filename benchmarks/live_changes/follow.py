"""What `run --adapt` makes of a change: lane errors beside those of a design for the true car.

python -m benchmarks.live_changes.follow --seeds 2 rows.jsonl

Virtual time, simulated hardware with the library's own effects and disturbances, the car file as
identified. Three drives a change: the design of the file, that of the car as it is since then, and
the learner's. A mocap body slips within four seconds: at once, the poses stop the car (W5).
"""

import argparse
import json
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from steerd.car_model.car_file import default_car_path
from steerd.car_model.effects import parse_effects
from steerd.car_model.model import Model, believed_car
from steerd.car_model.path.path import locate, project
from steerd.controller.gains import design_table
from steerd.controller.learnt import Design, Learnt, learnt_car, learnt_of, learnt_timing
from steerd.daemon.assembly.build import VIRTUAL_EPOCH_NS, RunPlan, make_plan, make_world_config
from steerd.daemon.loop.adapting import make_design
from steerd.daemon.offline.fast import record_virtual
from steerd.daemon.offline.virtual import VirtualRun, drive
from steerd.daemon.settings.run_options import RunOptions
from steerd.sim_hw.plant.car import SimCar
from steerd.sim_hw.world import World
from steerd.sysid.inference.chart import RELATIVE
from steerd.sysid.inference.space import FLOORS, LIMITS

CHANGES = {
    "steer_gain": "steer_gain=0.88", "steer_bias": "steer_bias=0.02",
    "steer_delay": "steer_delay=0.04", "tyre_friction": "tyre_friction=0.6",
    "speed_scale": "speed_scale=0.95", "mocap_yaw": "mocap_yaw=0.03",
    "marker_offset": "marker_offset=0.03,0",
}  # fmt: skip
SLIPS, SLIP_S, SLIP_STEPS = ("mocap_yaw", "marker_offset"), 4.0, 40
"""Changes that come gradually, in so much time and so many steps."""
AT, LENGTH, JUDGED = 35.0, 75.0, 20.0
"""When the change comes, how long a drive is, and its last stretch, which is judged [s]."""
PUSHES = (0.1, 0.3, 0.03)
"""Disturbances of speed, yaw rate and slip, see `CarSetup.process_noise`."""
KINDS = ("file", "true", "adapt")


def make_car_file(folder: Path) -> Path:
    """The standard car with standard errors as identification leaves them."""
    from steerd.car_model.params import DEFAULT_CAR

    rows = [
        f"{name} = {floor * (abs(getattr(DEFAULT_CAR, name)) if name in RELATIVE else 1.0):.6g}"
        for name, floor in FLOORS.items()
        if name not in LIMITS
    ]
    path = folder / "car.toml"
    path.write_text(default_car_path().read_text() + "\n[car.sd]\n" + "\n".join(rows) + "\n")
    return path


def change_car(world: World, text: str, share: float) -> None:
    """Another car from now on, in the same place: so much of an effect."""
    chosen = parse_effects(text)
    values = tuple(
        tuple(null + share * (to - null) for to, null in zip(value, effect.nulls, strict=True))
        for effect, value in chosen
    )
    config, old = world.config, world.car
    model = config.model._replace(effects=tuple(effect for effect, _ in chosen), values=values)
    setup = replace(old.setup, start=old.state)
    world.car = world.vesc.car = SimCar(model, setup, old._noise, old.t_ns)  # noqa: SLF001


def true_design(plan: RunPlan, text: str) -> Design:
    """The lane keeper's own design for the car after a change."""
    (effect, value), file = parse_effects(text)[0], plan.controller
    model = plan.settings.file.model
    car = believed_car(Model(model.car, (effect,), (value,), model.chassis))
    grip = car.mu / model.car.mu
    numbers = learnt_of(car._replace(c_sf=car.c_sf * grip, c_sr=car.c_sr * grip))
    if effect.name == "mocap_yaw":
        numbers = numbers._replace(body_yaw=value[0])
    if effect.name == "marker_offset":
        numbers = numbers._replace(body_forward=value[0], body_left=value[1])
    table = design_table(
        learnt_car(file, numbers), file.config, learnt_timing(file, numbers), file.profile.fastest
    )
    return Design(numbers, table)


def follow(name: str, kind: str, seed: int, folder: Path) -> dict[str, Any]:
    """One drive: its lane error at the end, and what was followed."""
    text, out = CHANGES[name], folder / f"{name}_{kind}_{seed}.mcap"
    learns = kind == "adapt"
    options = RunOptions(
        str(make_car_file(folder)), speed=1.75, duration_s=LENGTH, record=str(out), seed=seed,
        simulated=True, auto_arm=True, learn=learns, adapt=kind != "file",
    )  # fmt: skip
    plan = make_plan(options)
    if not learns:
        plan = replace(plan, options=replace(options, learn=False))
    world = World(replace(make_world_config(plan), process_noise=PUSHES))
    at = AT + float(np.random.default_rng(seed).uniform(0.0, 5.0))
    design = true_design(plan, text) if kind == "true" else None
    errors: list[tuple[float, float]] = []
    taken: list[tuple[float, Learnt | None]] = []
    tick = _make_tick(
        world, plan, text, at, SLIP_S if name in SLIPS else 0.0, design, errors, taken
    )
    run = record_virtual(plan, out, lambda run: drive(run, tick), world=world)
    out.unlink()
    e = np.array(errors)
    late = e[:, 0] > e[-1, 0] - JUDGED
    since = [t - at for t, car in taken if car is not None and t > at]
    return {
        "change": name, "kind": kind, "seed": seed, "stopped": run.core.loop.faulted,
        "rms_mm": 1e3 * float(np.sqrt((e[late, 1] ** 2).mean())),
        "before_mm": 1e3 * float(np.sqrt((e[(e[:, 0] > 10.0) & (e[:, 0] < at), 1] ** 2).mean())),
        "followed_after_s": since[0] if since else None,
        "refused": run.core.designs.refused,
        "car": taken[-1][1]._asdict() if taken and taken[-1][1] is not None else None,
    }  # fmt: skip


def _make_tick(
    world: World,
    plan: RunPlan,
    text: str,
    at: float,
    slip_s: float,
    design: Design | None,
    errors: list[tuple[float, float]],
    taken: list[tuple[float, Learnt | None]],
) -> Callable[[VirtualRun], None]:
    """What happens at each tick: the change, the true design, and the judge's notes."""
    memory = {"hint": -1, "share": 0.0}

    def tick(run: VirtualRun) -> None:
        t = run.t_ns * 1e-9
        share = min(max((t - at) / slip_s, 0.0), 1.0) if slip_s else float(t >= at)
        share = round(share * SLIP_STEPS) / SLIP_STEPS
        if share > memory["share"]:
            memory["share"] = share
            change_car(world, text, share)
        if design is not None and t >= at and run.core.loop.adapting.held is not None:
            run.core.loop.on_design(make_design(run.t_ns, VIRTUAL_EPOCH_NS, 1, design), run.t_ns)
        state = world.car.state
        if memory["hint"] < 0:
            memory["hint"] = locate(plan.path, state.x, state.y, state.yaw).hint
        place = project(plan.path, state.x, state.y, int(memory["hint"]))
        memory["hint"] = place.hint
        errors.append((t, place.e1))
        now = run.core.loop.adapting
        car = now.car if now.follows else None
        if not taken or taken[-1][1] != car:
            taken.append((t, car))

    return tick


def main() -> None:
    """Drive what has no row yet."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("rows", type=Path)
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--changes", nargs="*", default=list(CHANGES))
    args = parser.parse_args()
    args.rows.touch()
    rows = [json.loads(line) for line in args.rows.read_text().splitlines()]
    done = {(row["change"], row["kind"], row["seed"]) for row in rows}
    for seed in range(args.seeds):
        for name in args.changes:
            for kind in KINDS:
                if (name, kind, seed) in done:
                    continue
                with tempfile.TemporaryDirectory() as folder:
                    row = follow(name, kind, seed, Path(folder))
                with args.rows.open("a") as file:
                    file.write(json.dumps(row) + "\n")


if __name__ == "__main__":
    main()
