"""Forward sensitivities: one window at a time, its derivatives in rows beside it.

Appended, as `loops` is, to the pieces printed for a model. Each number of a state has a row of
sensitivities; pieces push them through their exact derivatives (Jacobian-vector products). The
directions are whatever the caller seeds: free parameters and the first state. Every window may be
sampled anywhere between its steps.

`march_window` is what Python calls, once for each window.

Row numbers are np.int64 (`layout`): for a plain Python number, Numba would compile a copy of the
function for this number alone.
"""

# ruff: noqa: TC004  (the printed pieces stand above this text in the compiled module)
from typing import TYPE_CHECKING

import numpy as np

from steerd.sysid.compiler.arguments import (
    Directions,
    Integration,
    PieceWork,
    Readings,
    Tangent,
    TangentWork,
    Window,
)
from steerd.sysid.compiler.compile import allocating, entry_point, inlined, not_inlined
from steerd.sysid.compiler.simd_rows import add_row, copy_row, mix_row, scale_row, shift_row

if TYPE_CHECKING:
    from steerd.sysid.compiler.delayed import unsigned
    from steerd.sysid.compiler.pieces import (
        ACCEL,
        ACTUATORS_COMMAND,
        ACTUATORS_INPUTS,
        ACTUATORS_OUTPUTS,
        ACTUATORS_SLOPES,
        ACTUATORS_TIME,
        CHASSIS,
        DELAYS_SLOPES,
        FIRST,
        MEMORY,
        MEMORY_END,
        OBSERVE_SLOPES,
        ONE,
        PARAMETER_COUNT,
        RATES_ACCEL,
        RATES_INPUTS,
        RATES_SLOPES,
        RATES_TIME,
        RATES_WHEEL,
        READINGS,
        REMEMBER_AFTER,
        REMEMBER_INPUTS,
        REMEMBER_MEMORY,
        REMEMBER_SLOPES,
        REMEMBERS,
        SENSITIVITIES,
        SLOTS,
        SPECIALISED_SPEED,
        SPEED,
        STATES,
        STEER,
        STEER_END,
        WHEEL_END,
        WHEEL_START,
        YAW_RATE,
        Array,
        actuators_jac,
        actuators_jvp,
        delays_jac,
        delays_jvp,
        observe_jac,
        observe_jvp,
        rates_jac,
        rates_jvp,
        remember_jac,
        remember_jvp,
        specialised_jac,
        specialised_jvp,
    )


DENORMAL_GUARD = 1e-100
"""Added and taken away again, it turns numbers far below it into zero."""
FLUSH_EVERY = 64
"""Steps between two removals of denormal numbers."""


@inlined
def copy_sensitivities(
    to: "Array", first: int, source: "Array", start: int, rows: int, n: int
) -> None:
    """Copy rows of `n` sensitivities."""
    for row in range(rows):
        a, b = (first + row) * SENSITIVITIES, (start + row) * SENSITIVITIES
        for i in range(0, n, SLOTS):
            copy_row(to, a + i, source, b + i)


@not_inlined
def seed(w: "Array", row: int, seeds: "Array", n: int) -> None:
    """Put the parameters' directions below a piece's rows."""
    for parameter in range(PARAMETER_COUNT):
        for i in range(n):
            w[(row + parameter) * SENSITIVITIES + i] = seeds[parameter, i]


@entry_point
def delay_sensitivities(
    p: "Array", q: "Array", h: float, seeds: "Array", delay_steps: "Array", n: int
) -> "Array":
    """Dead times in steps, into `delay_steps`, and their sensitivities: steer, drive, pose."""
    j = np.zeros(max(DELAYS_SLOPES, 1))
    w = np.zeros((3 + PARAMETER_COUNT) * SENSITIVITIES)
    seed(w, np.int64(3), seeds, n)
    delays_jac(delay_steps, p, q, h, delay_steps, j)
    delays_jvp(j, w, n)
    for i in range(3 * SENSITIVITIES):
        w[i] /= h
    for i in range(3):
        delay_steps[i] /= h
    return w


@inlined
def delay_command(
    m: Integration, directions: Directions, window: Window, work: TangentWork, k: int
) -> None:
    """Both delayed commands of step `k` with their sensitivities; see `loops.delay_commands`."""
    low, high, start = window.span[0], window.span[1], window.span[2]
    z, w = work.actuators.z, work.actuators.w
    for channel in range(2):
        delay = directions.delay_steps[channel]
        whole = int(np.floor(delay))
        newer, older = (k - whole) // m.substeps, (k - whole - 1) // m.substeps
        new = window.commands[unsigned(min(max(start + newer, low), high - 1)), channel]
        old = window.commands[unsigned(min(max(start + older, low), high - 1)), channel]
        z[ACTUATORS_COMMAND + channel] = new + (delay - whole) * (old - new)
        a, b = (ACTUATORS_COMMAND + channel) * SENSITIVITIES, channel * SENSITIVITIES
        for i in range(0, directions.n, SLOTS):
            scale_row(w, a + i, directions.delays, b + i, old - new)


@inlined
def stage_sensitivities(w: "Array", before: "Array", step: float, n: int) -> None:
    """Rates' chassis inputs at a stage: the start's, moved along the last slope's."""
    for row in range(CHASSIS):
        a, b = row * SENSITIVITIES, (RATES_INPUTS + row) * SENSITIVITIES
        for i in range(0, n, SLOTS):
            mix_row(w, a + i, before, a + i, w, b + i, 1.0, step)


@inlined
def add_slope_sensitivities(w: "Array", after: "Array", share: float, n: int) -> None:
    """Add those of a stage's slope to the step."""
    for row in range(CHASSIS):
        a, b = row * SENSITIVITIES, (RATES_INPUTS + row) * SENSITIVITIES
        for i in range(0, n, SLOTS):
            add_row(after, a + i, w, b + i, share)


@inlined
def wheel_sensitivities(w: "Array", wa: "Array", node: float, n: int) -> None:
    """Those of the wheel angle, part of its motion done."""
    start = (ACTUATORS_INPUTS + WHEEL_START) * SENSITIVITIES
    end = (ACTUATORS_INPUTS + WHEEL_END) * SENSITIVITIES
    for i in range(0, n, SLOTS):
        mix_row(w, RATES_WHEEL * SENSITIVITIES + i, wa, start + i, wa, end + i, 1.0 - node, node)


@inlined
def run_actuators_once(m: Integration, now: Tangent, work: TangentWork, t: float, n: int) -> None:
    """Actuators with their sensitivities; the commands are in place."""
    a = work.actuators
    for i in range(STATES + MEMORY):
        a.z[i] = now.x[i]
    a.z[ACTUATORS_TIME] = t
    copy_sensitivities(a.w, FIRST, now.dx, FIRST, STATES + MEMORY, n)
    actuators_jac(a.z, m.p, m.q, m.h, a.out, a.j)
    actuators_jvp(a.j, a.w, n)


@inlined
def march_chassis(
    m: Integration, now: Tangent, after: Tangent, work: TangentWork, t: float, n: int
) -> None:
    """Chassis and its sensitivities over one step; the actuators have run."""
    a, r = work.actuators, work.rates
    for i in range(CHASSIS):
        after.x[i] = now.x[i]
    for i in range(1 + MEMORY):
        r.z[RATES_ACCEL + i] = a.out[ACCEL + i]
    r.z[RATES_TIME] = t
    copy_sensitivities(after.dx, FIRST, now.dx, FIRST, CHASSIS, n)
    copy_sensitivities(r.w, RATES_ACCEL, a.w, ACTUATORS_INPUTS + ACCEL, 1 + MEMORY, n)
    for stage in range(m.tableau.shape[1]):
        node, share = m.tableau[0, stage], m.h * m.tableau[1, stage]
        for i in range(CHASSIS):
            r.z[i] = now.x[i] + m.h * node * r.out[i]
        r.z[RATES_WHEEL] = a.out[WHEEL_START] + node * (a.out[WHEEL_END] - a.out[WHEEL_START])
        if stage == 0:
            copy_sensitivities(r.w, FIRST, now.dx, FIRST, CHASSIS, n)
        else:
            stage_sensitivities(r.w, now.dx, m.h * node, n)
        wheel_sensitivities(r.w, a.w, node, n)
        if r.z[SPEED] > SPECIALISED_SPEED:
            specialised_jac(r.z, m.p, m.q, m.h, r.out, r.j)
            specialised_jvp(r.j, r.w, n)
        else:
            rates_jac(r.z, m.p, m.q, m.h, r.out, r.j)
            rates_jvp(r.j, r.w, n)
        for i in range(CHASSIS):
            after.x[i] += share * r.out[i]
        add_slope_sensitivities(r.w, after.dx, share, n)


@inlined
def march_steer(after: Tangent, work: TangentWork, n: int) -> None:
    """Steer after the step and its sensitivities."""
    a = work.actuators
    after.x[STEER] = a.out[STEER_END]
    copy_sensitivities(after.dx, STEER, a.w, ACTUATORS_INPUTS + STEER_END, ONE, n)


@inlined
def march_memory(m: Integration, now: Tangent, after: Tangent, work: TangentWork, n: int) -> None:
    """Memory after the step and its sensitivities."""
    a, r = work.actuators, work.remember
    outputs = ACTUATORS_INPUTS
    if not REMEMBERS:
        for i in range(MEMORY):
            after.x[STATES + i] = a.out[MEMORY_END + i]
        copy_sensitivities(after.dx, STATES, a.w, outputs + MEMORY_END, MEMORY, n)
        return
    for i in range(CHASSIS):
        r.z[i], r.z[REMEMBER_AFTER + i] = now.x[i], after.x[i]
    r.z[STEER], r.z[REMEMBER_AFTER + STEER] = a.out[WHEEL_START], a.out[WHEEL_END]
    for i in range(MEMORY):
        r.z[REMEMBER_MEMORY + i] = a.out[MEMORY_END + i]
    copy_sensitivities(r.w, FIRST, now.dx, FIRST, CHASSIS, n)
    copy_sensitivities(r.w, STEER, a.w, outputs + WHEEL_START, ONE, n)
    copy_sensitivities(r.w, REMEMBER_AFTER, after.dx, FIRST, CHASSIS, n)
    copy_sensitivities(r.w, REMEMBER_AFTER + STEER, a.w, outputs + WHEEL_END, ONE, n)
    copy_sensitivities(r.w, REMEMBER_MEMORY, a.w, outputs + MEMORY_END, MEMORY, n)
    remember_jac(r.z, m.p, m.q, m.h, r.out, r.j)
    for i in range(MEMORY):
        after.x[STATES + i] = r.out[i]
    remember_jvp(r.j, r.w, n)
    copy_sensitivities(after.dx, STATES, r.w, REMEMBER_INPUTS, MEMORY, n)


@not_inlined
def flush_denormals(dx: "Array", n: int) -> None:
    """Decayed sensitivities become zero: denormal numbers would slow a long window threefold."""
    for row in range(YAW_RATE, STATES + MEMORY):
        a = row * SENSITIVITIES
        for i in range(0, n, SLOTS):
            shift_row(dx, a + i, dx, a + i, DENORMAL_GUARD)
            shift_row(dx, a + i, dx, a + i, -DENORMAL_GUARD)


@inlined
def sample(
    m: Integration, share: float, shares: "Array", start: int, now: Tangent, after: Tangent,
    work: TangentWork, n: int,
) -> None:  # fmt: skip
    """What the instruments read `share` of a step after `now`, and its sensitivities.

    The state runs straight from `now` (share 0) to `after` (1); the share itself has the
    sensitivities that begin at `shares[start]`.
    """
    o = work.observe
    for row in range(STATES):
        a, move = row * SENSITIVITIES, after.x[row] - now.x[row]
        o.z[row] = now.x[row] + share * move
        for i in range(0, n, SLOTS):
            mix_row(o.w, a + i, now.dx, a + i, after.dx, a + i, 1.0 - share, share)
            add_row(o.w, a + i, shares, start + i, move)
    observe_jac(o.z, m.p, m.q, m.h, o.out, o.j)
    observe_jvp(o.j, o.w, n)


@allocating
def make_piece_work(inputs: int, outputs: int, slopes: int, seeds: "Array", n: int) -> PieceWork:
    """Workspace of a piece, the parameters' directions in place."""
    w = np.zeros((inputs + outputs + PARAMETER_COUNT) * SENSITIVITIES)
    seed(w, inputs + outputs, seeds, n)
    return PieceWork(np.zeros(inputs), np.zeros(outputs), np.zeros(max(slopes, 1)), w)


@allocating
def make_tangent_work(seeds: "Array", n: int) -> TangentWork:
    """Workspaces of all pieces."""
    none = np.int64(0)
    return TangentWork(
        make_piece_work(ACTUATORS_INPUTS, ACTUATORS_OUTPUTS, none + ACTUATORS_SLOPES, seeds, n),
        make_piece_work(RATES_INPUTS, CHASSIS, none + RATES_SLOPES, seeds, n),
        make_piece_work(REMEMBER_INPUTS, none + MEMORY, none + REMEMBER_SLOPES, seeds, n),
        make_piece_work(STATES, READINGS, none + OBSERVE_SLOPES, seeds, n),
    )


@allocating
def make_tangent() -> Tangent:
    """A state of zeros that depends on nothing."""
    return Tangent(np.zeros(STATES + MEMORY), np.zeros((STATES + MEMORY) * SENSITIVITIES))


@inlined
def settle(
    m: Integration, directions: Directions, window: Window, now: Tangent, work: TangentWork
) -> None:
    """Actuators alone over the known commands before a window; `now` gets steer and memory."""
    a, n, settling = work.actuators, directions.n, window.span[4]
    if settling <= 0:
        return
    offset = now.x[STEER]
    delay_command(m, directions, window, work, -settling)
    now.x[STEER] = a.z[ACTUATORS_COMMAND]
    copy_sensitivities(now.dx, STEER, a.w, ACTUATORS_COMMAND, ONE, n)
    for k in range(-settling, 0):
        delay_command(m, directions, window, work, k)
        run_actuators_once(m, now, work, window.t + k * m.h, n)
        march_steer(now, work, n)
        for i in range(MEMORY):
            now.x[STATES + i] = a.out[MEMORY_END + i]
        copy_sensitivities(now.dx, STATES, a.w, ACTUATORS_INPUTS + MEMORY_END, MEMORY, n)
    now.x[STEER] += offset


@inlined
def start_pose_derivatives(readings: Readings, row: int, seen: "Array", start: "Array") -> None:
    """Derivatives of a pose by position and heading of its window's start."""
    to, width, jy = row * readings.width + readings.start_pose, readings.width, readings.jy
    scale_x = readings.scale[unsigned(row)]
    scale_y = readings.scale[unsigned(row + 1)]
    jy[unsigned(to)] = scale_x
    jy[unsigned(to + 2)] = (start[1] - seen[1]) * scale_x
    jy[unsigned(to + width + 1)] = scale_y
    jy[unsigned(to + width + 2)] = (seen[0] - start[0]) * scale_y
    jy[unsigned(to + 2 * width + 2)] = readings.scale[unsigned(row + 2)]


@inlined
def read_station(
    m: Integration, readings: Readings, number: int, k: int, shares: "Array", now: Tangent,
    after: Tangent, work: TangentWork, start: "Array", n: int,
) -> None:  # fmt: skip
    """One station's readings and their sensitivities into their rows."""
    stations, scale, jy, o = readings.stations, readings.scale, readings.jy, work.observe
    share, late = readings.shares[number] + (stations[number, 0] - k), stations[number, 3]
    sample(m, share, shares, late * SENSITIVITIES, now, after, work, n)
    channel, row, first = stations[number, 1], stations[number, 2], readings.start_pose
    count = 3 if late == 1 else 1
    for c in range(count):
        readings.y[unsigned(row + c)] = o.out[channel + c]
        b, unit = (STATES + channel + c) * SENSITIVITIES, scale[unsigned(row + c)]
        to = (row + c) * readings.width
        for i in range(0, n, SLOTS):
            scale_row(jy, to + i, o.w, b + i, unit)
        for i in range(first, first + 3 if first else 0):
            jy[unsigned(to + i)] = 0.0
    if first and late == 1:
        start_pose_derivatives(readings, row, o.out, start)


@not_inlined
def seed_state(dx: "Array", dfirst: "Array", first: int, last: int, n: int) -> None:
    """Add the first state's directions, some of its rows."""
    for row in range(first, last):
        for i in range(n):
            dx[row * SENSITIVITIES + i] += dfirst[row, i]


@allocating
def share_sensitivities(directions: Directions) -> "Array":
    """Of a reading's place within its step, by `late`: none, or those of the poses' dead time."""
    shares = np.zeros(2 * SENSITIVITIES)
    for i in range(directions.n):
        shares[SENSITIVITIES + i] = -directions.delays[2 * SENSITIVITIES + i]
    return shares


@entry_point
def march_window(
    integration: Integration, seeds: Directions, place: Window, stations_of: Readings
) -> None:
    """Readings of one window at its stations, and their derivatives.

    Args:
        integration: the car, as a plain tuple (see `arguments`), like the others.
        seeds: what derivatives are taken by.
        place: where the window lies.
        stations_of: where it is read; its `y` and `jy` are written.
    """
    m, directions = Integration(*integration), Directions(*seeds)
    window, readings = Window(*place), Readings(*stations_of)
    n, start, stations = directions.n, window.first, readings.stations
    work, shares = make_tangent_work(directions.parameters, n), share_sensitivities(directions)
    now, after = make_tangent(), make_tangent()
    now.x[:] = start
    seed_state(now.dx, directions.first, FIRST, STEER, n)
    settle(m, directions, window, now, work)
    seed_state(now.dx, directions.first, STEER, STEER + ONE, n)
    station, steps = 0, window.span[3]
    for k in range(steps):
        t = window.t + k * m.h
        delay_command(m, directions, window, work, k)
        run_actuators_once(m, now, work, t, n)
        march_chassis(m, now, after, work, t, n)
        march_steer(after, work, n)
        march_memory(m, now, after, work, n)
        while station < len(stations) and (stations[station, 0] <= k or k == steps - 1):
            read_station(m, readings, station, k, shares, now, after, work, start, n)
            station += 1
        if k % FLUSH_EVERY == 0:
            flush_denormals(after.dx, n)
        now, after = after, now
