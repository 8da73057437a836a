"""When commands took effect, which is in no log: the servo's pulses and the speed setpoint's ramp.

A VESC's servo signal carries one angle per frame of 20 ms: of the commands of a 100 Hz loop every
second one is never seen. And since firmware 5.03 the setpoint of `SET_RPM` moves by at most 25000
ERPM/s (5.4 m/s^2 on an F1TENTH car): ignored, a loop's steps of 25 mm/s are 2 ms of speed lag, and
residuals that are correlated over half a second.

A drive is judged under each course that its commands may have taken, by the same likelihood as the
car, all free parameters adapted to each. The steering is put half a frame early: a fitted
`steer_delay` is then what controllers and filters, which know no frames, take it for.
"""

# Why: docs/decisions/identification.md#d24
# Why: docs/decisions/identification.md#d38

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from steerd.sysid.data.data_checks import Array, Mask
from steerd.sysid.data.dataset import Pulse, Ramp, Run, Signal, hold_means
from steerd.sysid.data.segments import moving_segments
from steerd.sysid.inference.likelihood import Likelihood
from steerd.sysid.inference.plain_car import Asked, PlainCar, open_plain
from steerd.sysid.inference.search import minimise, newton, open_point
from steerd.sysid.inference.space import Space, make_space

SECONDS = 20.0  # this much of a drive is enough to judge its commands' course [s]
WINDOW = 2.0  # length of the windows [s]
STEPS = 6  # of a search under each course: they differ by little
PHASES = 8  # phases that are tried, evenly over a frame (2.5 ms apart)
SURE = 3.0  # a log-likelihood smaller by less than this does not distinguish two phases


def time_commands(run: Run, rough: PlainCar, asked: Asked) -> Run:
    """A whole drive with its commands as servo and motor controller likeliest took them over.

    `rough` is a car near the truth, and what is free beside the course is `asked`.

    Raises:
        DataError: the drive does not move.
    """
    limited = ramped(run)
    if limited is not run:
        free, held = _losses(run, (run, limited), rough, asked).tolist()
        ramp = Ramp(run.name, run.speed_ramp if held < free else 0.0, abs(free - held))
        run = replace(limited if held < free else run, ramp=ramp)
    if not run.servo_frame:
        return run
    pulse = _find_phase(run, rough, asked)
    return replace(latch(run, pulse.phase), pulse=pulse)


def latch(run: Run, phase: float) -> Run:
    """The drive with its steering as pulses at `phase` take it over, half a frame early."""
    frame = run.servo_frame
    t, angles = run.steer
    first = np.floor((t[0] - phase) / frame)
    pulses = phase + frame * np.arange(first, np.ceil((run.duration - phase) / frame) + 2)
    seen = angles[np.maximum(np.searchsorted(t, pulses, side="right") - 1, 0)]
    steer = hold_means(Signal(pulses - 0.5 * frame, seen), run.edges)
    return replace(run, commands=np.column_stack([steer, run.commands[:, 1]]))


def _setpoint(command: Signal, rate: float, end: float) -> Signal:
    """Corners of the setpoint's course: straight in between, moving by `rate` at most."""
    now = float(command.values[0])
    times, values = [float(command.t[0])], [now]
    until = np.append(command.t[1:], max(end, command.t[-1]) + 1.0)
    for t, wanted, later in zip(
        command.t.tolist(), command.values.tolist(), until.tolist(), strict=True
    ):
        away = wanted - now
        there = t + abs(away) / rate
        if away and there < later:
            times.append(there)
            values.append(wanted)
        now = wanted if there <= later else now + np.copysign(rate * (later - t), away)
        times.append(later)
        values.append(now)
    return Signal(np.array(times), np.array(values))


def _means(corners: Signal, edges: Array) -> Array:
    """Mean of a signal that is straight between its corners over each interval (exact)."""
    t = np.union1d(corners.t, edges)
    values = np.interp(t, *corners)
    area = np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(t))])
    return np.asarray(np.diff(np.interp(edges, t, area)) / np.diff(edges))


def ramped(run: Run) -> Run:
    """The drive with its speed commands as the ramp lets them through; without one, as it is."""
    if not run.speed_ramp or not len(run.speed_command.t) or run.speed_source != "command":
        return run
    corners = _setpoint(run.speed_command, run.speed_ramp, float(run.edges[-1]))
    speed = _means(corners, run.edges)
    return replace(run, commands=np.column_stack([run.commands[:, 0], speed]))


def _find_phase(run: Run, rough: PlainCar, asked: Asked) -> Pulse:
    """The likeliest phase of a drive's pulses, all free parameters adapted to each."""
    step = run.servo_frame / PHASES
    phases = step * (np.arange(PHASES) + 0.5)
    tried = _losses(run, [latch(run, float(phase)) for phase in phases], rough, asked)
    best, alike = _middle(tried)
    others = tried[~alike]
    sure = float(others.min() - tried.min()) if len(others) else 0.0
    phase = float(phases[0] + best * step)
    # Where it is as good, one whose pulses fall between steps of the grid: within a step a pulse
    # would be blurred, and 2 ms of blur pass for inertia.
    near = run.h * round(phase / run.h)
    phase = near if abs(near - phase) <= 0.5 * step + 1e-9 else phase
    possible = int((tried <= tried.min() + SURE).sum())
    return Pulse(run.name, phase, sure, float(step * possible / np.sqrt(12.0)))


def _middle(cost: Array) -> tuple[float, Mask]:
    """Middle of the stretch of phases (they form a ring) about the best that are as good."""
    count, best = len(cost), int(np.argmin(cost))
    good = cost <= cost[best] + SURE
    up = next((i for i in range(count) if not good[(best + i + 1) % count]), count - 1)
    down = next((i for i in range(count) if not good[(best - i - 1) % count]), count - 1)
    alike = np.zeros(count, bool)
    alike[np.arange(best - down, best + up + 1) % count] = True
    return (best + 0.5 * (up - down)) % count, alike


def _losses(run: Run, courses: Sequence[Run], rough: PlainCar, asked: Asked) -> Array:
    """Negative log-likelihoods of a whole drive under courses of its commands [nats].

    (courses,), but for a constant; infinite where the simulation diverges.

    Raises:
        DataError: the drive does not move.
    """
    parts = moving_segments([run])
    likelihood, _ = open_plain(parts, asked, rough, WINDOW, SECONDS)
    predictor, found = likelihood.predictor, []
    space = make_space(predictor.augmented, asked.free)
    first = [round((part.start - run.start) / run.h) for part in parts]
    for course in courses:
        cuts = [course.commands[a : a + len(p.commands)] for a, p in zip(first, parts, strict=True)]
        layout = replace(predictor.layout, commands=np.concatenate(cuts))
        their = replace(likelihood, predictor=replace(predictor, layout=layout))
        found.append(_least_cost(their, space, space.chart.coordinates(rough.point.parameters)))
    return np.array(found)


def _least_cost(likelihood: Likelihood, space: Space, z: Array) -> float:
    """Cost at the minimum, under the discrepancy that is needed there."""
    try:
        begun = open_point(likelihood, space, z, likelihood.predictor.guess)
        found = minimise(likelihood, begun, steps=STEPS)
    except (FloatingPointError, np.linalg.LinAlgError):
        return np.inf
    return found.cost - newton(space, found.at, found.z)[1]
