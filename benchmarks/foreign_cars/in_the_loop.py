"""Sessions of the tool's own: lane keeping, recorded, of a car in MuJoCo; one later with a change.

    python -m benchmarks.foreign_cars.in_the_loop --cars 4 ../rows.jsonl

The control core drives, in virtual time and with every byte of VESC and NatNet, a figure-eight and
a circle of the healthy car by the class's car file, then a figure-eight with an effect by the
identified one. `identify` learns the first two, `diagnose` explains the third. Lane
keeping excites a car little: what such a drive does not distinguish must be said, not guessed.
"""

import argparse
import json
import math
import tempfile
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from joblib import Parallel, delayed

from benchmarks.blind_gap.drives import make_noise
from benchmarks.blind_gap.effects import Place
from benchmarks.blind_gap.plant import STEP
from benchmarks.foreign_cars.effects import label_of
from benchmarks.foreign_cars.judge import TOOL, ToolError, run_tool
from benchmarks.foreign_cars.mujoco_car import MujocoPlant, Stepper, make_mujoco
from steerd.car_model.car_file import default_car_path
from steerd.car_model.state import Observation, State
from steerd.daemon.assembly.build import make_plan, make_world_config
from steerd.daemon.offline.fast import record_virtual
from steerd.daemon.offline.virtual import drive
from steerd.daemon.settings.run_options import RunOptions
from steerd.sim_hw.plant.car import CarSetup, DelayLine, Demand, Drive
from steerd.sim_hw.world import World

FIRST_SEED = 7000
"""Cars that no other figure was taken from."""
SECONDS = 60.0
HEALTHY = (("figure8", 1.75), ("circle", 1.5))
LATER = ("figure8", 1.75)
"""Paths and speeds [m/s]."""
PUSH = 0.3
"""Disturbances, as for the other foreign cars."""
PARKED = 0.05
"""Below this rolling speed an order to stand keeps the car where it is [m/s]."""
EFFECTS = {
    "steer_bias": "medium", "steer_gain": "medium", "steer_delay": "medium",
    "steer_lag": "medium", "steer_backlash": "large", "tyre_friction": "large",
    "cornering_stiffness": "large", "speed_scale": "medium", "mocap_yaw": "medium",
    "mocap_latency": "medium", "marker_offset": "large",
}  # fmt: skip
"""What changes, and its size in the blind test."""
NOWHERE = Place()

Json = dict[str, Any]


class LoopCar:
    """A car in MuJoCo where simulated hardware expects its own (`sim_hw.plant.car.SimCar`).

    Attributes:
        setup: physics step and drag, as for the simulated car.
        t_ns: time of `state`.
        state: pose, speed, yaw rate and slip of the centre of gravity; the servo's angle.
        accel_x, accel_y: over the last step [m/s^2].
    """

    def __init__(self, plant: MujocoPlant, setup: CarSetup, seed: int, t_ns: int = 0) -> None:
        self.setup, self.t_ns, self._wiring = setup, t_ns, plant.wiring
        first = setup.start
        start = np.array([first.x, first.y, first.yaw, 0.0])
        self._stepper = Stepper(plant.car, plant.wiring, start)
        rng = np.random.default_rng([seed, 5])
        self._push = make_noise(4.0 * SECONDS, rng, process_scale=PUSH).process
        w = plant.wiring
        self._steer = DelayLine(round(1e9 * max(0.0, w.steer_delay - setup.servo_wait)), 0.0)
        self._speed = DelayLine(round(1e9 * w.drive_delay), 0.0)
        self._servo = self._linkage = w.steer_bias
        self._yaw, self.state, self.accel_x, self.accel_y = first.yaw, first, 0.0, 0.0
        self._history = [(t_ns, self.state)]

    def step(self, steer: float, demand: Demand) -> None:
        """One physics step under a servo angle [rad] and a demand."""
        t0, t1 = self.t_ns, self.t_ns + self.setup.step_ns
        self._steer.push(t0, steer)
        # A released or braked motor is one that is held at rest: no drive of interest rolls out.
        aim = demand.value if demand.drive is Drive.SPEED else 0.0
        self._speed.push(t0, self._wiring.speed_gain * aim)
        speed, angle = self._speed.mean(t0, t1), self._turn(self._steer.mean(t0, t1))
        before = self.state
        for _ in range(round(1e-9 * self.setup.step_ns / STEP)):
            at = round(1e-9 * t0 / STEP) % len(self._push)
            parked = speed == 0.0 and abs(self._stepper.rolling) < PARKED
            if not parked:
                self._stepper.step(angle, speed, False, self._push[at], 1e-9 * t0)
        self._note(before, t1, parked)

    def _turn(self, order: float) -> float:
        """Servo with lag and slew limit, linkage with play: a physics step of `wiring._servo`."""
        w, h = self._wiring, 1e-9 * self.setup.step_ns
        aim = min(max(w.steer_gain * order + w.steer_bias, -w.steer_right), w.steer_left)
        share = 1.0 - math.exp(-h / max(w.steer_lag, 1e-5))
        move = share * (aim - self._servo)
        self._servo += min(max(move, -w.steer_rate * h), w.steer_rate * h)
        half = 0.5 * w.steer_play
        self._linkage = min(max(self._linkage, self._servo - half), self._servo + half)
        bent = self._linkage + w.steer_asymmetry * abs(self._linkage)
        return bent + w.steer_cubic * self._linkage**3

    def _note(self, before: State[float], t_ns: int, parked: bool) -> None:
        data = self._stepper.data
        w, x, y, z = data.qpos[3:7]
        yaw = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
        self._yaw += math.remainder(yaw - self._yaw, math.tau)
        vx, vy, turn = (0.0, 0.0, 0.0) if parked else (*data.qvel[:2].tolist(), data.qvel[5])
        ahead = vx * math.cos(yaw) + vy * math.sin(yaw)
        side = vy * math.cos(yaw) - vx * math.sin(yaw)
        speed = math.copysign(math.hypot(vx, vy), ahead)
        slip = math.atan2(side, ahead) if ahead > PARKED else 0.0
        here = (float(data.qpos[0]), float(data.qpos[1]), self._yaw)
        self.state = State(*here, speed, float(turn), slip, self._linkage)
        h = 1e-9 * self.setup.step_ns
        self.accel_x, self.accel_y = (speed - before.speed) / h, speed * float(turn)
        self.t_ns = t_ns
        self._history = [*self._history[-400:], (t_ns, self.state)]

    def observe_pose(self, t_ns: int) -> Observation[float]:
        """The mocap body's pose as cameras exposed at ``t_ns`` show it."""
        w = self._wiring
        late = t_ns - round(1e9 * w.pose_delay)
        times = [t for t, _ in self._history]
        x, y, yaw = (
            float(np.interp(late, times, [state[i] for _, state in self._history]))
            for i in range(3)
        )
        x += math.cos(yaw) * w.marker_x - math.sin(yaw) * w.marker_y
        y += math.sin(yaw) * w.marker_x + math.cos(yaw) * w.marker_y
        return Observation(x, y, yaw + w.marker_yaw, self.wheel_speed, self.state.yaw_rate)

    def observe_motor(self) -> Observation[float]:
        """What motor controller and gyro measure now."""
        s = self.state
        return Observation(s.x, s.y, s.yaw, self.wheel_speed, s.yaw_rate)

    @property
    def speed(self) -> float:
        """True speed [m/s]."""
        return self.state.speed

    @property
    def wheel_speed(self) -> float:
        """The speed that the motor controller measures now [m/s]."""
        rolling = self._stepper.rolling if self.speed else 0.0
        return rolling / self._wiring.speed_gain


def record(plant: MujocoPlant, file: Path, path: str, speed: float, seed: int, out: Path) -> bool:
    """A drive in virtual time, as `steerd run` records it; whether nothing stopped it."""
    options = RunOptions(
        str(file), path=path, speed=speed, duration_s=SECONDS, record=str(out),
        seed=seed, simulated=True, auto_arm=True,
    )  # fmt: skip
    plan = make_plan(options)
    config = make_world_config(plan)
    world = World(config)
    car: Any = LoopCar(plant, config, seed)
    world.car = world.vesc.car = car
    return not record_virtual(plan, out, partial(drive), world=world).core.loop.faulted


def judge(seed: int, tool: str) -> list[Json]:
    """All drives of one car."""
    plant = make_mujoco(False, np.random.default_rng([1, seed]))
    rows = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        healthy = [folder / f"healthy{i}.mcap" for i in range(len(HEALTHY))]
        for i, (path, speed) in enumerate(HEALTHY):
            record(plant, default_car_path(), path, speed, 100 * seed + i, healthy[i])
        base, tape = folder / "car.toml", plant.truth["lf"] + plant.truth["lr"]
        words = ("-o", str(base), "--wheelbase", f"{tape:.3f}")
        run_tool(tool, "identify", *map(str, healthy), *words)
        for number, name in enumerate(("", *EFFECTS)):
            later, gap = folder / f"later{number}.mcap", folder / "gap.json"
            values = label_of(name, EFFECTS[name], NOWHERE) if name else {}
            car = plant.with_effect(name, values) if name else plant
            drove = record(car, base, *LATER, 100 * seed + 10 + number, later)
            kept = _diagnosed(tool, later, base, gap)
            rows.append({"seed": seed, "effect": name, "values": values, "drove": drove, **kept})
    return rows


def _diagnosed(tool: str, later: Path, base: Path, gap: Path) -> Json:
    try:
        run_tool(tool, "diagnose", str(later), "--base", str(base), "--json", str(gap))
    except ToolError as error:
        return {"verdict": "no verdict", "causes": [], "next_manoeuvre": {}, "error": str(error)}
    found = json.loads(gap.read_text())
    return {key: found[key] for key in ("verdict", "causes", "next_manoeuvre")}


def describe(rows: Sequence[Mapping[str, Any]]) -> str:
    """A line for each effect."""
    lines = ["| hidden | drives | named first | in the set | wrong at 0.8 | verdicts | to drive |"]
    lines.append("|---" * 7 + "|")
    for name in ("", *EFFECTS):
        mine = [row for row in rows if row["effect"] == name]
        if not mine:
            continue
        first = sum(names_of(row)[:1] == (name,) for row in mine)
        among = sum(name in set_of(row) for row in mine)
        wrong = sum(any(c["effect"] != name and c["confidence"] >= 0.8 for c in row["causes"])
                    for row in mine)  # fmt: skip
        verdicts = [str(row["verdict"]) for row in mine]
        said = ", ".join(f"{v} {verdicts.count(v)}" for v in dict.fromkeys(verdicts))
        further = sum(bool(row["next_manoeuvre"].get("command")) for row in mine)
        label = name or "nothing"
        lines.append(
            f"| {label} | {len(mine)} | {first} | {among} | {wrong} | {said} | {further} |"
        )
    return "\n".join(lines)


def names_of(row: Mapping[str, Any]) -> tuple[str, ...]:
    """What is named, first names first."""
    return tuple(cause["effect"] for cause in row["causes"])


def set_of(row: Mapping[str, Any]) -> set[str]:
    """What is named, and what is said not to be distinguishable from it."""
    return set(names_of(row)) | {n for cause in row["causes"] for n in cause["ambiguous_with"]}


def main() -> None:
    """Drive the cars that have no rows yet, and print the table of all rows."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("rows", type=Path)
    parser.add_argument("--cars", type=int, default=4)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--tool", default=TOOL)
    args = parser.parse_args()
    args.rows.touch()
    rows = [json.loads(line) for line in args.rows.read_text().splitlines()]
    done = {row["seed"] for row in rows}
    left = [s for s in range(FIRST_SEED, FIRST_SEED + args.cars) if s not in done]
    tasks = (delayed(judge)(seed, args.tool) for seed in left)
    for found in Parallel(n_jobs=args.jobs, return_as="generator_unordered")(tasks):
        rows += found
        with args.rows.open("a") as file:
            file.writelines(json.dumps(row) + "\n" for row in found)
    print(f"MuJoCo {mujoco.__version__}")
    print(describe(rows))


if __name__ == "__main__":
    main()
