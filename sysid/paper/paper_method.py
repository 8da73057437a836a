"""The paper's method: soft-DTW and chamfer distance of simulated and driven paths, by Adam.

"System Identification and Control of Front-Steered Ackermann Vehicles through Differentiable
Physics", IROS 2023: l_f, l_r, C_Sf, C_Sr of a car whose steering and speed follow at once, Euler at
0.002 s, loss = soft-DTW (gamma 0.1, every 0.2 s) + 100 chamfer (every step) in metres, averaged
over batches of 4 runs that rotate. What the paper leaves open (step sizes, the rotation, the runs'
starts at zero yaw rate and slip) is as in its authors' public experiments, and so is their own
baseline, the same loss by CMA-ES. Soft-DTW (Cuturi and Blondel, ICML 2017, algorithm 1) is the soft
minimum `-gamma log sum exp(-cost / gamma)` over all monotone alignments. It may be negative.
"""

import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor
from torch.autograd.function import once_differentiable

from steerd.car_model.native import windows as compiled
from steerd.car_model.params import Car
from steerd.sysid.data.data_checks import Array
from steerd.sysid.data.dataset import Run
from steerd.sysid.data.windows import guess_state
from steerd.sysid.paper import NAMES, PAPER_CAR_DIRECT, SearchHistory

PAPER_STEP = 0.002  # Euler step of the paper's simulator [s]
LOW = np.array([0.1, 0.1, 2.0, 2.0])
HIGH = np.array([0.35, 0.35, 10.0, 10.0])
"""Starts are uniform in between (the paper's 2.857 to 10, divided by 28.57, for the lengths)."""
RATES = np.array([1.5 / 28.57, 1.5 / 28.57, 0.2, 0.2])  # Adam's steps, in the parameters' units
CHAMFER_WEIGHT = 100.0
BATCH = 4
STRIDE = 100  # steps between the points that soft-DTW aligns (0.2 s)
SECONDS = 8.0  # length of the paper's runs [s]
DURATION_MIN = 2.0  # shorter runs are left out [s]
MOVING = 0.3  # runs are where the speed command is above this [m/s]
CMA_SIGMA = 3.0  # first spread, as in the paper's authors' experiments
LENGTH_SCALE = 28.57  # they search lengths times this, so that all four parameters lie in 2 to 10
SCALE = np.array([LENGTH_SCALE, LENGTH_SCALE, 1.0, 1.0])

PAPER_GAMMA = 0.1  # softness in the paper [m^2]
_FAR = 1e30  # cost of what is no cell of the table; infinite ones have no gradient


class PaperRun(NamedTuple):
    """One piece of a drive as the paper's loss sees it."""

    commands: Array  # (N, 2) steer and speed at the steps
    path: Array  # (N, 2) driven x and y at the steps [m]
    first: Array  # (7,) first state; yaw rate and slip are zero, as in the paper


def paper_runs(runs: Sequence[Run]) -> tuple[PaperRun, ...]:
    """Split drives into the paper's runs: `SECONDS` long, with a speed command.

    Raises:
        ValueError: nothing long enough is left.
    """
    found: list[PaperRun] = []
    for run in runs:
        moving = np.concatenate([[False], run.commands[:, 1] > MOVING, [False]])
        edges = np.flatnonzero(np.diff(moving.astype(int)))
        for low, high in zip(edges[::2] * run.h, edges[1::2] * run.h, strict=True):
            ends = pairwise(np.linspace(low, high, max(1, round((high - low) / SECONDS)) + 1))
            found += [_piece(run, a, b) for a, b in ends if b - a >= DURATION_MIN]
    if not found:
        raise ValueError(f"no {DURATION_MIN:g} s with a speed command")
    return tuple(found)


def _piece(run: Run, low: float, high: float) -> PaperRun:
    t = low + PAPER_STEP * np.arange(int((high - low) / PAPER_STEP))
    rows = np.minimum((t / run.h + 1e-9).astype(int), len(run.commands) - 1)
    path = np.column_stack([np.interp(t, run.pose.t, run.pose.values[:, i]) for i in (0, 1)])
    first = guess_state(run.pose, low)
    first[4:6] = 0.0
    first[:2], first[6] = path[0], run.commands[rows[0], 0]
    return PaperRun(run.commands[rows], path, first)


class PaperProblem(NamedTuple):
    """The paper's loss over some runs."""

    kernels: compiled.Kernels  # the compiled car without effects
    runs: tuple[PaperRun, ...]  # at least one
    base: Array  # (P,) parameters; those of `NAMES` are replaced


def make_problem(runs: tuple[PaperRun, ...], base: Car[float] = PAPER_CAR_DIRECT) -> PaperProblem:
    """The paper's problem about a car whose actuators follow at once."""
    return PaperProblem(compiled.make_kernels(), runs, np.array(base, float))


# -- the loss: simulated paths, distances of two paths ---------------------------------------------


def simulate(
    kernels: compiled.Kernels,
    parameters: Tensor,
    first: Tensor,
    commands: Tensor,
    h: float,
    integrator: str = "rk4",
) -> Tensor:
    """States (B, N + 1, STATES + memory) of windows side by side, as `benchmarks.torch_reference`.

    From parameters (P,), `first` states (B, STATES + memory) and commands (B, N, 2), each held over
    a step of `h` [s]. The states are a view whose innermost axis in memory is B.

    Raises:
        TypeError: a tensor is not float64.
    """
    if {parameters.dtype, first.dtype, commands.dtype} != {torch.float64}:
        raise TypeError("parameters, first states and commands must be float64")
    count, length = commands.shape[:2]
    low = np.arange(count) * length
    blocks = compiled.make_window_blocks(
        np.stack([low, low + length, low], axis=1), np.zeros(count)
    )
    orders = np.ascontiguousarray(commands.detach().numpy()).reshape(-1, 2)
    held = compiled.HeldCommands(orders, h, 1, integrator)
    path: Tensor = _Simulate.apply(parameters, first, commands, kernels, held, blocks, length)  # type: ignore[no-untyped-call]
    return path


class _Simulate(torch.autograd.Function):
    """March and march back; everything stays in the kernels' layout, so nothing is copied."""

    @staticmethod
    def forward(ctx: Any, parameters: Tensor, first: Tensor, commands: Tensor, *about: Any) -> Any:
        """March."""
        kernels, held, blocks, steps = about
        values, begin = (np.ascontiguousarray(t.detach().numpy()) for t in (parameters, first))
        path = compiled.march(kernels, values, begin, held, blocks, steps)
        ctx.state = (kernels, values, path, held, blocks)
        return compiled.view_by_window(torch.from_numpy(path), len(commands))

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, bars: Tensor) -> Any:
        """March back."""
        kernels, values, path, held, blocks = ctx.state
        wanted = ctx.needs_input_grad[2]
        slopes = compiled.march_back(kernels, values, path, bars.numpy(), held, blocks, wanted)
        found = (slopes.parameters, np.ascontiguousarray(slopes.first), slopes.commands)
        by_parameters, by_first, by_commands = map(torch.from_numpy, found)
        shaped = by_commands.reshape(blocks.windows, -1, 2) if wanted else None
        return by_parameters, by_first, shaped, None, None, None, None


def squared_distances(a: Tensor, b: Tensor) -> Tensor:
    """Squared Euclidean distances (B, N, M) between points (B, N, D) and (B, M, D)."""
    apart = a[:, :, None, :] - b[:, None, :, :]
    return (apart * apart).sum(-1)


def soft_dtw(cost: Tensor, gamma: float = PAPER_GAMMA) -> Tensor:
    """Soft-DTW (B,) of costs (B, N, M) of pairing sample n with sample m, differentiable.

    Softness `gamma` is above 0; towards 0 it becomes plain DTW. The cells of a diagonal do not need
    each other: they are computed together.
    """
    count, rows, columns = cost.shape
    n, m = torch.meshgrid(torch.arange(rows), torch.arange(columns), indexing="ij")
    diagonals = cost.new_full((count, rows, rows + columns - 1), _FAR)
    diagonals[:, n, n + m] = cost
    # The accumulated cost along the last two diagonals, by row; before the first row lies nothing.
    outside = cost.new_full((count, rows + 1), _FAR)
    before, last = outside.clone(), outside
    before[:, 0] = 0.0
    for here in diagonals.unbind(2):
        ways = torch.stack([before[:, :-1], last[:, :-1], last[:, 1:]])
        reached = here - gamma * torch.logsumexp(-ways / gamma, 0)
        before, last = last, torch.cat([outside[:, :1], reached], 1)
    return last[:, -1]


def chamfer(a: Tensor, b: Tensor) -> Tensor:
    """Chamfer distance of two paths (N, D) and (M, D), float64, as sets of points [their unit^2].

    Mean squared distance to the nearest point of the other set, both ways (as PyTorch3D, the
    paper's library, defines it); NaN if a point is not finite. A k-d tree finds the nearest points;
    given them, the distance is smooth, and its gradient is that of the pairs.
    """
    here, there = a.detach().numpy(), b.detach().numpy()
    if not (torch.isfinite(a).all() and torch.isfinite(b).all()):
        return (a.sum() + b.sum()) * torch.nan
    to_b = torch.from_numpy(cKDTree(there).query(here)[1])
    to_a = torch.from_numpy(cKDTree(here).query(there)[1])
    forth, back = a - b[to_b], b - a[to_a]
    return (forth * forth).sum(-1).mean() + (back * back).sum(-1).mean()


# -- the searches ----------------------------------------------------------------------------------


@contextmanager
def one_thread() -> Iterator[None]:
    """Torch on one thread: its tensors here are too small for more to help."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def draw_starts(rng: np.random.Generator, count: int) -> Array:
    """Uniform random starts (count, 4)."""
    return rng.uniform(LOW, HIGH, (count, len(NAMES)))


def batch_of(problem: PaperProblem, iteration: int) -> tuple[PaperRun, ...]:
    """The runs of an iteration: four in a row, one further each time."""
    n = len(problem.runs)
    return tuple(problem.runs[(iteration + 1 + i) % n] for i in range(min(BATCH, n)))


def predict(problem: PaperProblem, four: Tensor, runs: Sequence[PaperRun]) -> list[Tensor]:
    """Simulated paths (N, 2) of runs, differentiable in the four parameters."""
    places = torch.tensor([problem.kernels.names.index(name) for name in NAMES])
    kept = torch.clamp(four, min=1e-3)
    parameters = torch.from_numpy(problem.base.copy()).index_put((places,), kept)
    longest = max(len(run.commands) for run in runs)
    commands = np.stack(
        [np.pad(r.commands, ((0, longest - len(r.commands)), (0, 0)), "edge") for r in runs]
    )
    first = torch.from_numpy(np.stack([run.first for run in runs]))
    orders = torch.from_numpy(commands)
    path = simulate(problem.kernels, parameters, first, orders, PAPER_STEP, "euler")
    return [path[i, : len(run.commands), :2] for i, run in enumerate(runs)]


def loss_of(problem: PaperProblem, four: Tensor, runs: Sequence[PaperRun]) -> Tensor:
    """Soft-DTW plus 100 chamfer, averaged over the runs; NaN if the simulation diverges."""
    total = torch.zeros((), dtype=torch.float64)
    for path, run in zip(predict(problem, four, runs), runs, strict=True):
        driven = torch.from_numpy(run.path)
        cost = squared_distances(path[None, ::STRIDE], driven[None, ::STRIDE])
        total = total + soft_dtw(cost)[0] + CHAMFER_WEIGHT * chamfer(path, driven)
    return total / len(runs)


@one_thread()
def search_adam(problem: PaperProblem, start: Array, iterations: int = 100) -> SearchHistory:
    """One start of the paper's method."""
    values = [torch.tensor(float(v), dtype=torch.float64, requires_grad=True) for v in start]
    groups = [{"params": [v], "lr": r} for v, r in zip(values, RATES.tolist(), strict=True)]
    optimiser = torch.optim.Adam(groups)
    losses, path, diverged = [], [np.array(start, float)], False
    for iteration in range(iterations):
        optimiser.zero_grad()
        loss = loss_of(problem, torch.stack(values), batch_of(problem, iteration))
        diverged = not bool(torch.isfinite(loss))
        if diverged:
            break
        loss.backward()  # type: ignore[no-untyped-call]
        optimiser.step()
        losses.append(loss.item())
        path.append(np.array([v.item() for v in values]))
    return SearchHistory(np.array(losses), np.array(path), path[-1], diverged)


@one_thread()
def search_cma(
    problem: PaperProblem, start: Array, trials: int = 500, seed: int = 0
) -> SearchHistory:
    """CMA-ES on the paper's loss, one batch a trial.

    Raises:
        ImportError: Optuna is not installed.
    """
    try:
        import cmaes as _cmaes  # type: ignore[import-untyped]  # noqa: F401
        import optuna
    except ImportError as error:
        raise ImportError("CMA-ES needs Optuna: pip install optuna cmaes") from error
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    first = dict(zip(NAMES, (start * SCALE).tolist(), strict=True))
    with warnings.catch_warnings():
        # Optuna announces that its CMA-ES will move; start and spread are the paper's.
        warnings.simplefilter("ignore", FutureWarning)
        sampler = optuna.samplers.CmaEsSampler(x0=first, sigma0=CMA_SIGMA, seed=seed)
    study = optuna.create_study(sampler=sampler, direction="minimize")
    losses: list[float] = []
    path = [np.array(start, float)]

    def try_once(trial: Any) -> float:
        bounds = zip(NAMES, LOW * SCALE, HIGH * SCALE, strict=True)
        four = np.array([trial.suggest_float(name, a, b) for name, a, b in bounds]) / SCALE
        with torch.no_grad():
            value = float(loss_of(problem, torch.from_numpy(four), batch_of(problem, len(losses))))
        loss = value if np.isfinite(value) else 1e9
        losses.append(loss)
        path.append(four)
        return loss

    study.optimize(try_once, n_trials=trials)
    return SearchHistory(np.array(losses), np.array(path), path[1 + int(np.argmin(losses))])


def search_from(
    item: tuple[int, Array], runs: tuple[PaperRun, ...], method: str, iterations: int | None
) -> SearchHistory:
    """A numbered start, by the paper's method or its baseline."""
    number, start = item
    if method == "paper":
        return search_adam(make_problem(runs), start, iterations or 100)
    return search_cma(make_problem(runs), start, iterations or 500, seed=number)
