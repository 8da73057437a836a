"""Value and gradient through simulated drives: torch, compiled kernel, plain C; and how they grow.

    python -m benchmarks.perf_simulation [--figure FILE.svg]

Sixteen runs of 4000 RK4 steps; the loss is the sum of squared positions, the gradient goes to all
parameters of the car. CPU time on one thread, but for the last row, which is wall time with as many
threads as there are cores. The torch reference and the paper's scalar loop are timed over fewer
steps and multiplied, as said in the names.
"""

import argparse
import json
import logging
import os
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from benchmarks.plain_c import make_plain_c
from benchmarks.timing import Timed, timed
from benchmarks.torch_reference import simulate_reference
from steerd.car_model.native.threads import threads
from steerd.car_model.native.windows import (
    HeldCommands,
    Kernels,
    make_kernels,
    make_window_blocks,
    march,
    march_back,
    view_by_window,
)
from steerd.car_model.params import Car
from steerd.sysid.paper import PAPER_CAR_DIRECT
from steerd.sysid.paper.paper_method import simulate

Array = NDArray[np.float64]
RUNS, STEPS, H = 16, 4000, 0.01
FEW, FEWEST = 200, 20
ALL_RUNS = (1, 4, 16, 64, 256)
ALL_STEPS = (250, 1000, 4000)
ALL_PARAMETERS = (4, 8, 16, 24)
CAR: Car[float] = PAPER_CAR_DIRECT


def make_task(runs: int, steps: int) -> tuple[Array, Array]:
    """First states (W, 7) and commands (W, N, 2): weaving at 1.2 m/s."""
    t = H * np.arange(steps)
    rates = np.linspace(0.2, 0.9, runs)[:, None]
    steer = 0.2 * np.sin(2.0 * np.pi * rates * t)
    first = np.zeros((runs, 7))
    first[:, 3] = 1.2
    return first, np.ascontiguousarray(np.stack([steer, np.full_like(steer, 1.2)], axis=-1))


def through_torch(run: Callable[..., Any], runs: int, steps: int) -> Callable[[], Any]:
    """Value and gradient of a simulation with a torch face."""
    first, commands = (torch.from_numpy(a) for a in make_task(runs, steps))

    def call() -> Any:
        parameters = torch.tensor(list(CAR), dtype=torch.float64, requires_grad=True)
        path = run(parameters, first, commands)
        loss = path[:, 1:, :2].square().sum()
        loss.backward()
        return loss.item(), parameters.grad

    return call


def kernel(kernels: Kernels, runs: int, steps: int) -> Callable[[], Any]:
    return through_torch(lambda p, f, c: simulate(kernels, p, f, c, H), runs, steps)


def reference(runs: int, steps: int) -> Callable[[], Any]:
    return through_torch(lambda p, f, c: simulate_reference(p, f, c, H), runs, steps)


def bare(kernels: Kernels, runs: int, steps: int) -> Callable[[], Any]:
    """March and march back without torch; the loss's derivative by the states is given."""
    first, commands = make_task(runs, steps)
    low = np.arange(runs) * steps
    blocks = make_window_blocks(np.stack([low, low + steps, low], axis=1), np.zeros(runs))
    held = HeldCommands(commands.reshape(-1, 2), H)
    parameters = np.array(CAR)
    bars = np.zeros((steps + 1, 7, blocks.slots))

    def call() -> Any:
        path = march(kernels, parameters, first, held, blocks, steps)
        np.multiply(path[:, :2], 2.0, out=bars[:, :2])
        return march_back(kernels, parameters, path, _seen(bars, runs), held, blocks)

    return call


def _seen(bars: Array, runs: int) -> Array:
    view: Array = view_by_window(bars, runs)
    return view


def agree(kernels: Kernels, plain: Any) -> float:
    """Largest relative difference of the values and gradients of the three, over few steps.

    The plain C loop has no dead times, hence no slopes by them.
    """
    value, slopes = reference(4, FEW)()
    timing = np.array([name.endswith("_delay") for name in Car._fields])
    others = [(*kernel(kernels, 4, FEW)(), slopes.numpy())]
    if plain is not None:
        found = plain(np.array(CAR), H, *make_task(4, FEW))
        others.append((*found, np.where(timing, 0.0, slopes.numpy())))
    scale = float(np.abs(slopes.numpy()).max())
    return max(
        max(abs(v / value - 1.0), float(np.abs(np.asarray(s) - right).max()) / scale)
        for v, s, right in others
    )


def ms(took: Timed) -> dict[str, float]:
    return {name: round(1e3 * value, 4) for name, value in took._asdict().items()}


def grow(kernels: Kernels) -> dict[str, list[tuple[int, float]]]:
    """Seconds by runs, steps and free parameters."""
    few = {"repeats": 5}
    differences = timed(bare(kernels, RUNS, 1000), **few).median / 2.0
    return {
        "kernel, runs": [(n, timed(kernel(kernels, n, STEPS), **few).median) for n in ALL_RUNS],
        "reference, runs": [
            (n, timed(reference(n, FEWEST), **few).median * STEPS / FEWEST) for n in ALL_RUNS
        ],
        "kernel, steps": [(n, timed(kernel(kernels, RUNS, n), **few).median) for n in ALL_STEPS],
        "reference, steps": [
            (n, timed(reference(RUNS, n // 10), **few).median * 10) for n in ALL_STEPS[:2]
        ],
        "kernel, parameters": [
            (n, timed(kernel(kernels, RUNS, 1000), **few).median) for n in ALL_PARAMETERS
        ],
        "central differences, parameters": [(n, 2 * n * differences) for n in ALL_PARAMETERS],
    }


def draw(growth: dict[str, list[tuple[int, float]]], path: str) -> None:
    """Growth on logarithmic axes."""
    from matplotlib.figure import Figure

    logging.getLogger("matplotlib.font_manager").setLevel(logging.ERROR)
    figure = Figure(figsize=(9.0, 3.2), layout="constrained")
    for axis, by in zip(figure.subplots(1, 3, sharey=True), ("runs", "steps", "parameters"),
                        strict=True):  # fmt: skip
        for name, points in growth.items():
            if name.endswith(by):
                n, seconds = zip(*points, strict=True)
                axis.loglog(n, np.multiply(seconds, 1e3), "o-", label=name.rsplit(",", 1)[0])
        here = [points for name, points in growth.items() if name.endswith(by)]
        shown = sorted({n for points in here for n, _ in points})
        axis.set(xlabel=by)
        axis.set_xticks(shown, [str(n) for n in shown])
        axis.set_xticks([], minor=True)
        axis.grid(visible=True, which="both", alpha=0.3)
        axis.legend(fontsize="small")
    figure.axes[0].set(ylabel="value and gradient [ms]")
    figure.savefig(path, metadata={"Date": None})


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--figure", metavar="FILE.svg")
    args = parser.parse_args()
    torch.set_num_threads(1)
    os.environ["OMP_NUM_THREADS"] = "1"
    kernels, plain = make_kernels(), make_plain_c()
    parameters, task = np.array(CAR), make_task(RUNS, STEPS)
    found = {
        "kernel through torch": timed(kernel(kernels, RUNS, STEPS)),
        "bare kernel": timed(bare(kernels, RUNS, STEPS)),
        "torch reference": timed(reference(RUNS, FEW), repeats=5).scaled(STEPS / FEW),
        "scalar torch loop": timed(reference(1, FEWEST), 5).scaled(RUNS * STEPS / FEWEST),
    }
    if plain is not None:
        found["plain C loop"] = timed(lambda: plain(parameters, H, *task))
    growth = grow(kernels)
    del os.environ["OMP_NUM_THREADS"]
    found[f"kernel through torch, {threads()} threads, wall"] = timed(
        kernel(kernels, RUNS, STEPS), clock=time.perf_counter
    )
    if args.figure:
        draw(growth, args.figure)
    print(
        json.dumps(
            {
                "apart": agree(kernels, plain),
                "ms": {name: ms(took) for name, took in found.items()},
                "growth_ms": {
                    name: [(n, round(1e3 * s, 4)) for n, s in points]
                    for name, points in growth.items()
                },
            }
        )
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
