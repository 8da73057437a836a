"""Identification: the car that explains the drives, with error bars and what they leave open.

Maximum a posteriori over multi-step prediction errors. Windows grow (0.5 s, 2 s, whole runs), so
that a bad start is caught where the problem is convex and the full accuracy comes at the end. Each
window's initial state is unknown and eliminated; noise levels are estimated; errors are judged
robustly.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from steerd.car_model.chassis import Chassis
from steerd.car_model.model import Model
from steerd.car_model.native.windows import (
    Kernels,
    delays_of,
    make_kernels,
    model_of,
    parameter_vector,
)
from steerd.car_model.params import Car
from steerd.car_model.planar import make_planar
from steerd.sysid.data.data_checks import DataError, check_excited
from steerd.sysid.data.dataset import Run, check_sources
from steerd.sysid.data.windows import (
    FLOORS,
    GROUPS,
    Layout,
    estimate_noise,
    make_layout,
    speed_range,
)
from steerd.sysid.estimation.chart import Chart, make_chart
from steerd.sysid.estimation.identifiability import (
    Combination,
    Direction,
    Estimate,
    combinations,
    directions,
    estimates,
    silent_estimates,
)
from steerd.sysid.estimation.levenberg_marquardt import Effort, Solution, minimise
from steerd.sysid.estimation.objective import Evaluation, Problem, information
from steerd.sysid.estimation.robust_covariance import inflate, nuisance_covariance, score_spread

Array = NDArray[np.float64]

DEFAULT_FREE: tuple[str, ...] = (
    "lf", "lr", "c_sf", "c_sr", "inertia_z", "steer_gain", "steer_bias", "steer_delay",
    "steer_lag", "speed_gain", "speed_lag",
)  # fmt: skip
"""Free unless said otherwise. mu only scales the stiffnesses, mass only the inertia: fixed."""
SLIPPING: tuple[str, ...] = (*DEFAULT_FREE, "c_x")
"""The same for a chassis whose driven wheels slip."""
TYRES: tuple[str, ...] = ("lf", "lr", "c_sf", "c_sr")
"""What the paper identifies."""
HORIZONS: tuple[float, ...] = (0.5, 2.0, 8.0, np.inf)
"""Windows' lengths [s], one stage each; lengths near that of the longest drive are passed over."""
_FIRST, _ROUGH = Effort(100, 0.5, 1e-5, 1e-4, patient=True), Effort(20, 0.5, 3e-3, 1e-4)
_FINE = Effort(20, 0.1, 1e-7)
_GROWTH = 1.5
"""A last stage whose windows are no more than so much longer than a stage's replaces it."""
_SPEED_OF_COMMANDS = ("speed_gain", "speed_lag", "drive_delay", "accel_max", "decel_max")
_SPEED_LOOP = tuple(name for name in _SPEED_OF_COMMANDS if name != "speed_gain")
NO_SLIP = 1e6
"""Slip stiffness of wheels that turn as fast as the ground passes, to a tenth of a millimetre."""
SPEED_CHANGE = 0.1
"""A commanded speed that varies by less within every drive was never changed [m/s]."""
_NOISE_ROUNDS = 6
_NOISE_SETTLED = 0.03
"""Noise levels that change by a smaller share are settled."""
_ROUGH_SECONDS = 20.0
"""Windows before the last stage only prepare it: this much of the drives is enough [s]."""
_DOUBTFUL = 1.1
"""Errors larger than the noise by this factor: another start may lead to another minimum."""
_BETTER = 0.85
"""A second start is believed when its cost is below this share of the first one's."""
_PLAIN = {"lf": 0.16, "lr": 0.16, "c_sf": 5.0, "c_sr": 5.0, "steer_gain": 1.0}
"""Any car of this scale."""
_MANY = 8
"""From so many windows of the last stage, a few are fitted before all are."""


def default_free(chassis: Chassis) -> tuple[str, ...]:
    """Names of the parameters that are free unless said otherwise."""
    return SLIPPING if chassis.drive else DEFAULT_FREE


@dataclass(frozen=True)
class Options:
    """How to fit.

    Attributes:
        free: names of the free parameters; None takes `default_free`.
        wheelbase: known distance of the axles [m].
        horizons: windows' lengths by stage [s].
        integrator: `rk4` or `euler`.
        substeps: integration steps to a command; None chooses stable ones.
        noise: (4,) known noise levels, see `windows.GROUPS`; None estimates them.
        doubts: parameters that may be off by so much whatever the data say (nuisance).
    """

    free: tuple[str, ...] | None = None
    wheelbase: float | None = None
    horizons: tuple[float, ...] = HORIZONS
    integrator: str = "rk4"
    substeps: int | None = None
    noise: tuple[float, ...] | None = None
    doubts: tuple[tuple[str, float], ...] = ()


@dataclass(frozen=True, eq=False)
class Fit:
    """An identified car.

    Attributes:
        model: the car with its effects at the estimates.
        parameters: (P,) the same as a vector, in the order of `names`.
        names: of all parameters.
        estimates: every free parameter with standard error and whether the data identify it.
        correlation: (n, n) of the coordinates.
        covariance: (n, n) of the coordinates.
        chart: the coordinates.
        z: (n,) estimates in coordinates.
        states: (W, 7) initial states of the last stage's windows.
        combinations: sums that the data fix even where they leave their members open.
        directions: singular directions of the information, weakest first.
        costs: cost after each step, by stage.
        iterations: accepted steps.
        evaluations: simulations of all data with derivatives.
        converged: whether the last stage ended by itself.
        residuals: (R,) measurement minus prediction of the last stage, in units.
        noise: (4,) standard deviation of the residuals by group, see `windows.GROUPS`.
        noise_signal: (4,) noise of the signals themselves (third differences).
        layout: windows of the last stage.
    """

    model: Model[float]
    parameters: Array
    names: tuple[str, ...]
    estimates: dict[str, Estimate]
    correlation: Array
    covariance: Array
    chart: Chart
    z: Array
    states: Array
    combinations: tuple[Combination, ...]
    directions: tuple[Direction, ...]
    costs: tuple[tuple[float, ...], ...]
    iterations: int
    evaluations: int
    converged: bool
    residuals: Array
    noise: Array
    noise_signal: Array
    layout: Layout

    @property
    def misfit(self) -> dict[str, float]:
        """Residual over signal noise by group: 1 says that the model explains everything."""
        ratio = self.noise / self.noise_signal
        present = np.unique(self.layout.group)
        return {GROUPS[g]: float(ratio[g]) for g in present}

    @property
    def unidentified(self) -> tuple[str, ...]:
        """Free parameters that the data do not identify."""
        return tuple(name for name, e in self.estimates.items() if not e.identifiable)


def prescribe_speed(model: Model[float], runs: Sequence[Run]) -> Model[float]:
    """The car whose speed follows a measured speed at once, where there is no command to explain.

    A speed from poses is the body's and not the wheels': no slip lies between, and no driven front
    axle rolls along its own wheels.
    """
    sources = {run.speed_source for run in runs}
    if sources <= {"command"}:
        return model
    car: Car[float] = model.car._replace(
        speed_lag=0.0, drive_delay=0.0, accel_max=1e3, decel_max=1e3
    )
    if sources == {"pose"} and model.chassis.drive:
        return model._replace(car=car._replace(c_x=NO_SLIP), chassis=make_planar("rear"))
    return model._replace(car=car)


def _free_names(runs: Sequence[Run], options: Options, chassis: Chassis) -> tuple[str, ...]:
    free = options.free if options.free is not None else default_free(chassis)
    sources = {run.speed_source for run in runs}
    if sources == {"command"}:
        silent = _silent_names(runs, free)
        return tuple(name for name in free if name not in silent)
    of_wheels = {"speed_gain", "c_x"}
    gone = {*_SPEED_OF_COMMANDS, *of_wheels} - (of_wheels if "wheel" in sources else set())
    return tuple(name for name in free if name not in gone)


def _silent_names(runs: Sequence[Run], free: Sequence[str]) -> tuple[str, ...]:
    """What of the speed loop is asked for though the commanded speed never changes.

    Nothing excites it then; what the fit would call its lag is what initial speeds are off by.
    """
    commanded = all(run.speed_source == "command" for run in runs)
    if not commanded or max(float(np.ptp(run.commands[:, 1])) for run in runs) > SPEED_CHANGE:
        return ()
    return tuple(name for name in free if name in _SPEED_LOOP)


@dataclass(eq=False)
class _Work:
    """What the stages share."""

    kernels: Kernels
    chart: Chart
    runs: Sequence[Run]
    options: Options
    sigma: Array
    speeds: tuple[float, float]
    evaluations: int = 0
    costs: list[tuple[float, ...]] = field(default_factory=list)

    def problem(self, horizon: float, z: Array, rough: bool) -> Problem:
        """The stage's problem: windows cut for the pose delay as it is believed now."""
        late = float(delays_of(self.kernels, self.chart.parameters(z))[2])
        most = _ROUGH_SECONDS if rough else np.inf
        layout = make_layout(self.runs, horizon, late, most)
        return Problem(
            self.kernels, self.chart, layout, self.sigma, self.speeds,
            self.options.integrator, self.options.substeps,
        )  # fmt: skip

    def minimise(
        self, problem: Problem, z: Array, x: Array, effort: Effort, at: Evaluation | None = None
    ) -> Solution:
        """One minimisation, counted."""
        found = minimise(problem, z, x, effort, at)
        self.evaluations += problem.evaluations
        problem.evaluations = 0
        self.costs.append(found.costs)
        return found


def fit(
    runs: Sequence[Run],
    model: Model[float],
    *,
    options: Options | None = None,
    starts: Sequence[Model[float]] = (),
) -> Fit:
    """Identify a car from drives.

    Args:
        runs: the drives; see `dataset.load_run`.
        model: the car as believed so far, with the effects to fit switched on. Weak priors lie
            about it, fixed parameters are its own. Its free values are the start.
        options: what is free and how to fit.
        starts: further starting values (with the same effects); all are tried on short windows
            and the best goes on. Use them where a gradient vanishes or a start may be bad.

    Returns:
        The estimates with their standard errors and what the data leave open.

    Raises:
        DataError: the drives' steering never changes, nothing that is free shows in them, or only
            some have speed commands.
        ValueError: an unknown free parameter, or runs on different grids.
        FloatingPointError: no start gives a finite simulation.
    """
    options = options or Options()
    check_excited([run.commands[:, 0] for run in runs])
    check_sources(runs)
    model, *starts = (prescribe_speed(each, runs) for each in (model, *starts))
    kernels = make_kernels(model.effects, model.chassis)
    free = _free_names(runs, options, model.chassis)
    if not free:
        hint = "drive `steerd collect --plan mixed`"
        raise DataError("the speed was never changed: nothing of it is identifiable", hint)
    chart = make_chart(model.effects, parameter_vector(model), free, options.wheelbase)
    signal = estimate_noise(runs)
    sigma = np.array(options.noise) if options.noise is not None else signal
    work = _Work(kernels, chart, runs, options, sigma, speed_range(runs))
    tried = [parameter_vector(start) for start in (starts or (model,))]
    later = _later_stages(runs, options)
    rough = [horizon for horizon, few in later if few]
    found, problem = _prepare(work, tried, rough)
    others = _other_starts(work, tried) if rough and _misses(found) > _DOUBTFUL else []
    if others:
        second = _prepare(work, others, rough)
        if second[0].costs[-1] < _BETTER * found.costs[-1]:
            found, problem = second
    for horizon, few in later:
        if not few:
            effort = _ROUGH if options.noise is None else _FINE
            found, problem = _widen(work, found, problem, (horizon, few), effort)
    if options.noise is None:
        found = _settle_noise(work, problem, found)
    return _report(work, problem, found, signal)


def _prepare(
    work: _Work, starts: Sequence[Array], rough: Sequence[float]
) -> tuple[Solution, Problem]:
    """The stages that a part of the drives is enough for, from the best of some parameters."""
    low, high = work.chart.bounds()
    places = [np.clip(work.chart.coordinates(p), low, high) for p in starts]
    found, problem = _first_stage(work, places)
    for horizon in rough:
        found, problem = _widen(work, found, problem, (horizon, True), _ROUGH)
    return found, problem


def _widen(
    work: _Work, found: Solution, problem: Problem, stage: tuple[float, bool], effort: Effort
) -> tuple[Solution, Problem]:
    """The next stage, from where the last one ended."""
    wider = work.problem(stage[0], found.z, stage[1])
    x = _carry(problem, found.x, wider)
    effort = effort._replace(damping=min(found.damping, effort.damping))
    return work.minimise(wider, found.z, x, effort), wider


def _misses(found: Solution) -> float:
    """Root mean square of the errors in units of the noise, outliers bounded."""
    return float(np.sqrt(np.mean(np.minimum(np.abs(found.at.error), found.limit) ** 2)))


def _other_starts(work: _Work, tried: Sequence[Array]) -> list[Array]:
    """The car as believed, and a plain one with its actuators: what has not been tried."""
    plain = work.chart.prior.copy()
    for name, value in _PLAIN.items():
        if name in work.chart.free:
            plain[work.chart.names.index(name)] = value
    return [p for p in (work.chart.prior, plain) if not any(np.array_equal(p, q) for q in tried)]


def _later_stages(runs: Sequence[Run], options: Options) -> list[tuple[float, bool]]:
    """Windows' lengths after the first stage's, and whether a part of the drives is enough.

    The last stage is of everything; from many drives, a few come before it.
    """
    later = list(options.horizons[1:])
    if not later:
        return []
    last = later.pop()
    lengths = [float(np.ptp(run.pose.t)) for run in runs]
    kept = [h for h in later if _GROWTH * h < min(last, max(lengths))]
    windows = sum(max(1.0, length / last) for length in lengths)
    few_first = windows >= _MANY and sum(lengths) > 2.0 * _ROUGH_SECONDS
    return [*((h, True) for h in kept), *[(last, True)] * few_first, (last, False)]


def _first_stage(work: _Work, starts: Sequence[Array]) -> tuple[Solution, Problem]:
    """Short windows from every start; the lowest cost goes on."""
    best: tuple[float, Solution, Problem] | None = None
    for z in starts:
        alone = len(work.options.horizons) == 1
        problem = work.problem(work.options.horizons[0], z, rough=not alone)
        effort = _FINE if alone else _FIRST
        try:
            found = work.minimise(problem, z, problem.layout.guess.copy(), effort)
        except FloatingPointError:
            continue
        cost = found.costs[-1] / len(problem.layout.values)
        if best is None or cost < best[0]:
            best = (cost, found, problem)
    if best is None:
        raise FloatingPointError("the simulation diverges at every start")
    return best[1], best[2]


def _carry(old: Problem, x: Array, new: Problem) -> Array:
    """Initial states for new windows: those of old windows that begin at the same time."""
    places = {
        (int(run), float(t)): i
        for i, (run, t) in enumerate(zip(old.layout.run, old.layout.t, strict=True))
    }
    carried = new.layout.guess.copy()
    for w, (run, t) in enumerate(zip(new.layout.run, new.layout.t, strict=True)):
        i = places.get((int(run), float(t)))
        if i is not None:
            carried[w] = x[i]
    return carried


def residual_noise(problem: Problem, found: Solution) -> Array:
    """Standard deviation of the residuals by group, outliers bounded (4,)."""
    noise = problem.sigma.copy()
    size = np.minimum(np.abs(found.at.error), found.limit)
    for g in range(len(GROUPS)):
        mine = size[problem.layout.group == g]
        if len(mine):
            noise[g] *= np.sqrt(np.mean(mine**2))
    floored: Array = np.maximum(noise, FLOORS)
    return floored


def _settle_noise(work: _Work, problem: Problem, found: Solution) -> Solution:
    """Weigh the groups by their residuals until both stay.

    Where the model does not explain everything, residuals are many times the instruments' noise;
    weighed by the latter, most of them would count as outliers and the steps would be tiny.
    """
    for number in range(_NOISE_ROUNDS):
        noise = residual_noise(problem, found)
        change = float(np.abs(np.log(noise / problem.sigma)).max())
        if number and change < _NOISE_SETTLED:
            return found
        at = problem.rescaled(found.at, noise)
        effort = _FINE._replace(damping=min(found.damping, _ROUGH.damping))
        found = work.minimise(problem, found.z, found.x, effort, at)
        if change < _NOISE_SETTLED:
            return found
    return found._replace(converged=False)


def _report(work: _Work, problem: Problem, found: Solution, signal: Array) -> Fit:
    chart = work.chart
    known = information(found.normal)
    parameters = chart.parameters(found.z)
    spread = score_spread(problem, found.at, found.normal, found.limit)
    inverse: Array = np.linalg.inv(known).astype(float)
    covariance = inflate(inverse, spread)
    doubts = work.options.doubts
    covariance += nuisance_covariance(problem, found.x, parameters, found.limit, doubts)
    sd = np.sqrt(np.diag(covariance))
    pace = float(np.median(np.abs(np.concatenate([run.commands[:, 1] for run in work.runs]))))
    pace *= model_of(work.kernels, parameters).car.speed_gain
    estimated = estimates(chart, found.z, covariance)
    free = work.options.free or default_free(work.kernels.chassis)
    estimated |= silent_estimates(chart, _silent_names(work.runs, free))
    return Fit(
        model=model_of(work.kernels, parameters),
        parameters=parameters,
        names=work.kernels.names,
        estimates=estimated,
        correlation=covariance / np.outer(sd, sd),
        covariance=covariance,
        chart=chart,
        z=found.z,
        states=found.x,
        combinations=combinations(chart, found.z, covariance, pace),
        directions=directions(chart, found.z, known),
        costs=tuple(work.costs),
        iterations=sum(len(costs) - 1 for costs in work.costs),
        evaluations=work.evaluations,
        converged=found.converged,
        residuals=found.at.error * problem.sigma[problem.layout.group],
        noise=residual_noise(problem, found),
        noise_signal=signal,
        layout=problem.layout,
    )
