"""Marching many windows side by side, and back: the loops around the printed pieces.

This file's text is appended, after `delayed`'s, to the pieces that `codegen` prints for a model
(`pieces.pyi` declares them), so that Numba compiles and caches both as one module. The order within
a step is that of `steerd.car_model.rollout`: actuators exact over the step, wheels moving linearly
within it, memory at its end. Windows are lanes; a state is 7 + MEMORY rows of them. A path has rows
of all lanes, so that it can be seen as states by window without a copy; the loops work on a block
of `LANES` at a time.

Euler and Runge-Kutta 4 are one loop: stage i starts at `state + h reach[i] slope[i-1]`, with the
wheels `reach[i]` of the way; the step is the sum of `h weight[i] slope[i]`.

`simulate_block` and `adjoint_block` are what Python calls, once for each block. The adjoint
takes the arguments of `simulate_block`, which wrote `path`, and:
    bars: the loss's derivatives by every state, flat, with `strides` by window, moment and state.
    windows: how many of all lanes are real.
    into: (rows, 2), to which derivatives by the commands are added; without rows, none are wanted.
    bar: ((7 + MEMORY) * LANES,) gets the derivatives by the first states.
    slopes: gets those by the parameters, other than through the delays.
    late_bars: (2 * LANES,) gets those by the dead times of steer and drive [1/step].
"""

# ruff: noqa: TC004  (the printed pieces stand above this text in the compiled module)
from typing import TYPE_CHECKING

import numpy as np

from steerd.sysid.compiler.compile import apart, entry, maker, point
from steerd.sysid.compiler.simd_rows import add_row, copy_row, expect, mix_row, row_above, shift_row

if TYPE_CHECKING:
    from steerd.sysid.compiler.delayed import (
        delays_in_steps,
        fetch_commands,
        gather_lateness,
        make_stream,
        return_commands,
        return_stream,
        spot,
        stream_ahead,
    )
    from steerd.sysid.compiler.pieces import (
        BRISK,
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
        rates_lanes,
        rates_vjp,
        remember_lanes,
        remember_vjp,
    )


AHEAD = 4
"""Moments that are asked for before they are needed."""


@point
def copy_rows(to: "Array", first: int, source: "Array", start: int, rows: int) -> None:
    """Copy whole rows of lanes."""
    for row in range(rows):
        copy_row(to, (first + row) * LANES, source, (start + row) * LANES)


@point
def clear(to: "Array") -> None:
    """Set every number to zero."""
    for i in range(len(to)):
        to[i] = 0.0


@point
def add_rows(to: "Array", first: int, source: "Array", start: int, rows: int, scale: float) -> None:
    """Add `scale` times whole rows of lanes."""
    for row in range(rows):
        add_row(to, (first + row) * LANES, source, (start + row) * LANES, scale)


@point
def find_rates(w: "Array", n: int, p: "Array", q: "Array", h: float) -> None:
    """The rates of all lanes; the short equations where none is near walking pace (`special`)."""
    if row_above(w, 3 * LANES, BRISK):
        brisk_lanes(w, n, p, q, h)
    else:
        rates_lanes(w, n, p, q, h)


@point
def drive_lanes(
    wa: "Array",
    wr: "Array",
    now: float,
    t: "Array",
    p: "Array",
    q: "Array",
    h: float,
) -> None:
    """Run the actuators and hand the rates what they do; state and delayed commands are there."""
    shift_row(wa, (9 + MEMORY) * LANES, t, 0, now)
    actuators_lanes(wa, LANES, p, q, h)
    copy_rows(wr, np.int64(7), wa, 13 + MEMORY, 1 + MEMORY)
    copy_rows(wr, 8 + MEMORY, wa, 9 + MEMORY, np.int64(1))


@point
def set_stage(wr: "Array", stage: int, wa: "Array", step: float, reach: float) -> None:
    """Inputs of one stage: state moved along the last slope, wheels on their way."""
    slope, start, end = (9 + MEMORY) * LANES, (10 + MEMORY) * LANES, (11 + MEMORY) * LANES
    if stage == 0:
        copy_rows(wr, np.int64(0), wa, np.int64(0), np.int64(6))
    else:
        for a in range(0, 6 * LANES, LANES):
            mix_row(wr, a, wa, a, wr, slope + a, 1.0, step)
    mix_row(wr, 6 * LANES, wa, start, wa, end, 1.0 - reach, reach)


@point
def remember_step(wm: "Array", wa: "Array", after: "Array") -> None:
    """Inputs of the memory after a step: chassis and wheel before and after, memory within."""
    outputs = 10 + MEMORY
    copy_rows(wm, np.int64(0), wa, np.int64(0), np.int64(6))
    copy_rows(wm, np.int64(6), wa, outputs, np.int64(1))
    copy_rows(wm, np.int64(7), after, np.int64(0), np.int64(6))
    copy_rows(wm, np.int64(13), wa, outputs + 1, np.int64(1))
    copy_rows(wm, np.int64(14), wa, outputs + 4, MEMORY)


@point
def take_state(to: "Array", path: "Array", breadth: int, lane: int, k: int) -> None:
    """The state of moment `k` from a path."""
    for row in range(7 + MEMORY):
        copy_row(to, row * LANES, path, ((7 + MEMORY) * k + row) * breadth + lane)


@point
def put_state(path: "Array", breadth: int, lane: int, k: int, state: "Array") -> None:
    """The state of moment `k` into a path."""
    for row in range(7 + MEMORY):
        copy_row(path, ((7 + MEMORY) * k + row) * breadth + lane, state, row * LANES)


@entry
def simulate_block(
    p: "Array",
    q: "Array",
    h: float,
    tableau: "Array",
    path: "Array",
    breadth: int,
    window: int,
    commands: "Array",
    runs: "Array",
    t: "Array",
    substeps: int,
) -> None:
    """March a block of windows.

    Args:
        p: parameters.
        q: their constants for step `h`.
        h: step [s], `substeps` of which share one command.
        tableau: (2, stages) reach and weight of each stage.
        path: ((steps + 1) * (7 + MEMORY) * breadth,) states before each step; the first is given.
        breadth: number of all lanes.
        window: the block's first lane.
        commands: (rows, 2) steer [rad] and speed [m/s], all runs one after the other.
        runs: (LANES, 3) first row, row after the last, and row of the first step, by lane.
        t: (LANES,) time into the run at the first step [s].
        substeps: steps to a command.
    """
    late, steps = delays_in_steps(p, q, h), len(path) // ((7 + MEMORY) * breadth) - 1
    stream, ahead = make_stream(commands, runs, late, steps, substeps), stream_ahead(late, substeps)
    wa = np.zeros((14 + 2 * MEMORY) * LANES)
    wr = np.zeros((15 + MEMORY) * LANES)
    wm = np.zeros((14 + 2 * MEMORY) * LANES)
    state = np.zeros((7 + MEMORY) * LANES)
    take_state(state, path, breadth, window, np.int64(0))
    for k in range(steps):
        copy_rows(wa, np.int64(0), state, np.int64(0), 7 + MEMORY)
        fetch_commands(wa, 7 + MEMORY, stream, ahead, k, substeps, late)
        drive_lanes(wa, wr, k * h, t, p, q, h)
        for stage in range(tableau.shape[1]):
            reach = tableau[0, stage]
            set_stage(wr, stage, wa, h * reach, reach)
            find_rates(wr, LANES, p, q, h)
            add_rows(state, np.int64(0), wr, 9 + MEMORY, np.int64(6), h * tableau[1, stage])
        copy_rows(state, np.int64(6), wa, 12 + MEMORY, np.int64(1))
        if REMEMBERS:
            remember_step(wm, wa, state)
            remember_lanes(wm, LANES, p, q, h)
            copy_rows(state, np.int64(7), wm, 14 + MEMORY, MEMORY)
        else:
            copy_rows(state, np.int64(7), wa, 14 + MEMORY, MEMORY)
        put_state(path, breadth, window, k + 1, state)


@point
def redo_stages(
    p: "Array",
    q: "Array",
    h: float,
    tableau: "Array",
    wa: "Array",
    wr: "Array",
    inputs: "Array",
) -> None:
    """The stages again; their inputs are kept for their derivatives."""
    rows, stages = 9 + MEMORY, tableau.shape[1]
    for stage in range(stages):
        reach = tableau[0, stage]
        set_stage(wr, stage, wa, h * reach, reach)
        copy_rows(inputs, stage * rows, wr, np.int64(0), rows)
        if stage < stages - 1:
            find_rates(wr, LANES, p, q, h)


@point
def back_remember(
    wm: "Array", bar: "Array", kept: "Array", link_bars: "Array", p: "Array", q: "Array", h: float
) -> None:
    """Through the memory's update; its inputs are in place. `link_bars`: the actuators' outputs."""
    inputs = 14 + MEMORY
    slopes = inputs + MEMORY
    copy_rows(wm, inputs, bar, np.int64(7), MEMORY)
    remember_vjp(wm, LANES, p, q, h)
    add_rows(link_bars, np.int64(0), wm, slopes + 6, np.int64(1), 1.0)
    add_rows(link_bars, np.int64(1), wm, slopes + 13, np.int64(1), 1.0)
    copy_rows(link_bars, np.int64(4), wm, slopes + 14, MEMORY)
    add_rows(bar, np.int64(0), wm, slopes + 7, np.int64(6), 1.0)
    add_rows(kept, np.int64(0), wm, slopes, np.int64(6), 1.0)


@point
def weigh_slopes(w: "Array", bar: "Array", share: float, carried: float) -> None:
    """Weights of a stage's slopes: its share of the step's end, and of the next stage's start."""
    weights, slopes = (9 + MEMORY) * LANES, (15 + MEMORY) * LANES
    for a in range(0, 6 * LANES, LANES):
        mix_row(w, weights + a, bar, a, w, slopes + a, share, carried)


@point
def back_stages(
    p: "Array",
    q: "Array",
    h: float,
    tableau: "Array",
    inputs: "Array",
    w: "Array",
    bar: "Array",
    kept: "Array",
    link_bars: "Array",
) -> None:
    """Through the stages in reverse; `kept` gathers the derivative to the state at the start."""
    rows, stages = 9 + MEMORY, tableau.shape[1]
    slopes, carried = rows + 6, 0.0
    for stage in range(stages - 1, -1, -1):
        reach = tableau[0, stage]
        weigh_slopes(w, bar, h * tableau[1, stage], carried)
        copy_rows(w, np.int64(0), inputs, stage * rows, rows)
        if row_above(w, 3 * LANES, BRISK):
            brisk_vjp(w, LANES, p, q, h)
        else:
            rates_vjp(w, LANES, p, q, h)
        add_rows(kept, np.int64(0), w, slopes, np.int64(6), 1.0)
        add_rows(link_bars, np.int64(0), w, slopes + 6, np.int64(1), 1.0 - reach)
        add_rows(link_bars, np.int64(1), w, slopes + 6, np.int64(1), reach)
        add_rows(link_bars, np.int64(3), w, slopes + 7, 1 + MEMORY, 1.0)
        carried = h * reach


@point
def set_bars(
    bar: "Array", bars: "Array", strides: "Indices", window: int, windows: int, k: int
) -> None:
    """Derivatives to the states of moment `k` as rows; lanes without a window get none."""
    if strides[0] == 1 and window + LANES <= windows:
        for row in range(7 + MEMORY):
            at, to = window + k * strides[1] + row * strides[2], row * LANES
            copy_row(bar, to, bars, at)
        return
    for lane in range(LANES):
        at = (window + lane) * strides[0] + k * strides[1]
        for row in range(7 + MEMORY):
            real = window + lane < windows
            bar[row * LANES + lane] = bars[spot(at + row * strides[2])] if real else 0.0


@point
def expect_moment(
    path: "Array",
    breadth: int,
    bars: "Array",
    strides: "Indices",
    window: int,
    windows: int,
    k: int,
) -> None:
    """Ask for what a moment needs; no machine foresees that memory is read backwards."""
    if k < 0:
        return
    for row in range(7 + MEMORY):
        expect(path, ((7 + MEMORY) * k + row) * breadth + window)
    if strides[0] == 1:
        for row in range(7 + MEMORY):
            expect(bars, window + k * strides[1] + row * strides[2])
    else:
        for lane in range(min(windows - window, LANES)):
            expect(bars, (window + lane) * strides[0] + k * strides[1])


@apart
def sum_slopes(w: "Array", row: int, slopes: "Array") -> None:
    """Add a workspace's derivatives to the parameters, over its lanes."""
    for parameter in range(PARAMETER_COUNT):
        for lane in range(LANES):
            slopes[parameter] += w[(row + parameter) * LANES + lane]


@apart
def sum_all_slopes(wva: "Array", wm: "Array", wr: "Array", slopes: "Array") -> None:
    """Add those of actuators, memory and rates."""
    sum_slopes(wva, 2 * (10 + MEMORY) + 4 + MEMORY, slopes)
    sum_slopes(wm, 2 * (14 + MEMORY) + MEMORY, slopes)
    sum_slopes(wr, 2 * (9 + MEMORY) + 6, slopes)


@maker
def make_adjoint_work(stages: int) -> "tuple[Array, ...]":
    """Workspaces of actuators, their derivatives, rates, memory; and what goes between them."""
    rows_a, rows_r = 10 + MEMORY, 9 + MEMORY
    return (
        np.zeros((rows_a + 4 + MEMORY) * LANES),
        np.zeros((2 * rows_a + 4 + MEMORY + PARAMETER_COUNT) * LANES),
        np.zeros((2 * rows_r + 6 + PARAMETER_COUNT) * LANES),
        np.zeros((2 * (14 + MEMORY) + MEMORY + PARAMETER_COUNT) * LANES),
        np.zeros(stages * rows_r * LANES),
        np.zeros(6 * LANES),
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
    breadth: int,
    window: int,
    bars: "Array",
    strides: "Indices",
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
    """Back over a block of windows (see the module)."""
    rows_a, states = 10 + MEMORY, 7 + MEMORY
    late, steps = delays_in_steps(p, q, h), len(path) // (states * breadth) - 1
    stream, ahead = make_stream(commands, runs, late, steps, substeps), stream_ahead(late, substeps)
    returned = np.zeros(len(stream) if len(into) else 0)
    wa, wva, wr, wm, inputs, after, kept, link_bars = make_adjoint_work(tableau.shape[1])
    back = rows_a + 4 + MEMORY
    set_bars(bar, bars, strides, window, windows, steps)
    take_state(wa, path, breadth, window, steps)
    for k in range(steps - 1, -1, -1):
        expect_moment(path, breadth, bars, strides, window, windows, k - AHEAD)
        if REMEMBERS:
            copy_rows(after, np.int64(0), wa, np.int64(0), np.int64(6))
        take_state(wa, path, breadth, window, k)
        fetch_commands(wa, 7 + MEMORY, stream, ahead, k, substeps, late)
        drive_lanes(wa, wr, k * h, t, p, q, h)
        redo_stages(p, q, h, tableau, wa, wr, inputs)
        clear(link_bars)
        copy_rows(link_bars, np.int64(2), bar, np.int64(6), np.int64(1))
        clear(kept)
        if REMEMBERS:
            remember_step(wm, wa, after)
            back_remember(wm, bar, kept, link_bars, p, q, h)
        else:
            copy_rows(link_bars, np.int64(4), bar, np.int64(7), MEMORY)
        add_rows(kept, np.int64(0), bar, np.int64(0), np.int64(6), 1.0)
        back_stages(p, q, h, tableau, inputs, wr, bar, kept, link_bars)
        copy_rows(wva, np.int64(0), wa, np.int64(0), rows_a)
        copy_rows(wva, rows_a, link_bars, np.int64(0), 4 + MEMORY)
        actuators_vjp(wva, LANES, p, q, h)
        set_bars(bar, bars, strides, window, windows, k)
        add_rows(bar, np.int64(0), kept, np.int64(0), np.int64(6), 1.0)
        add_rows(bar, np.int64(0), wva, back, states, 1.0)
        row = back + states
        gather_lateness(wva, row, stream, ahead, k, substeps, late, late_bars)
        if len(into):
            return_commands(wva, row, returned, ahead, k, substeps, late)
    sum_all_slopes(wva, wm, wr, slopes)
    if len(into):
        return_stream(returned, runs, into, ahead)
