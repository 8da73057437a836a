"""Forward sensitivities: one window at a time, its derivatives as columns beside it.

Appended, as `loops` is, to the pieces printed for a model. A state has a row of columns for each of
its numbers; pieces push columns through their exact derivatives. Columns are whatever the caller
seeds: free parameters and the first state. Every window may be sampled anywhere between its steps.

`march_window` is what Python calls, once for each window; its arguments:
    p, q: parameters, and their constants for step `h`.
    h: step [s], `substeps` of which share one command.
    tableau: (2, stages) reach and weight of each stage.
    seeds: (parameters, >= n) derivative of each parameter by each column.
    late, late_columns: dead times in steps with their columns, see `delay_columns`.
    commands: (rows, 2) all runs one after the other.
    window: first row, row after the last, row of the first step, steps, and steps of actuators
        alone before it (over known commands, to settle the steering).
    t: time into the run [s].
    first: (7 + MEMORY,) first state; the steer is added to the settled one.
    dfirst: (7, >= n) derivative of the first state by each column.
    stations: (S, 4) step, first reading, row of `y`, and whether poses are late; sorted.
    shares: (S,) place within the step, 0 to 1 (outside: extended).
    scale: (rows,) by which each row of derivatives is multiplied.
    y: readings, written; a pose writes three.
    jy: (rows * width,) their derivatives, written.
    width: columns of `jy`, at least n.
    placed: 0, or the first of three columns of `jy` for derivatives by the place and heading of the
        window's start: a car that is the same everywhere moves and turns with it.
    n: columns in use, a multiple of LANES.

Whole numbers go from function to function as `np.int64(3)`: for a plain 3, Numba would compile a
copy of the function for this 3 alone.
"""

# ruff: noqa: TC004  (the printed pieces stand above this text in the compiled module)
from typing import TYPE_CHECKING

import numpy as np

from steerd.sysid.compiler.compile import apart, entry, maker, point
from steerd.sysid.compiler.simd_rows import add_row, copy_row, mix_row, scale_row, shift_row

if TYPE_CHECKING:
    from steerd.sysid.compiler.delayed import spot
    from steerd.sysid.compiler.pieces import (
        ACTUATORS_SLOPES,
        BRISK,
        COLUMNS,
        DELAYS_SLOPES,
        LANES,
        MEMORY,
        OBSERVE_SLOPES,
        PARAMETER_COUNT,
        RATES_SLOPES,
        REMEMBER_SLOPES,
        REMEMBERS,
        Array,
        Indices,
        actuators_jac,
        actuators_push,
        brisk_jac,
        brisk_push,
        delays_jac,
        delays_push,
        observe_jac,
        observe_push,
        rates_jac,
        rates_push,
        remember_jac,
        remember_push,
    )


@point
def copy_columns(to: "Array", first: int, source: "Array", start: int, rows: int, n: int) -> None:
    """Copy rows of `n` columns."""
    for row in range(rows):
        a, b = (first + row) * COLUMNS, (start + row) * COLUMNS
        for i in range(0, n, LANES):
            copy_row(to, a + i, source, b + i)


@apart
def seed(w: "Array", row: int, seeds: "Array", n: int) -> None:
    """Put the parameters' seeds below a piece's rows."""
    for parameter in range(PARAMETER_COUNT):
        for i in range(n):
            w[(row + parameter) * COLUMNS + i] = seeds[parameter, i]


@entry
def delay_columns(
    p: "Array", q: "Array", h: float, seeds: "Array", late: "Array", n: int
) -> "Array":
    """Dead times in steps, into `late`, and their columns: rows steer, drive, pose."""
    j = np.zeros(max(DELAYS_SLOPES, 1))
    w = np.zeros((3 + PARAMETER_COUNT) * COLUMNS)
    seed(w, np.int64(3), seeds, n)
    delays_jac(late, p, q, h, late, j)
    delays_push(j, w, n)
    for i in range(3 * COLUMNS):
        w[i] /= h
    for i in range(3):
        late[i] /= h
    return w


@point
def fetch_one(
    z: "Array",
    w: "Array",
    row: int,
    commands: "Array",
    window: "Array",
    k: int,
    substeps: int,
    late: "Array",
    late_columns: "Array",
    n: int,
) -> None:
    """Both delayed commands of fine step `k` with their columns; see `loops.fetch_commands`."""
    low, high, start = window[0], window[1], window[2]
    for channel in range(2):
        whole = int(np.floor(late[channel]))
        newer, older = (k - whole) // substeps, (k - whole - 1) // substeps
        new = commands[spot(min(max(start + newer, low), high - 1)), channel]
        old = commands[spot(min(max(start + older, low), high - 1)), channel]
        z[row + channel] = new + (late[channel] - whole) * (old - new)
        a, b = (row + channel) * COLUMNS, channel * COLUMNS
        for i in range(0, n, LANES):
            scale_row(w, a + i, late_columns, b + i, old - new)


@point
def stage_columns(w: "Array", before: "Array", step: float, n: int) -> None:
    """Rates' input columns of the chassis: the start's, moved along the last slope's."""
    for row in range(6):
        a, b = row * COLUMNS, (9 + MEMORY + row) * COLUMNS
        for i in range(0, n, LANES):
            mix_row(w, a + i, before, a + i, w, b + i, 1.0, step)


@point
def gather_columns(w: "Array", after: "Array", share: float, n: int) -> None:
    """Add a stage's slope columns to the step."""
    for row in range(6):
        a, b = row * COLUMNS, (9 + MEMORY + row) * COLUMNS
        for i in range(0, n, LANES):
            add_row(after, a + i, w, b + i, share)


@point
def wheel_columns(w: "Array", wa: "Array", reach: float, n: int) -> None:
    """Columns of the wheel on its way."""
    start, end = (10 + MEMORY) * COLUMNS, (11 + MEMORY) * COLUMNS
    for i in range(0, n, LANES):
        mix_row(w, 6 * COLUMNS + i, wa, start + i, wa, end + i, 1.0 - reach, reach)


@point
def march_chassis(
    p: "Array",
    q: "Array",
    h: float,
    tableau: "Array",
    out: "Array",
    wa: "Array",
    state: "Array",
    ds: "Array",
    after: "Array",
    da: "Array",
    z: "Array",
    w: "Array",
    slope: "Array",
    j: "Array",
    n: int,
) -> None:
    """Chassis and its columns over one step; `out`, `wa` are what the actuators do."""
    for i in range(6):
        after[i] = state[i]
    for i in range(1 + MEMORY):
        z[7 + i] = out[3 + i]
    copy_columns(da, np.int64(0), ds, np.int64(0), np.int64(6), n)
    copy_columns(w, np.int64(7), wa, 13 + MEMORY, 1 + MEMORY, n)
    for stage in range(tableau.shape[1]):
        reach, share = tableau[0, stage], h * tableau[1, stage]
        for i in range(6):
            z[i] = state[i] + h * reach * slope[i]
        z[6] = out[0] + reach * (out[1] - out[0])
        if stage == 0:
            copy_columns(w, np.int64(0), ds, np.int64(0), np.int64(6), n)
        else:
            stage_columns(w, ds, h * reach, n)
        wheel_columns(w, wa, reach, n)
        if z[3] > BRISK:
            brisk_jac(z, p, q, h, slope, j)
            brisk_push(j, w, n)
        else:
            rates_jac(z, p, q, h, slope, j)
            rates_push(j, w, n)
        for i in range(6):
            after[i] += share * slope[i]
        gather_columns(w, da, share, n)


@point
def march_memory(
    p: "Array",
    q: "Array",
    h: float,
    out: "Array",
    wa: "Array",
    state: "Array",
    ds: "Array",
    after: "Array",
    da: "Array",
    z: "Array",
    w: "Array",
    j: "Array",
    n: int,
) -> None:
    """Memory after the step and its columns."""
    if not REMEMBERS:
        for i in range(MEMORY):
            after[7 + i] = out[4 + i]
        copy_columns(da, np.int64(7), wa, 14 + MEMORY, MEMORY, n)
        return
    for i in range(6):
        z[i], z[7 + i] = state[i], after[i]
    z[6], z[13] = out[0], out[1]
    for i in range(MEMORY):
        z[14 + i] = out[4 + i]
    copy_columns(w, np.int64(0), ds, np.int64(0), np.int64(6), n)
    copy_columns(w, np.int64(6), wa, 10 + MEMORY, np.int64(1), n)
    copy_columns(w, np.int64(7), da, np.int64(0), np.int64(6), n)
    copy_columns(w, np.int64(13), wa, 11 + MEMORY, np.int64(1), n)
    copy_columns(w, np.int64(14), wa, 14 + MEMORY, MEMORY, n)
    remember_jac(z, p, q, h, after[7:], j)
    remember_push(j, w, n)
    copy_columns(da, np.int64(7), w, 14 + MEMORY, MEMORY, n)


@apart
def flush_columns(ds: "Array", n: int) -> None:
    """Decayed columns become zero: denormal numbers would slow a long window threefold."""
    for row in range(4, 7 + MEMORY):
        a = row * COLUMNS
        for i in range(0, n, LANES):
            shift_row(ds, a + i, ds, a + i, 1e-100)
            shift_row(ds, a + i, ds, a + i, -1e-100)


@point
def drive_one(
    p: "Array",
    q: "Array",
    h: float,
    state: "Array",
    ds: "Array",
    now: float,
    z: "Array",
    wa: "Array",
    out: "Array",
    j: "Array",
    n: int,
) -> None:
    """Actuators with their columns; the commands are in place."""
    for i in range(7 + MEMORY):
        z[i] = state[i]
    z[9 + MEMORY] = now
    copy_columns(wa, np.int64(0), ds, np.int64(0), 7 + MEMORY, n)
    actuators_jac(z, p, q, h, out, j)
    actuators_push(j, wa, n)


@point
def sample(
    p: "Array",
    q: "Array",
    h: float,
    share: float,
    rates: "Array",
    rate: int,
    state: "Array",
    ds: "Array",
    after: "Array",
    da: "Array",
    z: "Array",
    seen: "Array",
    w: "Array",
    j: "Array",
    n: int,
) -> None:
    """What the instruments read `share` of a step after `state`, and its columns.

    The place runs straight from `state` with columns `ds` (share 0) to `after` with `da` (1); the
    share itself has the columns at `rates[rate]`. `seen` gets the five readings, rows 7 to 11 of
    `w` theirs.
    """
    for row in range(7):
        a, move = row * COLUMNS, after[row] - state[row]
        z[row] = state[row] + share * move
        for i in range(0, n, LANES):
            mix_row(w, a + i, ds, a + i, da, a + i, 1.0 - share, share)
            add_row(w, a + i, rates, rate + i, move)
    observe_jac(z, p, q, h, seen, j)
    observe_push(j, w, n)


@maker
def make_work(seeds: "Array", n: int) -> "tuple[Array, ...]":
    """Column rows of actuators, rates, memory and readings, with the parameters' seeds in place."""
    wa = np.zeros((14 + 2 * MEMORY + PARAMETER_COUNT) * COLUMNS)
    wr = np.zeros((15 + MEMORY + PARAMETER_COUNT) * COLUMNS)
    wm = np.zeros((14 + 2 * MEMORY + PARAMETER_COUNT) * COLUMNS)
    wo = np.zeros((12 + PARAMETER_COUNT) * COLUMNS)
    seed(wa, 14 + 2 * MEMORY, seeds, n)
    seed(wr, 15 + MEMORY, seeds, n)
    seed(wm, 14 + 2 * MEMORY, seeds, n)
    seed(wo, np.int64(12), seeds, n)
    return wa, wr, wm, wo


@maker
def make_points() -> "tuple[Array, ...]":
    """Inputs of the three pieces, outputs of actuators, rates and readings, and all slopes."""
    return (
        np.zeros(10 + MEMORY),
        np.zeros(9 + MEMORY),
        np.zeros(14 + MEMORY),
        np.zeros(4 + MEMORY),
        np.zeros(6),
        np.zeros(5),
        np.zeros(max(ACTUATORS_SLOPES, RATES_SLOPES, REMEMBER_SLOPES, OBSERVE_SLOPES)),
    )


@point
def settle(
    p: "Array",
    q: "Array",
    h: float,
    late: "Array",
    late_columns: "Array",
    commands: "Array",
    window: "Array",
    t: float,
    substeps: int,
    state: "Array",
    ds: "Array",
    work: "tuple[Array, ...]",
    points: "tuple[Array, ...]",
    n: int,
) -> None:
    """Actuators alone over the known commands before a window; `state` gets steer and memory."""
    wa, za, out, j = work[0], points[0], points[3], points[6]
    if window[4] <= 0:
        return
    offset = state[6]
    row = 7 + MEMORY
    fetch_one(za, wa, row, commands, window, -window[4], substeps, late, late_columns, n)
    state[6] = za[row]
    copy_columns(ds, np.int64(6), wa, row, np.int64(1), n)
    for k in range(-window[4], 0):
        fetch_one(za, wa, row, commands, window, k, substeps, late, late_columns, n)
        drive_one(p, q, h, state, ds, t + k * h, za, wa, out, j, n)
        state[6] = out[2]
        copy_columns(ds, np.int64(6), wa, 12 + MEMORY, np.int64(1), n)
        for i in range(MEMORY):
            state[7 + i] = out[4 + i]
        copy_columns(ds, np.int64(7), wa, 14 + MEMORY, MEMORY, n)
    state[6] += offset


@point
def place_columns(
    seen: "Array", start: "Array", scale: "Array", row: int, jy: "Array", to: int, width: int
) -> None:
    """Derivatives of a pose by the place and heading of its window's start."""
    near, turned = scale[spot(row)], scale[spot(row + 2)]
    jy[spot(to)] = near
    jy[spot(to + 2)] = (start[1] - seen[1]) * near
    jy[spot(to + width + 1)] = scale[spot(row + 1)]
    jy[spot(to + width + 2)] = (seen[0] - start[0]) * scale[spot(row + 1)]
    jy[spot(to + 2 * width + 2)] = turned


@point
def read_station(
    p: "Array",
    q: "Array",
    h: float,
    stations: "Indices",
    number: int,
    share: float,
    rates: "Array",
    state: "Array",
    ds: "Array",
    after: "Array",
    da: "Array",
    wo: "Array",
    points: "tuple[Array, ...]",
    scale: "Array",
    y: "Array",
    jy: "Array",
    width: int,
    placed: int,
    start: "Array",
    n: int,
) -> None:
    """One station's readings and their columns into their rows."""
    seen, late = points[5], stations[number, 3]
    sample(
        p, q, h, share, rates, late * COLUMNS, state, ds, after, da, points[2], seen, wo,
        points[6], n,
    )  # fmt: skip
    channel, row = stations[number, 1], stations[number, 2]
    count = 3 if late == 1 else 1
    for c in range(count):
        y[spot(row + c)] = seen[channel + c]
        b, unit, to = (7 + channel + c) * COLUMNS, scale[spot(row + c)], (row + c) * width
        for i in range(0, n, LANES):
            scale_row(jy, to + i, wo, b + i, unit)
        for i in range(placed, placed + 3 if placed else 0):
            jy[spot(to + i)] = 0.0
    if placed and late == 1:
        place_columns(seen, start, scale, row, jy, row * width + placed, width)


@apart
def seed_state(ds: "Array", dfirst: "Array", first: int, last: int, n: int) -> None:
    """Add the first state's columns, some of its rows."""
    for row in range(first, last):
        for i in range(n):
            ds[row * COLUMNS + i] += dfirst[row, i]


@maker
def pose_rates(late_columns: "Array", n: int) -> "Array":
    """Columns of a reading's place within its step: nothing moves it, or the poses' dead time."""
    rates = np.zeros(2 * COLUMNS)
    for i in range(n):
        rates[COLUMNS + i] = -late_columns[2 * COLUMNS + i]
    return rates


@entry
def march_window(
    p: "Array",
    q: "Array",
    h: float,
    tableau: "Array",
    seeds: "Array",
    late: "Array",
    late_columns: "Array",
    commands: "Array",
    window: "Array",
    t: float,
    substeps: int,
    first: "Array",
    dfirst: "Array",
    stations: "Array",
    shares: "Array",
    scale: "Array",
    y: "Array",
    jy: "Array",
    width: int,
    placed: int,
    n: int,
) -> None:
    """Readings of one window at its stations, and their derivatives (see the module)."""
    work, points = make_work(seeds, n), make_points()
    wa, wr, wm, wo = work
    za, zr, zm, out, slope, _, j = points
    state, after, start = first.copy(), np.zeros(7 + MEMORY), first
    ds, da = np.zeros((7 + MEMORY) * COLUMNS), np.zeros((7 + MEMORY) * COLUMNS)
    rates = pose_rates(late_columns, n)
    seed_state(ds, dfirst, np.int64(0), np.int64(6), n)
    settle(p, q, h, late, late_columns, commands, window, t, substeps, state, ds, work, points, n)
    seed_state(ds, dfirst, np.int64(6), np.int64(7), n)
    station, last = 0, window[3] - 1
    for k in range(window[3]):
        fetch_one(za, wa, 7 + MEMORY, commands, window, k, substeps, late, late_columns, n)
        drive_one(p, q, h, state, ds, t + k * h, za, wa, out, j, n)
        zr[8 + MEMORY] = t + k * h
        march_chassis(p, q, h, tableau, out, wa, state, ds, after, da, zr, wr, slope, j, n)
        after[6] = out[2]
        copy_columns(da, np.int64(6), wa, 12 + MEMORY, np.int64(1), n)
        march_memory(p, q, h, out, wa, state, ds, after, da, zm, wm, j, n)
        while station < len(stations) and (stations[station, 0] <= k or k == last):
            share = shares[station] + (stations[station, 0] - k)
            read_station(
                p, q, h, stations, station, share, rates, state, ds, after, da, wo, points,
                scale, y, jy, width, placed, start, n,
            )  # fmt: skip
            station += 1
        if k % 64 == 0:
            flush_columns(da, n)
        state, after = after, state
        ds, da = da, ds
