"""Forward sensitivities of the same windows by CasADi and by the compiled kernels, in one run.

CasADi is no dependency: `pip install casadi` (3.8) and a C compiler first. The equations are
`car_model`'s own, recorded in CasADi's SX numbers; step, windows, parameters and derivatives are
those of `steerd.car_model.native.windows.compute_readings`. Results must agree to 1e-9. One thread
each. Outcome: docs/explanation/compiled-library.md.

    python benchmarks/perf_casadi.py [--windows 16] [--steps 200] [--rounds 15]
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

os.environ["OMP_NUM_THREADS"] = "1"

import casadi as ca
import numpy as np

from steerd.car_model.model import Model, Moment, delays, observe
from steerd.car_model.native.windows import (
    HeldCommands,
    Stations,
    Windows,
    compute_readings,
    make_kernels,
    parameter_vector,
)
from steerd.car_model.params import DEFAULT_CAR, Car
from steerd.car_model.rollout import step
from steerd.car_model.state import Command, State

H = 0.005
CAR = DEFAULT_CAR._replace(steer_delay=0.013, drive_delay=0.004)
PARAMETERS, STATES, READINGS = len(Car._fields), len(State._fields), 5
DIRECTIONS = PARAMETERS + STATES


class CasadiOps:
    """`Ops` over CasADi's SX."""

    sin, cos, tan = staticmethod(ca.sin), staticmethod(ca.cos), staticmethod(ca.tan)
    atan, tanh, exp = staticmethod(ca.atan), staticmethod(ca.tanh), staticmethod(ca.exp)
    sqrt, absolute = staticmethod(ca.sqrt), staticmethod(ca.fabs)
    minimum, maximum = staticmethod(ca.fmin), staticmethod(ca.fmax)

    @staticmethod
    def clip(a: Any, low: Any, high: Any) -> Any:
        return ca.fmin(ca.fmax(a, low), high)

    @staticmethod
    def where_positive(condition: Any, then: Any, otherwise: Any) -> Any:
        return ca.if_else(condition > 0.0, then, otherwise)


def make_step() -> ca.Function:
    """One step with its readings: state, parameters, two newest commands of both channels."""
    x, p, u = ca.SX.sym("x", STATES), ca.SX.sym("p", PARAMETERS), ca.SX.sym("u", 4)
    model = Model(Car(*ca.vertsplit(p)))
    late = delays(model)
    whole = [int(np.floor(d / H)) for d in (CAR.steer_delay, CAR.drive_delay)]
    parts = [d / H - w for d, w in zip((late.steer, late.drive), whole, strict=True)]
    command = Command(*(u[2 * i] + parts[i] * (u[2 * i + 1] - u[2 * i]) for i in range(2)))
    state = State(*ca.vertsplit(x))
    after = ca.vertcat(*step(CasadiOps(), model, Moment(state), command, 0.0, H).state)
    share = 1.0 - (late.pose - CAR.pose_delay) / H
    pose = observe(CasadiOps(), model, State(*ca.vertsplit(x + share * (after - x))))[:3]
    rest = observe(CasadiOps(), model, State(*ca.vertsplit(after)))[3:]
    return ca.Function("step", [x, p, u], [after, ca.vertcat(*pose, *rest)])


def make_variational(one: ca.Function, steps: int) -> ca.Function:
    """The step and its first-order variation as one expression, accumulated over a window."""
    x, p, u = ca.SX.sym("x", STATES), ca.SX.sym("p", PARAMETERS), ca.SX.sym("u", 4)
    s = ca.SX.sym("s", STATES, DIRECTIONS)
    after, seen = one(x, p, u)
    seeds = ca.horzcat(ca.DM.eye(PARAMETERS), ca.DM.zeros(PARAMETERS, STATES))

    def vary(out: Any) -> Any:
        return ca.mtimes(ca.jacobian(out, x), s) + ca.mtimes(ca.jacobian(out, p), seeds)

    both = ca.vertcat(x, ca.vec(s))
    whole = ca.Function(
        "varied", [both, u, p],
        [ca.densify(ca.vertcat(after, ca.vec(vary(after)))), seen, ca.densify(vary(seen))],
        {"cse": True},
    )  # fmt: skip
    return whole.mapaccum("window", steps)


def _cpu_seconds() -> float:
    """Of this process and its children, such as the C compiler [s]."""
    return sum(os.times()[:4])


def compile_c(function: ca.Function, folder: Path, flags: str) -> tuple[ca.Function, float, int]:
    """The function from C code: itself, CPU seconds to compile, size of the C file."""
    here = Path.cwd()
    os.chdir(folder)
    try:
        began = _cpu_seconds()
        function.generate(f"{function.name()}.c")
        subprocess.run(
            ["cc", *flags.split(), "-shared", "-fPIC", f"{function.name()}.c", "-o",
             f"{function.name()}.so", "-lm"], check=True,
        )  # fmt: skip
        seconds = _cpu_seconds() - began
        size = Path(f"{function.name()}.c").stat().st_size
        loaded = ca.external(function.name(), str(folder / f"{function.name()}.so"))
    finally:
        os.chdir(here)
    return loaded, seconds, size


class Case:
    """Windows over random commands."""

    def __init__(self, windows: int, steps: int) -> None:
        rng = np.random.default_rng(1)
        rows = steps + 20 * windows + 40
        steer = np.repeat(rng.uniform(-0.3, 0.3, rows // 10 + 1), 10)[:rows]
        speed = np.repeat(rng.uniform(1.0, 2.5, rows // 20 + 1), 20)[:rows]
        self.commands = np.column_stack([steer, speed])
        self.first = np.c_[
            rng.normal(size=(windows, 3)), rng.uniform(1.0, 2.0, (windows, 1)),
            0.1 * rng.normal(size=(windows, 3)),
        ]  # fmt: skip
        self.starts, self.steps = 20 + 20 * np.arange(windows), steps
        self.parameters = np.array(CAR, float)

    def ours(self) -> Callable[[], tuple[Any, Any]]:
        count, steps, width = len(self.starts), self.steps, READINGS
        kernels, p = make_kernels(), parameter_vector(Model(CAR))
        held = HeldCommands(self.commands, H)
        every = np.zeros(count, np.int64)
        spans = np.stack(
            [every, every + len(self.commands), self.starts, every + steps, every], axis=1
        )
        places, shares = [], []
        for w in range(count):
            for k in range(steps):
                row = (w * steps + k) * width
                places += [(k, 0, row, 1), (k, 3, row + 3, 0), (k, 4, row + 4, 0)]
                shares += [1.0, 1.0, 1.0]
        stations = Stations(
            np.array(places, np.int64), np.array(shares), 3 * steps * np.arange(count + 1),
            count * steps * width,
        )  # fmt: skip
        seeds = np.eye(PARAMETERS, DIRECTIONS)
        dfirst = np.eye(STATES, DIRECTIONS, PARAMETERS)
        windows = Windows(spans, np.zeros(count))
        return lambda: compute_readings(
            kernels, p, seeds, self.first, dfirst, held, windows, stations
        )

    def command_columns(self, w: int) -> Any:
        whole = [int(np.floor(d / H)) for d in (CAR.steer_delay, CAR.drive_delay)]
        k = self.starts[w] + np.arange(self.steps)
        return np.stack([self.commands[k - whole[i] - j, i] for i in (0, 1) for j in (0, 1)])

    def variational(self, function: ca.Function) -> Callable[[], tuple[Any, Any]]:
        count, steps = len(self.starts), self.steps
        s = np.eye(STATES, DIRECTIONS, PARAMETERS)
        both = [np.concatenate([x, s.ravel("F")]) for x in self.first]
        commands = [self.command_columns(w).ravel("F") for w in range(count)]
        p = np.tile(self.parameters, steps)
        out = [np.empty(function.numel_out(i)) for i in range(3)]
        buffer, call = function.buffer()
        for i, array in enumerate(out):
            buffer.set_res(i, memoryview(array))
        y = np.empty((count, steps, READINGS))
        jy = np.empty((count, steps, READINGS, DIRECTIONS))

        def run() -> tuple[Any, Any]:
            for w in range(count):
                buffer.set_arg(0, memoryview(both[w]))
                buffer.set_arg(1, memoryview(commands[w]))
                buffer.set_arg(2, memoryview(p))
                call()
                y[w] = out[1].reshape(steps, READINGS)
                jy[w] = out[2].reshape(steps, DIRECTIONS, READINGS).transpose(0, 2, 1)
            return y.reshape(-1), jy.reshape(-1, DIRECTIONS)

        return run


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--windows", type=int, default=16)
    parser.add_argument("--steps", type=int, default=200)
    parser.add_argument("--rounds", type=int, default=15)
    args = parser.parse_args()
    case, found = Case(args.windows, args.steps), {}
    ours = case.ours()
    began = _cpu_seconds()
    want = ours()
    found["kernel_first_call_s"] = _cpu_seconds() - began
    one = make_step()
    began = time.perf_counter()
    window = make_variational(one, args.steps)
    found["casadi_build_s"] = time.perf_counter() - began
    jobs = {"kernel": ours, "sx_vm": case.variational(window)}
    folder = Path(tempfile.mkdtemp(prefix="casadi-"))
    for label, flags in {"c_o1": "-O1", "c_o3": "-O3 -march=native"}.items():
        target = folder / label
        target.mkdir()
        loaded, seconds, size = compile_c(window, target, flags)
        found[f"{label}_compile_s"], found["c_bytes"] = seconds, size
        jobs[label] = case.variational(loaded)
    for name, job in jobs.items():
        y, jy = job()
        off = np.abs(jy - want[1]).max() / np.abs(want[1]).max()
        assert np.abs(y - want[0]).max() < 1e-9, name
        assert off < 1e-9, (name, off)
    times: dict[str, list[float]] = {name: [] for name in jobs}
    for _ in range(args.rounds):
        for name, job in jobs.items():
            began = time.thread_time()
            job()
            times[name].append(time.thread_time() - began)
    table = np.array([times[name] for name in jobs])
    found["ms"] = {n: round(1e3 * float(v.min()), 3) for n, v in zip(jobs, table, strict=True)}
    ratios = np.median(table / table[0], axis=1)
    found["ratio"] = {n: round(float(r), 2) for n, r in zip(jobs, ratios, strict=True)}
    print(json.dumps(found, indent=1))
    return 0


if __name__ == "__main__":
    sys.exit(main())
