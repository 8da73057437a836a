"""Which of some courses of the commands explains a drive's poses best.

When a servo or a motor controller takes a command over is in no log. The same windows are judged
under each course, by the same likelihood as the car, all free parameters adapted to each.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from steerd.sysid.data.dataset import Run
from steerd.sysid.data.segments import moving_segments
from steerd.sysid.inference.engine import Engine
from steerd.sysid.inference.likelihood import Likelihood
from steerd.sysid.inference.plain_car import Asked, Rough, open_plain
from steerd.sysid.inference.search import minimise, newton, open_point
from steerd.sysid.inference.space import Space, make_space

Array = NDArray[np.float64]

SECONDS = 20.0
"""This much of a drive is enough to judge its commands' course [s]."""
WINDOW = 2.0
"""Length of the windows [s]."""
STEPS = 6
"""Of a search under each course: they differ by little."""


def losses(run: Run, courses: Sequence[Run], rough: Rough, asked: Asked) -> Array:
    """Negative log-likelihood of a drive under commands of its own [nats], but for a constant.

    Args:
        run: a whole drive, not a part of it.
        courses: the drive with its commands as they may have been taken over.
        rough: a car near the truth.
        asked: what is free.

    Returns:
        (courses,); infinite where the simulation diverges.

    Raises:
        DataError: the drive does not move.
    """
    parts = moving_segments([run])
    likelihood, _ = open_plain(parts, asked, rough, WINDOW, SECONDS)
    engine = likelihood.engine
    space = make_space(engine.superset, asked.free)
    z, x = space.chart.coordinates(rough.parameters), engine.readings.layout.guess
    each = [replace(likelihood, engine=_commanded(engine, parts, course)) for course in courses]
    return np.array([_least_cost(their, space, z, x.copy()) for their in each])


def _commanded(engine: Engine, parts: Sequence[Run], run: Run) -> Engine:
    """The windows of some parts with the commands of another course of the whole drive."""
    first = [round((part.start - run.start) / run.h) for part in parts]
    cuts = [run.commands[a : a + len(part.commands)] for a, part in zip(first, parts, strict=True)]
    layout = replace(engine.readings.layout, commands=np.concatenate(cuts))
    return replace(engine, readings=replace(engine.readings, layout=layout))


def _least_cost(likelihood: Likelihood, space: Space, z: Array, x: Array) -> float:
    """Cost at the minimum, under the discrepancy that is needed there."""
    try:
        found = minimise(likelihood, open_point(likelihood, space, z, x), steps=STEPS)
    except (FloatingPointError, np.linalg.LinAlgError):
        return np.inf
    return found.cost - newton(space, found.at, found.z)[1]
