"""Paper, CMA-ES, least squares and ours on the same data, in one run.

python -m benchmarks.identify [--starts 5] [--figure FILE.svg]

Data: the paper's sixteen circles (8 left, 8 right, steering at its limit, 1 m/s, 8 s) on the
paper's car, poses at 100 Hz with 1 mm / 2 mrad noise, at standard and low friction.

The mark, by a rule that no result has a say in: a method is there when it predicts circles of other
steering angles, which nobody fitted, as well as one pose is measured (1 mm, root mean square over
8 s, open loop, no noise). What these data cannot identify counts for nothing there; how each method
ends on slaloms, where it does count, is printed beside it. Every method uses the same compiled
simulator, and times are the process's own (CPU seconds), so they compare the methods, not the
languages. The paper's own code needs about 25 s for one iteration.
"""

import argparse
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray

from benchmarks.least_squares import fit_least_squares
from steerd.car_model.model import Model
from steerd.car_model.native.windows import (
    HeldCommands,
    Kernels,
    make_kernels,
    make_window_blocks,
    march,
    view_by_window,
)
from steerd.car_model.params import GRAVITY, Car
from steerd.sysid.data.dataset import Run, Signal, make_run
from steerd.sysid.data.segments import make_blocks
from steerd.sysid.estimation.outcome import Fit, fit_of_plain
from steerd.sysid.inference import predictor
from steerd.sysid.inference.plain_car import Asked, search_plain
from steerd.sysid.inference.predictor import Linear, Predictor
from steerd.sysid.inference.space import Space
from steerd.sysid.paper import NAMES, PAPER_CAR_DIRECT, SearchHistory, paper_method
from steerd.sysid.paper.paper_method import (
    PAPER_STEP,
    PaperProblem,
    PaperRun,
    batch_of,
    draw_starts,
    make_problem,
    paper_runs,
    search_adam,
    search_cma,
)

Array = NDArray[np.float64]

H = 0.01
SECONDS = 8.0
STEER = 0.34
NOISE = (1e-3, 1e-3, 2e-3)
"""Of poses [m, m, rad]."""
TARGET_MM = 1e3 * NOISE[0]
OTHER_ANGLES = (0.17, -0.17, 0.25, -0.25)
"""Steering of the circles that nobody fits [rad]."""
FRICTIONS = {"standard": 1.0489, "low": 0.5}
INTEGRATOR = "euler"
"""The data come from the paper's own simulator: Euler at 0.002 s."""


def drive(kernels: Kernels, car: Car[float], commands: Array, first: Array) -> Array:
    """States (N + 1, 7) every 0.01 s."""
    held = HeldCommands(commands, H, round(H / PAPER_STEP), INTEGRATOR)
    blocks = make_window_blocks(np.array([[0, len(commands), 0]]), np.zeros(1))
    steps = len(commands) * held.substeps
    path = march(kernels, np.array(car), first[None], held, blocks, steps)
    return np.ascontiguousarray(view_by_window(path, 1)[0, :: held.substeps])


def circles(kernels: Kernels, car: Car[float], rng: np.random.Generator) -> list[Run]:
    """The sixteen, already turning when they begin, as in the paper's data."""
    runs = []
    for number in range(16):
        steer = STEER if number < 8 else -STEER
        commands = np.tile([steer, 1.0], (round(SECONDS / H), 1))
        lead = drive(
            kernels, car, commands, np.array([0.0, 0.0, rng.uniform(-3, 3), 1, 0, 0, steer])
        )
        states = drive(kernels, car, commands, lead[-1])
        t = H * np.arange(len(states))
        noise = rng.normal(0.0, 1.0, (len(t), 3)) * NOISE
        held = H * np.arange(len(commands))
        runs.append(
            make_run(
                f"circle {number}",
                Signal(held, commands[:, 0]),
                Signal(held, commands[:, 1]),
                Signal(t, states[:, :3] + noise),
                h=H,
            )
        )
    return runs


@dataclass(frozen=True)
class Test:
    """A drive that nobody fits: commands, first state, and where the true car goes."""

    commands: Array
    first: Array
    true: Array


@dataclass
class Judge:
    """Noise-free drives that nobody fits, and a clock."""

    kernels: Kernels
    truth: Car[float]
    began: float = 0.0
    log: list[tuple[int, float, float]] = field(default_factory=list)

    def __post_init__(self) -> None:
        t = H * np.arange(round(SECONDS / H))
        straight = np.array([0.0, 0, 0, 1, 0, 0, 0])
        waves = [0.2 * np.sin(2 * np.pi * f * t) for f in (0.3, 0.5, 0.8, 1.2)]
        self.slaloms = [self._test(steer, straight) for steer in waves]
        self.circles = []
        for angle in OTHER_ANGLES:
            steer = np.full_like(t, angle)
            lead = self._test(steer, np.array([0.0, 0, 0, 1, 0, 0, angle]))
            self.circles.append(self._test(steer, lead.true[-1]))

    def _test(self, steer: Array, first: Array) -> Test:
        commands = np.column_stack([steer, np.ones_like(steer)])
        return Test(commands, first, drive(self.kernels, self.truth, commands, first))

    def _apart_mm(self, four: Array, tests: list[Test]) -> float:
        car = self.truth._replace(**dict(zip(NAMES, four.tolist(), strict=True)))
        off = [
            drive(self.kernels, car, test.commands, test.first)[:, :2] - test.true[:, :2]
            for test in tests
        ]
        apart = np.clip(np.nan_to_num(np.concatenate(off), nan=1e3), -1e3, 1e3)
        return float(1e3 * np.sqrt(np.mean(np.sum(apart**2, axis=1))))

    def error_mm(self, four: Array) -> float:
        """On circles of other angles: what these data identify."""
        return self._apart_mm(four, self.circles)

    def slalom_mm(self, four: Array) -> float:
        """On slaloms: also what they cannot."""
        return self._apart_mm(four, self.slaloms)

    def start(self) -> None:
        self.log, self.began = [], time.process_time()

    def watch(self, iteration: int, four: Array, loss: float) -> bool:
        paused = time.process_time()
        self.log.append((iteration + 1, paused - self.began, self.error_mm(four)))
        self.began += time.process_time() - paused
        return False

    def reached(self) -> tuple[int, float] | None:
        return next(((i, s) for i, s, e in self.log if e <= TARGET_MM), None)


def search_timed(judge: Judge, search: Callable[[], SearchHistory], best: bool) -> Array:
    """Where a search ends; `judge` sees each iteration's point, or the best until then."""
    times: list[float] = []

    def seen(problem: PaperProblem, iteration: int) -> tuple[PaperRun, ...]:
        times.append(time.process_time())
        return batch_of(problem, iteration)

    with patch.object(paper_method, "batch_of", seen):
        found = search()
    ends = np.array([*times[1:], time.process_time()]) - times[0]
    for i, end in enumerate(ends[: len(found.losses)].tolist()):
        four = found.path[1 + (int(np.argmin(found.losses[: i + 1])) if best else i)]
        judge.log.append((i + 1, end, judge.error_mm(four)))
    return found.final


@contextmanager
def watched(judge: Judge) -> Iterator[None]:
    """Our search shows only its end: here every point is watched at which it takes derivatives."""
    linear = Predictor.linear

    def seen(self: Predictor, space: Space, z: Array, x: Array) -> Linear:
        found = linear(self, space, z, x)
        four = space.chart.parameters(z)[[space.chart.names.index(name) for name in NAMES]]
        judge.watch(len(judge.log), four, 0.0)
        return found

    judge.start()
    with patch.object(Predictor, "linear", seen):
        yield


@contextmanager
def as_simulated() -> Iterator[None]:
    """Our windows integrated as the data are."""
    with (
        patch.object(predictor, "INTEGRATOR", INTEGRATOR),
        patch.object(predictor, "stable_substeps", lambda *given: round(H / PAPER_STEP)),
    ):
        yield


def ours(runs: list[Run], base: Car[float], start: Array) -> Fit:
    car = base._replace(**dict(zip(NAMES, start.tolist(), strict=True)))
    asked, blocks = Asked(Model(car), NAMES), make_blocks(runs)
    with as_simulated():
        rough = search_plain(blocks, asked)
        found = rough and search_plain(blocks, asked, rough)
        if not found:
            raise FloatingPointError("the simulation diverges")
        return fit_of_plain(found, blocks, asked, ())


def _said(reached: tuple[int, float] | None) -> str:
    return "-" if reached is None else f"{reached[0]:4d} it {reached[1]:7.2f} s"


def _line(judge: Judge, name: str, number: int, final: Array, seconds: float) -> None:
    mark = f"{_said(judge.reached()):>17}"
    ends = f"{judge.error_mm(final):12.3f} mm {judge.slalom_mm(final):12.3f} mm"
    print(f"{name:<10} {number:>5}  {mark}  {seconds:6.2f} s {ends}")


def race(judge: Judge, runs: list[Run], base: Car[float], starts: Array) -> dict[str, list[Array]]:
    """Every method from every start; prints a line each."""
    problem: PaperProblem = make_problem(paper_runs(runs), base)
    searches: dict[str, Callable[[Array], Array]] = {
        "paper": lambda s: search_timed(judge, lambda: search_adam(problem, s), best=False),
        "CMA-ES": lambda s: search_timed(judge, lambda: search_cma(problem, s), best=True),
        "least sq.": lambda s: fit_least_squares(problem, s, judge.watch).final,
    }
    finals: dict[str, list[Array]] = {name: [] for name in (*searches, "ours")}
    heads = f"{f'to {TARGET_MM:g} mm':>17}  {'all':>8} {'end, circles':>15} {'end, slaloms':>15}"
    print(f"{'method':<10} {'start':>5}  {heads}")
    for number, start in enumerate(starts, 1):
        for name, search in searches.items():
            judge.start()
            finals[name].append(search(start))
            _line(judge, name, number, finals[name][-1], judge.log[-1][1] if judge.log else np.nan)
        final, seconds = ours_watched(judge, runs, base, start)
        finals["ours"].append(final)
        _line(judge, "ours", number, final, seconds)
    return finals


def ours_watched(
    judge: Judge, runs: list[Run], base: Car[float], start: Array
) -> tuple[Array, float]:
    """Where our fit ends and what it costs; `judge` has seen its simulations."""
    began = time.process_time()
    ours(runs, base, start)
    seconds = time.process_time() - began
    with watched(judge):
        found = ours(runs, base, start)
    return np.array([getattr(found.model.car, name) for name in NAMES]), seconds


def sums(four: Array, mu: float, speed: float = 1.0) -> Array:
    """The two combinations that circles at one speed determine [m]."""
    lf, lr, cf, cr = four
    share = speed**2 / (mu * GRAVITY)
    return np.array([lf + lr + share * (1.0 / cf - 1.0 / cr), lr - share / cr])


def table(truth: Car[float], mu: float, finals: dict[str, list[Array]], starts: Array) -> None:
    """The paper's table, and what stands behind it."""
    true = np.array([getattr(truth, name) for name in NAMES])
    print(f"\n{'':<10}" + "".join(f"{name:>18}" for name in (*NAMES, "K [m]", "lr' [m]")))
    for name, values in {"true": [true], **finals}.items():
        rows = np.array([np.concatenate([v, sums(v, mu)]) for v in values])
        spread = rows.std(axis=0)
        cells = [f"{m:.4f} ±{s:.4f}" if len(rows) > 1 else f"{m:.4f}"
                 for m, s in zip(np.median(rows, axis=0), spread, strict=True)]  # fmt: skip
        print(f"{name:<10}" + "".join(f"{cell:>18}" for cell in cells))
    print("error of the two sums [%], largest over the starts:")
    for name, values in finals.items():
        off = np.array([100.0 * (sums(v, mu) / sums(true, mu) - 1.0) for v in values])
        print(f"{name:<10} {np.abs(off).max(axis=0).round(4)}")
    for name, values in finals.items():
        ends = np.array(values)
        pairs = [float(np.corrcoef(starts[:, i], ends[:, i])[0, 1]) for i in (2, 3)]
        print(f"{name:<10} correlation of final with initial C_Sf, C_Sr: {np.round(pairs, 3)}")


def draw(path: str, starts: Array, finals: dict[str, list[Array]], true: Array) -> None:
    """Final stiffness against the random initial stiffness."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.0, 3.6), layout="constrained")
    for axis, i in zip(figure.subplots(1, 2), (2, 3), strict=True):
        for name, values in finals.items():
            axis.plot(starts[:, i], np.array(values)[:, i], "o", label=name)
        axis.plot([2, 10], [2, 10], color="0.7", lw=0.8)
        axis.axhline(true[i], color="k", lw=0.8)
        axis.set(xlabel=f"initial {NAMES[i]}", ylabel=f"final {NAMES[i]} (line: true)")
    axis.legend()
    figure.savefig(path)
    print(f"figure: {path}")


def converge(runs: list[Run], truth: Car[float], starts: Array) -> None:
    """Our fit alone, from many starts: does each find the sums, and say what it does not know?"""
    true = sums(np.array([getattr(truth, name) for name in NAMES]), truth.mu)
    rows = []
    for start in starts:
        began = time.process_time()
        found = ours(runs, truth, start)
        seconds = time.process_time() - began
        four = np.array([getattr(found.model.car, name) for name in NAMES])
        off = 100.0 * np.abs(sums(four, truth.mu) / true - 1.0).max()
        untold = sum(not e.identifiable for e in found.estimates.values())
        rows.append((found.converged, untold, off, seconds))
    done, few, worst, took = map(np.array, zip(*rows, strict=True))
    print(f"ours, {len(starts)} starts: converged {done.sum()}, worst sum {worst.max():.4f} % off,")
    print(f"   says that it does not know {few.min()} to {few.max()} of the four;")
    print(f"   {np.median(took):.2f} ({took.min():.2f} to {took.max():.2f}) s")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--starts", type=int, default=5)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--ours", type=int, metavar="N", help="no race: our fit from N starts")
    parser.add_argument("--figure", metavar="FILE.svg")
    args = parser.parse_args()
    kernels = make_kernels()
    starts = draw_starts(np.random.default_rng(args.seed + 1), args.ours or args.starts)
    for floor, mu in FRICTIONS.items():
        truth = PAPER_CAR_DIRECT._replace(mu=mu)
        runs = circles(kernels, truth, np.random.default_rng(args.seed))
        ours(runs, truth, starts[0])  # compiled kernels in memory, for all methods
        print(f"\n== sixteen circles, {floor} friction (mu = {mu})")
        if args.ours:
            converge(runs, truth, starts)
            continue
        finals = race(Judge(kernels, truth), runs, truth, starts)
        table(truth, mu, finals, starts)
        found = ours(runs, truth, starts[0])
        print("ours says of itself:")
        for name, e in found.estimates.items():
            print(
                f"   {name:<6} {e.value:8.4f} ± {e.sd:.4f}"
                + ("" if e.identifiable else "  not identifiable")
            )
        for c in found.combinations:
            print(f"   {c.text} = {c.value:.5f} ± {c.sd:.5f} m")
        if args.figure and floor == "standard":
            draw(args.figure, starts, finals, np.array([getattr(truth, n) for n in NAMES]))


if __name__ == "__main__":
    main()
