"""Blocks of windows with forward sensitivities: workspaces, the settling before, the steps.

Appended, after `forward_sensitivities`, to the pieces printed for a model. `march_windows` is what
Python calls, once for each block.
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
    WindowBlock,
)
from steerd.sysid.compiler.compile import allocating, entry_point, inlined, not_inlined

if TYPE_CHECKING:
    from steerd.sysid.compiler.delayed import unsigned
    from steerd.sysid.compiler.forward_sensitivities import (
        actuate,
        copy_sensitivities,
        delay_values,
        flush_denormals,
        march_chassis,
        march_rest,
        push_actuators,
        push_chassis,
        push_commands,
        push_rest,
        read_station,
    )
    from steerd.sysid.compiler.loops import copy_rows
    from steerd.sysid.compiler.pieces import (
        ACTUATORS_COMMAND,
        ACTUATORS_INPUTS,
        ACTUATORS_OUTPUTS,
        ACTUATORS_SLOPES,
        CHASSIS,
        FIRST,
        MEMORY,
        MEMORY_END,
        OBSERVE_SLOPES,
        ONE,
        RATES_INPUTS,
        RATES_SLOPES,
        READINGS,
        REMEMBER_INPUTS,
        REMEMBER_SLOPES,
        SENSITIVITIES,
        SLOTS,
        STATES,
        STEER,
        STEER_END,
        Array,
    )

FLUSH_EVERY = 64
"""Steps between two removals of denormal numbers."""


@allocating
def make_piece_work(inputs: int, outputs: int, slopes: int, width: int) -> PieceWork:
    """Workspace of a piece whose rows of values are so wide."""
    v = np.zeros((inputs + outputs + slopes) * width)
    return PieceWork(v, np.zeros((inputs + outputs) * SENSITIVITIES))


@allocating
def make_tangent_work(stages: int) -> TangentWork:
    """Workspaces of all pieces."""
    none, wide = np.int64(0), np.int64(SLOTS)
    return TangentWork(
        make_piece_work(ACTUATORS_INPUTS, ACTUATORS_OUTPUTS, ACTUATORS_SLOPES, wide),
        make_piece_work(RATES_INPUTS, CHASSIS, RATES_SLOPES, wide),
        make_piece_work(REMEMBER_INPUTS, none + MEMORY, REMEMBER_SLOPES, wide),
        make_piece_work(STATES, READINGS, OBSERVE_SLOPES, ONE),
        np.zeros(stages * RATES_SLOPES * SLOTS),
        np.zeros(stages),
        np.zeros(2 * SLOTS),
    )


@allocating
def make_tangent(block: WindowBlock) -> Tangent:
    """The first states, which depend on nothing."""
    numbers = STATES + MEMORY
    rows = np.zeros(numbers * SENSITIVITIES * SLOTS)
    return Tangent(
        block.first.copy(), np.zeros(numbers * SLOTS), rows, np.zeros(numbers * SENSITIVITIES)
    )


@not_inlined
def seed_state(dx: "Array", base: int, dfirst: "Array", first: int, last: int, n: int) -> None:
    """Add the first state's directions, some of its rows."""
    for row in range(first, last):
        for i in range(n):
            dx[unsigned((base + row) * SENSITIVITIES + i)] += dfirst[row, i]


@allocating
def share_sensitivities(directions: Directions) -> "Array":
    """Of a reading's place within its step, by `late`: none, or those of the poses' dead time."""
    shares = np.zeros(2 * SENSITIVITIES)
    for i in range(directions.n):
        shares[SENSITIVITIES + i] = -directions.delays[2 * SENSITIVITIES + i]
    return shares


@inlined
def begin_settling(
    directions: Directions, x: Tangent, work: TangentWork, slot: int, base: int
) -> None:
    """The steer is where the first of the known commands has it."""
    x.now[STEER * SLOTS + slot] = work.actuators.v[ACTUATORS_COMMAND * SLOTS + slot]
    push_commands(directions, work, slot)
    copy_sensitivities(x.dx, base + STEER, work.actuators.w, ACTUATORS_COMMAND, ONE, directions.n)


@inlined
def keep_settled(
    directions: Directions, x: Tangent, work: TangentWork, slot: int, base: int
) -> None:
    """Steer and memory after a step of the actuators alone."""
    a, n = work.actuators, directions.n
    push_actuators(directions, x, work, slot, base)
    x.now[STEER * SLOTS + slot] = a.v[(ACTUATORS_INPUTS + STEER_END) * SLOTS + slot]
    copy_sensitivities(x.dx, base + STEER, a.w, ACTUATORS_INPUTS + STEER_END, ONE, n)
    for i in range(MEMORY):
        at = (ACTUATORS_INPUTS + MEMORY_END + i) * SLOTS + slot
        x.now[(STATES + i) * SLOTS + slot] = a.v[at]
    copy_sensitivities(x.dx, base + STATES, a.w, ACTUATORS_INPUTS + MEMORY_END, MEMORY, n)


@inlined
def settle(
    m: Integration, directions: Directions, block: WindowBlock, x: Tangent, work: TangentWork
) -> None:
    """Actuators alone over the known commands before each window: its steer and memory."""
    longest = 0
    for slot in range(block.own):
        longest = max(longest, block.spans[slot, 4])
    for k in range(-longest, 0):
        delay_values(m, directions, block, work, k)
        for slot in range(block.own):
            if k == -block.spans[slot, 4]:
                begin_settling(directions, x, work, slot, slot * (STATES + MEMORY))
        actuate(m, x, work, block, k)
        for slot in range(block.own):
            if k >= -block.spans[slot, 4]:
                keep_settled(directions, x, work, slot, slot * (STATES + MEMORY))
    for slot in range(block.own):
        if block.spans[slot, 4] > 0:
            x.now[STEER * SLOTS + slot] += block.first[unsigned(STEER * SLOTS + slot)]


@entry_point
def march_windows(
    integration: Integration, seeds: Directions, place: WindowBlock, stations_of: Readings
) -> None:
    """Readings of a block's windows at their stations, and their derivatives.

    Args:
        integration: the car, as a plain tuple (see `arguments`), like the others.
        seeds: what derivatives are taken by.
        place: where the windows lie.
        stations_of: where they are read; its `y` and `jy` are written.
    """
    m, directions = Integration(*integration), Directions(*seeds)
    block, readings = WindowBlock(*place), Readings(*stations_of)
    n, stations, numbers = directions.n, readings.stations, STATES + MEMORY
    work, shares = make_tangent_work(m.tableau.shape[1]), share_sensitivities(directions)
    x, station = make_tangent(block), readings.ranges[:, 0].copy()
    for slot in range(block.own):
        seed_state(x.dx, slot * numbers, directions.first, FIRST, STEER, n)
    settle(m, directions, block, x, work)
    for slot in range(block.own):
        seed_state(x.dx, slot * numbers, directions.first, STEER, STEER + ONE, n)
    for k in range(block.spans[:, 3].max()):
        delay_values(m, directions, block, work, k)
        actuate(m, x, work, block, k)
        march_chassis(m, x, work)
        march_rest(m, x, work)
        for slot in range(block.own):
            steps, base = block.spans[slot, 3], slot * numbers
            if k >= steps:
                continue
            push_actuators(directions, x, work, slot, base)
            push_chassis(m, directions, x, work, slot, base)
            push_rest(directions, x, work, slot, base)
            at, end = station[slot], readings.ranges[slot, 1]
            while at < end and (stations[at, 0] <= k or k == steps - 1):
                read_station(
                    m, directions, readings, at, k, shares, x, work, block.first, slot, base
                )
                at += 1
            station[slot] = at
            copy_sensitivities(x.dx, base, x.dx_after, FIRST, numbers, n)
            if k % FLUSH_EVERY == 0:
                flush_denormals(x.dx, base, n)
        copy_rows(x.now, FIRST, x.after, FIRST, numbers)
