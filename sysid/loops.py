"""Marching many windows side by side, and back: the loops around the printed pieces.

This file's text is appended to the pieces that `codegen` prints for a model (`pieces.pyi` declares
them), so that Numba compiles and caches both as one module. The order within a step is that of
`car_model.rollout`: actuators exact over the step, wheels moving linearly within it, memory at its
end. Rows of 16 lanes are contiguous; a state is 7 + MEMORY rows.

Euler and Runge-Kutta 4 are one loop: stage i starts at `state + h reach[i] slope[i-1]`, with the
wheels `reach[i]` of the way; the step is the sum of `h weight[i] slope[i]`.

`simulate_block` and `adjoint_block` are what Python calls, once for each 16 windows. The adjoint
takes the arguments of `simulate_block`, which wrote `path`, and:
    bars: the loss's derivatives by every state, flat, with `strides` by window, moment and state.
    window: number of the first lane; only the first `windows` of all lanes are real.
    into: (rows, 2), to which derivatives by the commands are added.
    bar: ((7 + MEMORY) * 16,) gets the derivatives by the first states.
    slopes: those by the parameters, other than through the delays, are added.
    late_bars: (2, 16), to which those by the dead times of steer and drive are added [1/step].
"""

# ruff: noqa: TC004  (the printed pieces stand above this text in the compiled module)
from typing import TYPE_CHECKING

import numpy as np

from sysid.compile import entry, point

if TYPE_CHECKING:
    from sysid.pieces import (
        BRISK,
        DELAYS_SLOPES,
        LANES,
        MEMORY,
        PARAMETER_COUNT,
        REMEMBERS,
        Array,
        Indices,
        actuators_lanes,
        actuators_vjp,
        brisk_lanes,
        brisk_vjp,
        delays_jac,
        rates_lanes,
        rates_vjp,
        remember_lanes,
        remember_vjp,
    )


@entry
def delays_at(p: "Array", q: "Array", h: float) -> "Array":
    """Dead times of steer, drive and pose [s]."""
    out, j = np.zeros(3), np.zeros(max(DELAYS_SLOPES, 1))
    delays_jac(out, p, q, h, out, j)
    return out


@point
def delays_in_steps(p: "Array", q: "Array", h: float) -> "Array":
    """Dead times of steer, drive and pose in steps."""
    late, j = np.zeros(3), np.zeros(max(DELAYS_SLOPES, 1))
    delays_jac(late, p, q, h, late, j)
    for i in range(3):
        late[i] /= h
    return late


@point
def copy_rows(to: "Array", first: int, source: "Array", start: int, rows: int) -> None:
    """Copy whole rows of lanes; one by one, as a call of memmove costs more than it copies."""
    for row in range(rows):
        a, b = (first + row) * LANES, (start + row) * LANES
        for lane in range(LANES):
            to[a + lane] = source[b + lane]


@point
def clear(to: "Array") -> None:
    """Set every number to zero."""
    for i in range(len(to)):
        to[i] = 0.0


@point
def add_rows(to: "Array", first: int, source: "Array", start: int, rows: int, scale: float) -> None:
    """Add `scale` times whole rows of lanes."""
    a, b = first * LANES, start * LANES
    for i in range(rows * LANES):
        to[a + i] += scale * source[b + i]


@point
def make_stream(
    commands: "Array", runs: "Array", late: "Array", steps: int, substeps: int
) -> "Array":
    """Commands of 16 windows, lanes innermost: `[channel, coarse step, lane]`.

    The first entry is the oldest command that still arrives late in the windows; before a run's
    first command the first holds, after the last the last.
    """
    oldest = int(np.floor(max(late[0], late[1]))) + substeps
    newest = steps - int(np.floor(min(late[0], late[1])))
    ahead = -(-oldest // substeps)
    stream = np.empty((2, ahead + newest // substeps + 1, LANES))
    for c in range(stream.shape[1]):
        for lane in range(LANES):
            low, high, start = runs[lane, 0], runs[lane, 1], runs[lane, 2]
            row = min(max(start + c - ahead, low), high - 1)
            stream[0, c, lane] = commands[row, 0]
            stream[1, c, lane] = commands[row, 1]
    return stream


@point
def return_stream(bars: "Array", runs: "Array", into: "Array", ahead: int) -> None:
    """The reverse of `make_stream`."""
    for c in range(bars.shape[1]):
        for lane in range(LANES):
            low, high, start = runs[lane, 0], runs[lane, 1], runs[lane, 2]
            row = min(max(start + c - ahead, low), high - 1)
            into[row, 0] += bars[0, c, lane]
            into[row, 1] += bars[1, c, lane]


@point
def stream_ahead(late: "Array", substeps: int) -> int:
    """How many entries of a stream lie before the windows' first step."""
    return -(-(int(np.floor(max(late[0], late[1]))) + substeps) // substeps)


@point
def fetch_commands(
    w: "Array", row: int, stream: "Array", ahead: int, k: int, substeps: int, late: "Array", n: int
) -> None:
    """Write both delayed commands of fine step `k` as rows.

    The mean of a held signal over a step is linear in its delay (`rollout.channel_delayed`).
    """
    for channel in range(2):
        whole = int(np.floor(late[channel]))
        part = late[channel] - whole
        newer = stream[channel, ahead + (k - whole) // substeps]
        older = stream[channel, ahead + (k - whole - 1) // substeps]
        at = (row + channel) * LANES
        for lane in range(n):
            w[at + lane] = newer[lane] + part * (older[lane] - newer[lane])


@point
def return_commands(
    w: "Array",
    row: int,
    stream: "Array",
    bars: "Array",
    ahead: int,
    k: int,
    substeps: int,
    late: "Array",
    late_bars: "Array",
    n: int,
) -> None:
    """The reverse of `fetch_commands`: derivatives to the commands and to the delays in steps."""
    for channel in range(2):
        whole = int(np.floor(late[channel]))
        part = late[channel] - whole
        newer = ahead + (k - whole) // substeps
        older = ahead + (k - whole - 1) // substeps
        at = (row + channel) * LANES
        for lane in range(n):
            bar = w[at + lane]
            bars[channel, newer, lane] += (1.0 - part) * bar
            bars[channel, older, lane] += part * bar
            late_bars[channel, lane] += bar * (
                stream[channel, older, lane] - stream[channel, newer, lane]
            )


@point
def set_stage(
    wr: "Array", stage: int, ends: "Array", state: "Array", step: float, reach: float, n: int
) -> None:
    """Inputs of one stage: state moved along the last slope, wheels on their way."""
    n_in = (9 + MEMORY) * LANES
    if stage == 0:
        copy_rows(wr, np.int64(0), state, np.int64(0), np.int64(6))
    else:
        for i in range(6 * LANES):
            wr[i] = state[i] + step * wr[n_in + i]
    for lane in range(n):
        start = ends[lane]
        wr[6 * LANES + lane] = start + reach * (ends[LANES + lane] - start)


@point
def is_brisk(w: "Array") -> bool:
    """Whether no lane of a rates' workspace is near walking pace (see `special`)."""
    slow = 0
    for lane in range(LANES):
        slow += 0 if w[3 * LANES + lane] > BRISK else 1
    return slow == 0


@point
def find_rates(w: "Array", n: int, p: "Array", q: "Array", h: float) -> None:
    """The rates of all lanes."""
    if is_brisk(w):
        brisk_lanes(w, n, p, q, h)
    else:
        rates_lanes(w, n, p, q, h)


@point
def drive_lanes(
    wa: "Array", state: "Array", t: "Array", k: int, p: "Array", q: "Array", h: float, n: int
) -> None:
    """Run the actuators; the delayed commands are in place."""
    copy_rows(wa, np.int64(0), state, np.int64(0), 7 + MEMORY)
    for lane in range(n):
        wa[(9 + MEMORY) * LANES + lane] = t[lane] + k * h
    actuators_lanes(wa, n, p, q, h)


@point
def ready_rates(wa: "Array", wr: "Array", ends: "Array") -> None:
    """Hand what the actuators do to the rates: wheel at both ends, acceleration, memory, time."""
    outputs = 10 + MEMORY
    copy_rows(ends, np.int64(0), wa, outputs, np.int64(2))
    copy_rows(wr, 7, wa, outputs + 3, 1 + MEMORY)
    copy_rows(wr, 8 + MEMORY, wa, 9 + MEMORY, np.int64(1))


@point
def remember_step(wm: "Array", ends: "Array", before: "Array", after: "Array", wr: "Array") -> None:
    """Inputs of the memory after a step: chassis and wheel before and after, memory within."""
    copy_rows(wm, np.int64(0), before, np.int64(0), np.int64(6))
    copy_rows(wm, 6, ends, 0, 1)
    copy_rows(wm, np.int64(7), after, np.int64(0), np.int64(6))
    copy_rows(wm, 13, ends, 1, 1)
    copy_rows(wm, np.int64(14), wr, np.int64(8), MEMORY)


@entry
def simulate_block(
    p: "Array",
    q: "Array",
    h: float,
    tableau: "Array",
    path: "Array",
    commands: "Array",
    runs: "Array",
    t: "Array",
    substeps: int,
) -> None:
    """March 16 windows.

    Args:
        p: parameters.
        q: their constants for step `h`.
        h: step [s], `substeps` of which share one command.
        tableau: (2, stages) reach and weight of each stage.
        path: (steps + 1, (7 + MEMORY) * 16) states before each step; the first is given.
        commands: (rows, 2) steer [rad] and speed [m/s], all runs one after the other.
        runs: (16, 3) first row, row after the last, and row of the first step, by lane.
        t: (16,) time into the run at the first step [s].
        substeps: steps to a command.
    """
    late = delays_in_steps(p, q, h)
    stream = make_stream(commands, runs, late, path.shape[0] - 1, substeps)
    n, stages = len(t), tableau.shape[1]
    wa = np.zeros((14 + 2 * MEMORY) * LANES)
    wr = np.zeros((15 + MEMORY) * LANES)
    wm = np.zeros((14 + 2 * MEMORY) * LANES)
    ends = np.zeros(2 * LANES)
    n_in = (9 + MEMORY) * LANES
    ahead = stream_ahead(late, substeps)
    for k in range(path.shape[0] - 1):
        state, after = path[k], path[k + 1]
        fetch_commands(wa, 7 + MEMORY, stream, ahead, k, substeps, late, n)
        drive_lanes(wa, state, t, k, p, q, h, n)
        ready_rates(wa, wr, ends)
        copy_rows(after, np.int64(0), state, np.int64(0), np.int64(6))
        for stage in range(stages):
            reach = tableau[0, stage]
            set_stage(wr, stage, ends, state, h * reach, reach, n)
            find_rates(wr, n, p, q, h)
            share = h * tableau[1, stage]
            for i in range(6 * n):
                after[i] += share * wr[n_in + i]
        copy_rows(after, np.int64(6), wa, 12 + MEMORY, np.int64(1))
        if REMEMBERS:
            remember_step(wm, ends, state, after, wr)
            remember_lanes(wm, n, p, q, h)
            copy_rows(after, np.int64(7), wm, 14 + MEMORY, MEMORY)
        else:
            copy_rows(after, np.int64(7), wr, np.int64(8), MEMORY)


@point
def redo_stages(
    p: "Array",
    q: "Array",
    h: float,
    tableau: "Array",
    state: "Array",
    wa: "Array",
    work: "Array",
    n: int,
) -> None:
    """The stages again, each in a workspace of its own, ready for its derivatives."""
    stages, outputs, n_in = len(work), (10 + MEMORY) * LANES, (9 + MEMORY) * LANES
    for stage in range(stages):
        w, reach = work[stage], tableau[0, stage]
        if stage == 0:
            copy_rows(w, np.int64(0), state, np.int64(0), np.int64(6))
        else:
            last = work[stage - 1]
            for i in range(6 * n):
                w[i] = state[i] + h * reach * last[n_in + i]
        for lane in range(n):
            start = wa[outputs + lane]
            w[6 * LANES + lane] = start + reach * (wa[outputs + LANES + lane] - start)
        copy_rows(w, np.int64(7), wa, 13 + MEMORY, 1 + MEMORY)
        copy_rows(w, 8 + MEMORY, wa, 9 + MEMORY, 1)
        if stage < stages - 1:
            find_rates(w, n, p, q, h)


@point
def back_remember(
    wm: "Array", bar: "Array", link_bars: "Array", p: "Array", q: "Array", h: float, n: int
) -> None:
    """Through the memory's update; its inputs are in place. `link_bars`: the actuators' outputs."""
    inputs = 14 + MEMORY
    slopes = inputs + MEMORY
    copy_rows(wm, inputs, bar, np.int64(7), MEMORY)
    remember_vjp(wm, n, p, q, h)
    add_rows(link_bars, np.int64(0), wm, slopes + 6, np.int64(1), 1.0)
    add_rows(link_bars, 1, wm, slopes + 13, 1, 1.0)
    copy_rows(link_bars, np.int64(4), wm, slopes + 14, MEMORY)
    add_rows(bar, np.int64(0), wm, slopes + 7, np.int64(6), 1.0)


@point
def back_stages(
    p: "Array",
    q: "Array",
    h: float,
    tableau: "Array",
    work: "Array",
    bar: "Array",
    kept: "Array",
    link_bars: "Array",
    n: int,
) -> None:
    """Through the stages in reverse; `kept` gathers the derivative to the state at the start."""
    rows, stages = 9 + MEMORY, len(work)
    slopes = rows + 6
    for stage in range(stages - 1, -1, -1):
        w, share, reach = work[stage], h * tableau[1, stage], tableau[0, stage]
        for i in range(6 * n):
            w[rows * LANES + i] = share * bar[i]
        if stage < stages - 1:
            add_rows(w, rows, work[stage + 1], slopes, np.int64(6), h * tableau[0, stage + 1])
        if is_brisk(w):
            brisk_vjp(w, n, p, q, h)
        else:
            rates_vjp(w, n, p, q, h)
        add_rows(kept, np.int64(0), w, slopes, np.int64(6), 1.0)
        at = (slopes + 6) * LANES
        for lane in range(n):
            link_bars[lane] += (1.0 - reach) * w[at + lane]
            link_bars[LANES + lane] += reach * w[at + lane]
        add_rows(link_bars, np.int64(3), w, slopes + 7, 1 + MEMORY, 1.0)


@point
def set_bars(
    bar: "Array", bars: "Array", strides: "Indices", window: int, windows: int, k: int
) -> None:
    """Derivatives to the states of moment `k` as rows; lanes without a window get none."""
    if strides[0] == 1 and window + LANES <= windows:
        for row in range(7 + MEMORY):
            at, to = window + k * strides[1] + row * strides[2], row * LANES
            for lane in range(LANES):
                bar[to + lane] = bars[at + lane]
        return
    for row in range(7 + MEMORY):
        for lane in range(LANES):
            at = (window + lane) * strides[0] + k * strides[1] + row * strides[2]
            bar[row * LANES + lane] = bars[at] if window + lane < windows else 0.0


@point
def sum_slopes(w: "Array", row: int, slopes: "Array") -> None:
    """Add a workspace's derivatives to the parameters, over its lanes."""
    for parameter in range(PARAMETER_COUNT):
        for lane in range(LANES):
            slopes[parameter] += w[(row + parameter) * LANES + lane]


@point
def make_adjoint_work() -> "tuple[Array, ...]":
    """Workspaces of actuators, their derivatives, memory, wheels, chassis and links."""
    rows_a = 10 + MEMORY
    return (
        np.zeros((rows_a + 4 + MEMORY) * LANES),
        np.zeros((2 * rows_a + 4 + MEMORY + PARAMETER_COUNT) * LANES),
        np.zeros((2 * (14 + MEMORY) + MEMORY + PARAMETER_COUNT) * LANES),
        np.zeros(2 * LANES),
        np.zeros(6 * LANES),
        np.zeros((4 + MEMORY) * LANES),
    )


@entry
def adjoint_block(
    p: "Array",
    q: "Array",
    h: float,
    tableau: "Array",
    path: "Array",
    bars: "Array",
    strides: "Indices",
    window: int,
    windows: int,
    commands: "Array",
    into: "Array",
    runs: "Array",
    t: "Array",
    substeps: int,
    bar: "Array",
    slopes: "Array",
    late_bars: "Array",
) -> None:
    """Back over 16 windows (see the module)."""
    late = delays_in_steps(p, q, h)
    stream = make_stream(commands, runs, late, path.shape[0] - 1, substeps)
    returned = np.zeros(stream.shape)
    rows_a, rows_r, states = 10 + MEMORY, 9 + MEMORY, 7 + MEMORY
    wa, wva, wm, ends, kept, link_bars = make_adjoint_work()
    work = np.zeros((tableau.shape[1], (2 * rows_r + 6 + PARAMETER_COUNT) * LANES))
    back, n, last = rows_a + 4 + MEMORY, len(t), path.shape[0] - 1
    ahead = stream_ahead(late, substeps)
    set_bars(bar, bars, strides, window, windows, last)
    for k in range(last - 1, -1, -1):
        state = path[k]
        fetch_commands(wa, 7 + MEMORY, stream, ahead, k, substeps, late, n)
        drive_lanes(wa, state, t, k, p, q, h, n)
        redo_stages(p, q, h, tableau, state, wa, work, n)
        clear(link_bars)
        copy_rows(link_bars, np.int64(2), bar, np.int64(6), np.int64(1))
        clear(kept)
        if REMEMBERS:
            copy_rows(ends, np.int64(0), wa, rows_a, np.int64(2))
            remember_step(wm, ends, state, path[k + 1], work[0])
            back_remember(wm, bar, link_bars, p, q, h, n)
            add_rows(kept, np.int64(0), wm, 14 + 2 * MEMORY, np.int64(6), 1.0)
        else:
            copy_rows(link_bars, np.int64(4), bar, np.int64(7), MEMORY)
        add_rows(kept, np.int64(0), bar, np.int64(0), np.int64(6), 1.0)
        back_stages(p, q, h, tableau, work, bar, kept, link_bars, n)
        copy_rows(wva, np.int64(0), wa, np.int64(0), rows_a)
        copy_rows(wva, rows_a, link_bars, np.int64(0), 4 + MEMORY)
        actuators_vjp(wva, n, p, q, h)
        set_bars(bar, bars, strides, window, windows, k)
        add_rows(bar, np.int64(0), kept, np.int64(0), np.int64(6), 1.0)
        add_rows(bar, np.int64(0), wva, back, states, 1.0)
        return_commands(
            wva, back + states, stream, returned, ahead, k, substeps, late, late_bars, n
        )
    sum_slopes(wva, back + rows_a, slopes)
    sum_slopes(wm, 2 * (14 + MEMORY) + MEMORY, slopes)
    for stage in range(len(work)):
        sum_slopes(work[stage], 2 * rows_r + 6, slopes)
    return_stream(returned, runs, into, ahead)
