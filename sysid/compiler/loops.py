"""Simulation of many windows side by side, and its adjoint: the loops around the printed pieces.

This file's text is appended, after `delayed`'s, to the pieces that `codegen` prints for a model
(`pieces.pyi` declares them), so that Numba compiles and caches both as one module. The order within
a step is that of `steerd.car_model.rollout`: actuators exact over the step, wheels moving linearly
within it, memory at its end. Each window has a slot; a state is STATES + MEMORY rows of slots. A
path has rows of all slots, so that it can be viewed as states by window without a copy; the loops
work on a block of `SLOTS` at a time. Row numbers have names, see `layout`.

Euler and Runge-Kutta 4 are one loop: stage i starts at `state + h node[i] slope[i-1]`, with the
wheels at the share `node[i]` of their motion; the step is the sum of `h weight[i] slope[i]`.

`simulate_block`, `settle_block` and `adjoint_block` are what Python calls, once for each block.
"""

# ruff: noqa: TC004  (the printed pieces stand above this text in the compiled module)
from typing import TYPE_CHECKING

import numpy as np

from steerd.sysid.compiler.arguments import (
    AdjointWork,
    Block,
    Gradients,
    Integration,
    StateGradient,
)
from steerd.sysid.compiler.compile import allocating, entry_point, inlined, not_inlined
from steerd.sysid.compiler.simd_rows import (
    add_row,
    copy_row,
    mix_row,
    prefetch,
    row_above,
    shift_row,
)

if TYPE_CHECKING:
    from steerd.sysid.compiler.delayed import (
        add_command_gradient,
        add_delay_gradient,
        add_stream_gradient,
        delay_commands,
        make_stream,
        unsigned,
    )
    from steerd.sysid.compiler.pieces import (
        ACCEL,
        ACTUATORS_COMMAND,
        ACTUATORS_INPUTS,
        ACTUATORS_OUTPUTS,
        ACTUATORS_TIME,
        CHASSIS,
        FIRST,
        MEMORY,
        MEMORY_END,
        ONE,
        PARAMETER_COUNT,
        RATES_ACCEL,
        RATES_INPUTS,
        RATES_TIME,
        RATES_WHEEL,
        REMEMBER_AFTER,
        REMEMBER_INPUTS,
        REMEMBER_MEMORY,
        REMEMBERS,
        SLOTS,
        SPECIALISED_SPEED,
        SPEED,
        STATES,
        STEER,
        STEER_END,
        WHEEL_END,
        WHEEL_START,
        Array,
        Indices,
        actuators_rows,
        actuators_vjp,
        rates_rows,
        rates_vjp,
        remember_rows,
        remember_vjp,
        specialised_rows,
        specialised_vjp,
    )


PREFETCH_AHEAD = 4
"""Moments that are prefetched before they are needed."""


@inlined
def copy_rows(to: "Array", first: int, source: "Array", start: int, rows: int) -> None:
    """Copy whole rows of slots."""
    for row in range(rows):
        copy_row(to, (first + row) * SLOTS, source, (start + row) * SLOTS)


@inlined
def clear(to: "Array") -> None:
    """Set every number to zero."""
    for i in range(len(to)):
        to[i] = 0.0


@inlined
def add_rows(to: "Array", first: int, source: "Array", start: int, rows: int, scale: float) -> None:
    """Add `scale` times whole rows of slots."""
    for row in range(rows):
        add_row(to, (first + row) * SLOTS, source, (start + row) * SLOTS, scale)


@inlined
def find_rates(m: Integration, w: "Array") -> None:
    """The rates in all slots; the specialised equations where every speed allows them."""
    if row_above(w, SPEED * SLOTS, SPECIALISED_SPEED):
        specialised_rows(w, SLOTS, m.p, m.q, m.h)
    else:
        rates_rows(w, SLOTS, m.p, m.q, m.h)


@inlined
def run_actuators(m: Integration, wa: "Array", wr: "Array", t: "Array", k: int) -> None:
    """Run the actuators over step `k` and pass their results to the rates.

    State and delayed commands are in place.
    """
    shift_row(wa, ACTUATORS_TIME * SLOTS, t, FIRST, k * m.h)
    actuators_rows(wa, SLOTS, m.p, m.q, m.h)
    copy_rows(wr, RATES_ACCEL, wa, ACTUATORS_INPUTS + ACCEL, ONE + MEMORY)
    copy_rows(wr, RATES_TIME, wa, ACTUATORS_TIME, ONE)


@inlined
def set_stage(wr: "Array", stage: int, wa: "Array", step: float, node: float) -> None:
    """Inputs of one stage: state moved along the last slope, wheels part of their motion."""
    slope = RATES_INPUTS * SLOTS
    start = (ACTUATORS_INPUTS + WHEEL_START) * SLOTS
    end = (ACTUATORS_INPUTS + WHEEL_END) * SLOTS
    if stage == 0:
        copy_rows(wr, FIRST, wa, FIRST, CHASSIS)
    else:
        for a in range(0, CHASSIS * SLOTS, SLOTS):
            mix_row(wr, a, wa, a, wr, slope + a, 1.0, step)
    mix_row(wr, RATES_WHEEL * SLOTS, wa, start, wa, end, 1.0 - node, node)


@inlined
def set_remember_inputs(wm: "Array", wa: "Array", after: "Array") -> None:
    """Inputs of the memory after a step: chassis and wheel before and after, memory within."""
    outputs = ACTUATORS_INPUTS
    copy_rows(wm, FIRST, wa, FIRST, CHASSIS)
    copy_rows(wm, STEER, wa, outputs + WHEEL_START, ONE)
    copy_rows(wm, REMEMBER_AFTER, after, FIRST, CHASSIS)
    copy_rows(wm, REMEMBER_AFTER + STEER, wa, outputs + WHEEL_END, ONE)
    copy_rows(wm, REMEMBER_MEMORY, wa, outputs + MEMORY_END, MEMORY)


@inlined
def load_state(to: "Array", path: "Array", block: Block, k: int) -> None:
    """The state of moment `k` from a path."""
    for row in range(STATES + MEMORY):
        place = ((STATES + MEMORY) * k + row) * block.slots + block.slot
        copy_row(to, row * SLOTS, path, place)


@inlined
def store_state(path: "Array", block: Block, k: int, state: "Array") -> None:
    """The state of moment `k` into a path."""
    for row in range(STATES + MEMORY):
        place = ((STATES + MEMORY) * k + row) * block.slots + block.slot
        copy_row(path, place, state, row * SLOTS)


@inlined
def steps_of(path: "Array", block: Block) -> int:
    """How many steps a path has."""
    return len(path) // ((STATES + MEMORY) * block.slots) - 1


@inlined
def march_stages(m: Integration, wa: "Array", wr: "Array", state: "Array") -> None:
    """The chassis over one step, added to `state`."""
    for stage in range(m.tableau.shape[1]):
        node = m.tableau[0, stage]
        set_stage(wr, stage, wa, m.h * node, node)
        find_rates(m, wr)
        add_rows(state, FIRST, wr, RATES_INPUTS, CHASSIS, m.h * m.tableau[1, stage])


@inlined
def march_remember(m: Integration, wa: "Array", wm: "Array", state: "Array") -> None:
    """The memory after a step, into `state`."""
    if REMEMBERS:
        set_remember_inputs(wm, wa, state)
        remember_rows(wm, SLOTS, m.p, m.q, m.h)
        copy_rows(state, STATES, wm, REMEMBER_INPUTS, MEMORY)
    else:
        copy_rows(state, STATES, wa, ACTUATORS_INPUTS + MEMORY_END, MEMORY)


@entry_point
def simulate_block(integration: Integration, windows: Block, path: "Array") -> None:
    """Simulate a block of windows.

    Args:
        integration: the car, as a plain tuple (see `arguments`).
        windows: the windows, as a plain tuple.
        path: ((steps + 1) * (STATES + MEMORY) * slots,) states before each step; the first is
            given, the others are written.
    """
    m, block = Integration(*integration), Block(*windows)
    steps = steps_of(path, block)
    stream, t = make_stream(m, block, steps), block.t
    wa = np.zeros((ACTUATORS_INPUTS + ACTUATORS_OUTPUTS) * SLOTS)
    wr = np.zeros((RATES_INPUTS + CHASSIS) * SLOTS)
    wm = np.zeros((REMEMBER_INPUTS + MEMORY) * SLOTS)
    state = np.zeros((STATES + MEMORY) * SLOTS)
    load_state(state, path, block, FIRST)
    for k in range(steps):
        copy_rows(wa, FIRST, state, FIRST, STATES + MEMORY)
        delay_commands(wa, ACTUATORS_COMMAND, stream, k)
        run_actuators(m, wa, wr, t, k)
        march_stages(m, wa, wr, state)
        copy_rows(state, STEER, wa, ACTUATORS_INPUTS + STEER_END, ONE)
        march_remember(m, wa, wm, state)
        store_state(path, block, k + 1, state)


@entry_point
def settle_block(
    integration: Integration, windows: Block, settling: "Indices", state: "Array"
) -> None:
    """Run the actuators alone up to the windows' starts: where the steering is by then.

    Args:
        integration: the car, as a plain tuple (see `arguments`).
        windows: the windows, begun as many steps earlier as the longest takes; a plain tuple.
        settling: (SLOTS,) integration steps of each.
        state: ((STATES + MEMORY) * SLOTS,) first states; steer and memory are written.
    """
    m, block = Integration(*integration), Block(*windows)
    longest = -(-settling.max() // m.substeps) * m.substeps
    stream = make_stream(m, block, longest)
    wa = np.zeros((ACTUATORS_INPUTS + ACTUATORS_OUTPUTS) * SLOTS)
    copy_rows(wa, FIRST, state, FIRST, STATES + MEMORY)
    for k in range(longest):
        delay_commands(wa, ACTUATORS_COMMAND, stream, k)
        for slot in range(SLOTS):
            if longest - k == settling[slot]:
                wa[STEER * SLOTS + slot] = wa[ACTUATORS_COMMAND * SLOTS + slot]
        shift_row(wa, ACTUATORS_TIME * SLOTS, block.t, FIRST, k * m.h)
        actuators_rows(wa, SLOTS, m.p, m.q, m.h)
        for slot in range(SLOTS):
            if longest - k <= settling[slot]:
                wa[STEER * SLOTS + slot] = wa[(ACTUATORS_INPUTS + STEER_END) * SLOTS + slot]
                for i in range(MEMORY):
                    end = (ACTUATORS_INPUTS + MEMORY_END + i) * SLOTS + slot
                    wa[(STATES + i) * SLOTS + slot] = wa[end]
    copy_rows(state, STEER, wa, STEER, ONE + MEMORY)


@inlined
def repeat_stages(m: Integration, wa: "Array", wr: "Array", inputs: "Array") -> None:
    """The stages again; their inputs are kept for the derivatives."""
    stages = m.tableau.shape[1]
    for stage in range(stages):
        node = m.tableau[0, stage]
        set_stage(wr, stage, wa, m.h * node, node)
        copy_rows(inputs, stage * RATES_INPUTS, wr, FIRST, RATES_INPUTS)
        if stage < stages - 1:
            find_rates(m, wr)


@inlined
def adjoint_remember(m: Integration, work: AdjointWork, bar: "Array") -> None:
    """Through the memory's update; its inputs are in place."""
    if not REMEMBERS:
        copy_rows(work.actuated, MEMORY_END, bar, STATES, MEMORY)
        return
    wm = work.remember
    set_remember_inputs(wm, work.actuators, work.after)
    slopes = REMEMBER_INPUTS + MEMORY
    copy_rows(wm, REMEMBER_INPUTS, bar, STATES, MEMORY)
    remember_vjp(wm, SLOTS, m.p, m.q, m.h)
    add_rows(work.actuated, WHEEL_START, wm, slopes + STEER, ONE, 1.0)
    add_rows(work.actuated, WHEEL_END, wm, slopes + REMEMBER_AFTER + STEER, ONE, 1.0)
    copy_rows(work.actuated, MEMORY_END, wm, slopes + REMEMBER_MEMORY, MEMORY)
    add_rows(bar, FIRST, wm, slopes + REMEMBER_AFTER, CHASSIS, 1.0)
    add_rows(work.start, FIRST, wm, slopes, CHASSIS, 1.0)


@inlined
def weigh_slopes(w: "Array", bar: "Array", share: float, carried: float) -> None:
    """Weights of a stage's slopes: its share of the step's end, and of the next stage's start."""
    weights, slopes = RATES_INPUTS * SLOTS, (RATES_INPUTS + CHASSIS) * SLOTS
    for a in range(0, CHASSIS * SLOTS, SLOTS):
        mix_row(w, weights + a, bar, a, w, slopes + a, share, carried)


@inlined
def adjoint_stages(m: Integration, work: AdjointWork, bar: "Array") -> None:
    """Through the stages in reverse."""
    w, stages = work.rates, m.tableau.shape[1]
    slopes, carried = RATES_INPUTS + CHASSIS, 0.0
    for stage in range(stages - 1, -1, -1):
        node = m.tableau[0, stage]
        weigh_slopes(w, bar, m.h * m.tableau[1, stage], carried)
        copy_rows(w, FIRST, work.stages, stage * RATES_INPUTS, RATES_INPUTS)
        if row_above(w, SPEED * SLOTS, SPECIALISED_SPEED):
            specialised_vjp(w, SLOTS, m.p, m.q, m.h)
        else:
            rates_vjp(w, SLOTS, m.p, m.q, m.h)
        add_rows(work.start, FIRST, w, slopes, CHASSIS, 1.0)
        add_rows(work.actuated, WHEEL_START, w, slopes + RATES_WHEEL, ONE, 1.0 - node)
        add_rows(work.actuated, WHEEL_END, w, slopes + RATES_WHEEL, ONE, node)
        add_rows(work.actuated, ACCEL, w, slopes + RATES_ACCEL, ONE + MEMORY, 1.0)
        carried = m.h * node


@inlined
def set_bars(bar: "Array", loss: StateGradient, block: Block, k: int) -> None:
    """Derivatives by the states of moment `k` as rows; slots without a window get none."""
    strides, slot = loss.strides, block.slot
    if strides[0] == 1 and slot + SLOTS <= loss.windows:
        for row in range(STATES + MEMORY):
            copy_row(bar, row * SLOTS, loss.values, slot + k * strides[1] + row * strides[2])
        return
    for i in range(SLOTS):
        at = (slot + i) * strides[0] + k * strides[1]
        for row in range(STATES + MEMORY):
            used = slot + i < loss.windows
            bar[row * SLOTS + i] = loss.values[unsigned(at + row * strides[2])] if used else 0.0


@inlined
def prefetch_moment(path: "Array", loss: StateGradient, block: Block, k: int) -> None:
    """Prefetch what a moment needs; hardware does not foresee reading backwards."""
    if k < 0:
        return
    strides, slot = loss.strides, block.slot
    for row in range(STATES + MEMORY):
        prefetch(path, ((STATES + MEMORY) * k + row) * block.slots + slot)
    if strides[0] == 1:
        for row in range(STATES + MEMORY):
            prefetch(loss.values, slot + k * strides[1] + row * strides[2])
    else:
        for i in range(min(loss.windows - slot, SLOTS)):
            prefetch(loss.values, (slot + i) * strides[0] + k * strides[1])


@not_inlined
def sum_slopes(w: "Array", row: int, slopes: "Array") -> None:
    """Add a workspace's derivatives by the parameters, over its slots."""
    for parameter in range(PARAMETER_COUNT):
        for slot in range(SLOTS):
            slopes[parameter] += w[(row + parameter) * SLOTS + slot]


@not_inlined
def sum_all_slopes(work: AdjointWork, slopes: "Array") -> None:
    """Add those of actuators, memory and rates."""
    actuators = 2 * ACTUATORS_INPUTS + ACTUATORS_OUTPUTS
    sum_slopes(work.actuators_vjp, actuators, slopes)
    sum_slopes(work.remember, 2 * REMEMBER_INPUTS + MEMORY, slopes)
    sum_slopes(work.rates, 2 * RATES_INPUTS + CHASSIS, slopes)


@allocating
def make_adjoint_work(stages: int) -> AdjointWork:
    """The workspaces of a block's adjoint."""
    actuators = ACTUATORS_INPUTS + ACTUATORS_OUTPUTS
    return AdjointWork(
        np.zeros(actuators * SLOTS),
        np.zeros((ACTUATORS_INPUTS + actuators + PARAMETER_COUNT) * SLOTS),
        np.zeros((2 * RATES_INPUTS + CHASSIS + PARAMETER_COUNT) * SLOTS),
        np.zeros((2 * REMEMBER_INPUTS + MEMORY + PARAMETER_COUNT) * SLOTS),
        np.zeros(stages * RATES_INPUTS * SLOTS),
        np.zeros(CHASSIS * SLOTS),
        np.zeros(CHASSIS * SLOTS),
        np.zeros(ACTUATORS_OUTPUTS * SLOTS),
    )


@inlined
def adjoint_actuators(m: Integration, work: AdjointWork) -> None:
    """Through the actuators; the derivatives by their outputs are known."""
    copy_rows(work.actuators_vjp, FIRST, work.actuators, FIRST, ACTUATORS_INPUTS)
    copy_rows(work.actuators_vjp, ACTUATORS_INPUTS, work.actuated, FIRST, ACTUATORS_OUTPUTS)
    actuators_vjp(work.actuators_vjp, SLOTS, m.p, m.q, m.h)


@inlined
def start_adjoint_step(work: AdjointWork, bar: "Array") -> None:
    """Derivatives by the actuators' outputs and the step's start, before they are summed."""
    clear(work.actuated)
    copy_rows(work.actuated, STEER_END, bar, STEER, ONE)
    clear(work.start)


@entry_point
def adjoint_block(
    integration: Integration,
    windows: Block,
    path: "Array",
    state_gradient: StateGradient,
    written: Gradients,
) -> None:
    """The adjoint of `simulate_block`.

    Args:
        integration: the car, as a plain tuple (see `arguments`).
        windows: the windows, as a plain tuple.
        path: what `simulate_block` wrote.
        state_gradient: derivatives of the loss by every state, as a plain tuple.
        written: where the results go, as a plain tuple.
    """
    m, block = Integration(*integration), Block(*windows)
    loss, gradients = StateGradient(*state_gradient), Gradients(*written)
    steps, bar, t = steps_of(path, block), gradients.first, block.t
    stream, into = make_stream(m, block, steps), gradients.commands
    returned = np.zeros(len(stream.rows) if len(into) else 0)
    work, delay_bars = make_adjoint_work(m.tableau.shape[1]), gradients.delays
    # fields taken out here: within the loop each would cost two atomic reference counts
    wa, wr, wva = work.actuators, work.rates, work.actuators_vjp
    stages, after, start = work.stages, work.after, work.start
    back = ACTUATORS_INPUTS + ACTUATORS_OUTPUTS
    set_bars(bar, loss, block, steps)
    load_state(wa, path, block, steps)
    for k in range(steps - 1, -1, -1):
        prefetch_moment(path, loss, block, k - PREFETCH_AHEAD)
        if REMEMBERS:
            copy_rows(after, FIRST, wa, FIRST, CHASSIS)
        load_state(wa, path, block, k)
        delay_commands(wa, ACTUATORS_COMMAND, stream, k)
        run_actuators(m, wa, wr, t, k)
        repeat_stages(m, wa, wr, stages)
        start_adjoint_step(work, bar)
        adjoint_remember(m, work, bar)
        add_rows(start, FIRST, bar, FIRST, CHASSIS, 1.0)
        adjoint_stages(m, work, bar)
        adjoint_actuators(m, work)
        set_bars(bar, loss, block, k)
        add_rows(bar, FIRST, start, FIRST, CHASSIS, 1.0)
        add_rows(bar, FIRST, wva, back, STATES + MEMORY, 1.0)
        add_delay_gradient(wva, back + ACTUATORS_COMMAND, stream, k, delay_bars)
        if len(into):
            add_command_gradient(wva, back + ACTUATORS_COMMAND, returned, stream, k)
    sum_all_slopes(work, gradients.parameters)
    if len(into):
        add_stream_gradient(returned, block, into, stream.ahead)
