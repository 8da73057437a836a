"""Forward sensitivities: the values of a block of windows at once, then each window's derivatives.

Appended, after `loops` and before `march_windows`, to the pieces printed for a model. A step's
values and the derivatives of its pieces are computed for all slots side by side. Then, window by
window, each number of the state has a row of sensitivities, pushed through those derivatives
(Jacobian-vector products). The directions are whatever the caller seeds: free parameters and the
first state. Windows may be of different lengths, settle for different times, and be sampled
anywhere between their steps.

Row numbers are np.int64 (`layout`): for a plain Python number, Numba would compile a copy of the
function for this number alone.
"""

# Why: docs/decisions/kernels.md#d101

# ruff: noqa: TC004  (the printed pieces stand above this text in the compiled module)
from typing import TYPE_CHECKING

import numpy as np

from steerd.sysid.compiler.arguments import (
    Directions,
    Integration,
    Readings,
    Scatter,
    Tangent,
    TangentWork,
    WindowBlock,
)
from steerd.sysid.compiler.compile import inlined, not_inlined
from steerd.sysid.compiler.simd_rows import (
    add_row,
    copy_row,
    mix_row,
    row_above,
    scale_row,
    shift_row,
)

if TYPE_CHECKING:
    from steerd.sysid.compiler.delayed import unsigned
    from steerd.sysid.compiler.loops import add_rows, copy_rows, set_remember_inputs, set_stage
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
        RATES_ACCEL,
        RATES_INPUTS,
        RATES_SLOPES,
        RATES_TIME,
        RATES_WHEEL,
        READINGS,
        REMEMBER_AFTER,
        REMEMBER_INPUTS,
        REMEMBER_MEMORY,
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


# -- values, all slots of a block ------------------------------------------------------------------


@inlined
def delay_values(
    m: Integration, directions: Directions, block: WindowBlock, work: TangentWork, k: int
) -> None:
    """Both delayed commands of step `k`; see `delayed.delay_commands`."""
    v, spans = work.actuators.v, block.spans
    for channel in range(2):
        delay = directions.delay_steps[channel]
        whole = int(np.floor(delay))
        newer, older = (k - whole) // m.substeps, (k - whole - 1) // m.substeps
        for slot in range(SLOTS):
            low, high, start = spans[slot, 0], spans[slot, 1], spans[slot, 2]
            new = block.commands[unsigned(min(max(start + newer, low), high - 1)), channel]
            old = block.commands[unsigned(min(max(start + older, low), high - 1)), channel]
            v[(ACTUATORS_COMMAND + channel) * SLOTS + slot] = new + (delay - whole) * (old - new)
            work.gaps[channel * SLOTS + slot] = old - new


@inlined
def actuate(m: Integration, x: Tangent, work: TangentWork, block: WindowBlock, k: int) -> None:
    """Actuators over step `k`; the commands are in place."""
    v = work.actuators.v
    copy_rows(v, FIRST, x.now, FIRST, STATES + MEMORY)
    shift_row(v, ACTUATORS_TIME * SLOTS, block.t, FIRST, k * m.h)
    actuators_jac(v, SLOTS, m.p, m.q, m.h)


@inlined
def march_chassis(m: Integration, x: Tangent, work: TangentWork) -> None:
    """Chassis over a step, into `after`; the actuators have run."""
    a, r = work.actuators.v, work.rates.v
    copy_rows(r, RATES_ACCEL, a, ACTUATORS_INPUTS + ACCEL, ONE + MEMORY)
    copy_rows(r, RATES_TIME, a, ACTUATORS_TIME, ONE)
    copy_rows(x.after, FIRST, x.now, FIRST, CHASSIS)
    for stage in range(m.tableau.shape[1]):
        node = m.tableau[0, stage]
        set_stage(r, stage, a, m.h * node, node)
        if row_above(r, SPEED * SLOTS, SPECIALISED_SPEED):
            work.fast[stage] = 1.0
            specialised_jac(r, SLOTS, m.p, m.q, m.h)
        else:
            work.fast[stage] = 0.0
            rates_jac(r, SLOTS, m.p, m.q, m.h)
        copy_rows(work.stages, stage * RATES_SLOPES, r, RATES_INPUTS + CHASSIS, RATES_SLOPES)
        add_rows(x.after, FIRST, r, RATES_INPUTS, CHASSIS, m.h * m.tableau[1, stage])


@inlined
def march_rest(m: Integration, x: Tangent, work: TangentWork) -> None:
    """Steer and memory after a step; the chassis is in `after`."""
    a, r = work.actuators.v, work.remember.v
    copy_rows(x.after, STEER, a, ACTUATORS_INPUTS + STEER_END, ONE)
    if REMEMBERS:
        set_remember_inputs(r, a, x.after)
        remember_jac(r, SLOTS, m.p, m.q, m.h)
        copy_rows(x.after, STATES, r, REMEMBER_INPUTS, MEMORY)
    else:
        copy_rows(x.after, STATES, a, ACTUATORS_INPUTS + MEMORY_END, MEMORY)


# -- sensitivities, one window ---------------------------------------------------------------------


@inlined
def copy_sensitivities(
    to: "Array", first: int, source: "Array", start: int, rows: int, n: int
) -> None:
    """Copy rows of `n` sensitivities."""
    for row in range(rows):
        a, b = (first + row) * SENSITIVITIES, (start + row) * SENSITIVITIES
        for i in range(0, n, SLOTS):
            copy_row(to, a + i, source, b + i)


@inlined
def push_parameters(j: "Array", at: int, w: "Array", by: Scatter) -> None:
    """Add what the parameters' own directions do to the outputs."""
    for e in range(len(by.slope)):
        w[unsigned(by.to[e])] += j[unsigned(at + by.slope[e])] * by.scale[e]


@inlined
def push_commands(directions: Directions, work: TangentWork, slot: int) -> None:
    """Rows of both delayed commands."""
    n, w = directions.n, work.actuators.w
    for channel in range(2):
        gap = work.gaps[channel * SLOTS + slot]
        a, b = (ACTUATORS_COMMAND + channel) * SENSITIVITIES, channel * SENSITIVITIES
        for i in range(0, n, SLOTS):
            scale_row(w, a + i, directions.delays, b + i, gap)


@inlined
def push_actuators(
    directions: Directions, x: Tangent, work: TangentWork, slot: int, base: int
) -> None:
    """Sensitivities of the actuators' outputs."""
    n, v, w = directions.n, work.actuators.v, work.actuators.w
    copy_sensitivities(w, FIRST, x.dx, base, STATES + MEMORY, n)
    push_commands(directions, work, slot)
    at = (ACTUATORS_INPUTS + ACTUATORS_OUTPUTS) * SLOTS + slot
    actuators_jvp(v, at, w, n)
    push_parameters(v, at, w, Scatter(*directions.actuators))


@inlined
def stage_sensitivities(w: "Array", dx: "Array", base: int, step: float, n: int) -> None:
    """Rates' chassis inputs at a stage: the start's, moved along the last slope's."""
    for row in range(CHASSIS):
        a, b = row * SENSITIVITIES, (RATES_INPUTS + row) * SENSITIVITIES
        c = (base + row) * SENSITIVITIES
        for i in range(0, n, SLOTS):
            mix_row(w, a + i, dx, c + i, w, b + i, 1.0, step)


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
def push_chassis(
    m: Integration, directions: Directions, x: Tangent, work: TangentWork, slot: int, base: int
) -> None:
    """Sensitivities of the chassis after the step; those of the actuators are in place."""
    n, a, w = directions.n, work.actuators.w, work.rates.w
    copy_sensitivities(x.dx_after, FIRST, x.dx, base, CHASSIS, n)
    copy_sensitivities(w, RATES_ACCEL, a, ACTUATORS_INPUTS + ACCEL, ONE + MEMORY, n)
    for stage in range(m.tableau.shape[1]):
        node, at = m.tableau[0, stage], stage * RATES_SLOPES * SLOTS + slot
        if stage == 0:
            copy_sensitivities(w, FIRST, x.dx, base, CHASSIS, n)
        else:
            stage_sensitivities(w, x.dx, base, m.h * node, n)
        wheel_sensitivities(w, a, node, n)
        if work.fast[stage] > 0.0:
            specialised_jvp(work.stages, at, w, n)
            push_parameters(work.stages, at, w, Scatter(*directions.specialised))
        else:
            rates_jvp(work.stages, at, w, n)
            push_parameters(work.stages, at, w, Scatter(*directions.rates))
        add_slope_sensitivities(w, x.dx_after, m.h * m.tableau[1, stage], n)


@inlined
def push_rest(directions: Directions, x: Tangent, work: TangentWork, slot: int, base: int) -> None:
    """Sensitivities of steer and memory after the step; those of the chassis are in place."""
    n, a, v, w = directions.n, work.actuators.w, work.remember.v, work.remember.w
    outputs = ACTUATORS_INPUTS
    copy_sensitivities(x.dx_after, STEER, a, outputs + STEER_END, ONE, n)
    if not REMEMBERS:
        copy_sensitivities(x.dx_after, STATES, a, outputs + MEMORY_END, MEMORY, n)
        return
    copy_sensitivities(w, FIRST, x.dx, base, CHASSIS, n)
    copy_sensitivities(w, STEER, a, outputs + WHEEL_START, ONE, n)
    copy_sensitivities(w, REMEMBER_AFTER, x.dx_after, FIRST, CHASSIS, n)
    copy_sensitivities(w, REMEMBER_AFTER + STEER, a, outputs + WHEEL_END, ONE, n)
    copy_sensitivities(w, REMEMBER_MEMORY, a, outputs + MEMORY_END, MEMORY, n)
    at = (REMEMBER_INPUTS + MEMORY) * SLOTS + slot
    remember_jvp(v, at, w, n)
    push_parameters(v, at, w, Scatter(*directions.remember))
    copy_sensitivities(x.dx_after, STATES, w, REMEMBER_INPUTS, MEMORY, n)


@not_inlined
def flush_denormals(dx: "Array", base: int, n: int) -> None:
    """Decayed sensitivities become zero: denormal numbers would slow a long window threefold."""
    for row in range(base + YAW_RATE, base + STATES + MEMORY):
        a = row * SENSITIVITIES
        for i in range(0, n, SLOTS):
            shift_row(dx, a + i, dx, a + i, DENORMAL_GUARD)
            shift_row(dx, a + i, dx, a + i, -DENORMAL_GUARD)


# -- readings --------------------------------------------------------------------------------------


@inlined
def sample(
    m: Integration, directions: Directions, share: float, shares: "Array", start: int, x: Tangent,
    work: TangentWork, slot: int, base: int,
) -> None:  # fmt: skip
    """What the instruments read `share` of a step after `now`, and its sensitivities.

    The state runs straight from `now` (share 0) to `after` (1); the share itself has the
    sensitivities that begin at `shares[start]`.
    """
    n, v, w = directions.n, work.observe.v, work.observe.w
    for row in range(STATES):
        a, b, at = row * SENSITIVITIES, (base + row) * SENSITIVITIES, row * SLOTS + slot
        move = x.after[unsigned(at)] - x.now[unsigned(at)]
        v[row] = x.now[unsigned(at)] + share * move
        for i in range(0, n, SLOTS):
            mix_row(w, a + i, x.dx, b + i, x.dx_after, a + i, 1.0 - share, share)
            add_row(w, a + i, shares, start + i, move)
    observe_jac(v, m.p, m.q, m.h)
    observe_jvp(v, STATES + READINGS, w, n)
    push_parameters(v, STATES + READINGS, w, Scatter(*directions.observe))


@inlined
def start_pose_derivatives(
    readings: Readings, row: int, seen: "Array", first: "Array", slot: int
) -> None:
    """Derivatives of a pose by position and heading of its window's start."""
    to, width, jy = row * readings.width + readings.start_pose, readings.width, readings.jy
    scale_x = readings.scale[unsigned(row)]
    scale_y = readings.scale[unsigned(row + 1)]
    jy[unsigned(to)] = scale_x
    jy[unsigned(to + 2)] = (first[unsigned(SLOTS + slot)] - seen[STATES + ONE]) * scale_x
    jy[unsigned(to + width + 1)] = scale_y
    jy[unsigned(to + width + 2)] = (seen[STATES] - first[unsigned(slot)]) * scale_y
    jy[unsigned(to + 2 * width + 2)] = readings.scale[unsigned(row + 2)]


@inlined
def read_station(
    m: Integration, directions: Directions, readings: Readings, number: int, k: int,
    shares: "Array", x: Tangent, work: TangentWork, first_state: "Array", slot: int, base: int,
) -> None:  # fmt: skip
    """One station's readings and their sensitivities into their rows."""
    stations, scale, jy, o = readings.stations, readings.scale, readings.jy, work.observe
    share, late = readings.shares[number] + (stations[number, 0] - k), stations[number, 3]
    sample(m, directions, share, shares, late * SENSITIVITIES, x, work, slot, base)
    channel, row, first = stations[number, 1], stations[number, 2], readings.start_pose
    count = 3 if late == 1 else 1
    for c in range(count):
        readings.y[unsigned(row + c)] = o.v[unsigned(STATES + channel + c)]
        b, unit = (STATES + channel + c) * SENSITIVITIES, scale[unsigned(row + c)]
        to = (row + c) * readings.width
        for i in range(0, directions.n, SLOTS):
            scale_row(jy, to + i, o.w, b + i, unit)
        for i in range(first, first + 3 if first else 0):
            jy[unsigned(to + i)] = 0.0
    if first and late == 1:
        start_pose_derivatives(readings, row, o.v, first_state, slot)
