"""Readings without derivatives: sixteen windows side by side, many times faster than with them.

The same car, commands and reading places as `engine.linear`; what a hypothesis' trial values cost
is computed from these, derivatives are taken only where the search stands.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from steerd.car_model.model import Model, observe
from steerd.car_model.native.windows import (
    STATES,
    HeldCommands,
    Kernels,
    compute_readings,
    delays_of,
    make_window_blocks,
    march,
    model_of,
    settle,
    view_by_window,
)
from steerd.car_model.numpy_ops import NUMPY
from steerd.car_model.state import State
from steerd.sysid.inference.readings import Readings

Array = NDArray[np.float64]

INTEGRATOR = "midpoint"
"""Half the work of `rk4`; on a grid of 5 ms a position differs by 0.01 mm after a second."""


def active_model(kernels: Kernels, parameters: Array) -> Model[float]:
    """The car with only those effects that do something."""
    full = model_of(kernels, parameters)
    kept = [
        (effect, values)
        for effect, values in zip(full.effects, full.values, strict=True)
        if values != effect.nulls
    ]
    return Model(full.car, tuple(e for e, _ in kept), tuple(v for _, v in kept), full.chassis)


def first_states(
    kernels: Kernels, readings: Readings, parameters: Array, x: Array, substeps: int
) -> Array:
    """States (W, 7 + memory) at the windows' starts, the steering settled over known commands."""
    layout = readings.layout
    first = np.zeros((len(x), STATES + kernels.memory))
    first[:, :STATES] = x
    held = HeldCommands(layout.commands, layout.h, substeps, INTEGRATOR)
    return settle(kernels, parameters, first, held, layout.kernel_windows(substeps))


def paths(
    kernels: Kernels, readings: Readings, parameters: Array, x: Array, substeps: int
) -> Array:
    """States (W, moments, 7 + memory) of all windows at every integration step."""
    layout = readings.layout
    first = first_states(kernels, readings, parameters, x, substeps)
    blocks = make_window_blocks(layout.spans[:, :3], layout.t)
    held = HeldCommands(layout.commands, layout.h, substeps, INTEGRATOR)
    steps = int(layout.spans[:, 3].max()) * substeps
    return np.ascontiguousarray(
        view_by_window(march(kernels, parameters, first, held, blocks, steps), len(x))
    )


def readings_of(
    kernels: Kernels, readings: Readings, parameters: Array, path: Array, fine: float
) -> Array:
    """(R,) what the instruments read along paths (W, moments, states)."""
    seen, steps = readings.layout.seen, readings.layout.spans[:, 3]
    late = float(delays_of(kernels, parameters)[2])
    at = (seen.t - np.where(seen.kind == 0, late, 0.0)) / fine
    last = steps[seen.window] * round(readings.layout.h / fine) - 1
    k = np.clip(np.floor(at).astype(np.int64), 0, last)
    share = (at - k)[:, None]
    a, b = path[seen.window, k, :7], path[seen.window, k + 1, :7]
    with np.errstate(
        invalid="ignore"
    ):  # a car that spun away reads nothing; such a step is refused
        state: State[Any] = State(*(a + share * (b - a)).T)
        shown = observe(NUMPY, active_model(kernels, parameters), state)
    out = np.empty(len(readings.layout.values))
    pose = seen.kind == 0
    for channel in range(3):
        out[seen.row[pose] + channel] = np.broadcast_to(shown[channel], at.shape)[pose]
    for kind, channel in ((1, 3), (2, 4)):
        chosen = seen.kind == kind
        out[seen.row[chosen]] = np.broadcast_to(shown[channel], at.shape)[chosen]
    return out


def predicted(
    kernels: Kernels, readings: Readings, parameters: Array, x: Array, substeps: int
) -> Array:
    """(R,) readings of all windows from starts `x` (W, 7)."""
    layout = readings.layout
    held = HeldCommands(layout.commands, layout.h, substeps, INTEGRATOR)
    late = float(delays_of(kernels, parameters)[2])
    none = np.zeros((len(parameters), 0))
    y, _ = compute_readings(
        kernels, parameters, none, x, np.zeros((STATES, 0)), held,
        layout.kernel_windows(substeps), layout.stations(late, held.fine),
    )  # fmt: skip
    return y
