"""What the compiled functions take: typed bundles of arrays that Numba passes by field.

Every array is float64 and C-contiguous unless a bundle says otherwise. The same classes serve
Python, which makes them in `kernels`, and the compiled text, which reads their fields. On the way
in they are plain tuples (`tuple(bundle)`): Numba needs 1.5 us to recognise a named one, each time.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


class Integration(NamedTuple):
    """The car's numbers and how it is integrated; the same for all windows.

    Attributes:
        p: (P,) parameters.
        q: what depends on parameters and step alone, see `kernels.constants_of`.
        h: integration step [s].
        tableau: (2, stages) node and weight of each stage.
        substeps: integration steps that share one command.
    """

    p: Array
    q: Array
    h: float
    tableau: Array
    substeps: int


class Block(NamedTuple):
    """Windows that fill the slots of one block.

    Attributes:
        commands: (rows, 2) steer [rad] and speed [m/s] of all runs, one after the other.
        runs: (SLOTS, 3) first row, row after the last, and row of the first step.
        t: (SLOTS,) time into the run at the first step [s].
        slot: the block's first slot.
        slots: slots of all blocks: how long a row of a path is.
    """

    commands: Array
    runs: Indices
    t: Array
    slot: int
    slots: int


class StateGradient(NamedTuple):
    """Derivatives of a loss by every state of a path: what an adjoint starts from.

    Attributes:
        values: flat.
        strides: (3,) by window, moment and state, in numbers.
        windows: how many slots hold a window; the rest are padding.
    """

    values: Array
    strides: Indices
    windows: int


class Gradients(NamedTuple):
    """What an adjoint writes for its block.

    Attributes:
        first: ((STATES + MEMORY) * SLOTS,) derivatives by the first states.
        parameters: (P,) by the parameters, other than through the dead times; added to.
        delays: (2 * SLOTS,) by the dead times of steer and drive [1/step]; added to.
        commands: (rows, 2) by the commands, added to; without rows, none are computed.
    """

    first: Array
    parameters: Array
    delays: Array
    commands: Array


class CommandStream(NamedTuple):
    """The commands of a block as rows, all of steer, then all of speed.

    Attributes:
        rows: (2 * length * SLOTS,) the oldest command first.
        ahead: entries that lie before the windows' first step.
        delay_steps: (3,) dead times of steer, drive and pose in integration steps.
        substeps: integration steps to an entry.
    """

    rows: Array
    ahead: int
    delay_steps: Array
    substeps: int


class Scatter(NamedTuple):
    """What a piece's derivatives by parameters add to its outputs' sensitivities, one by one.

    Few parameters are free, most of them in one direction each.

    Attributes:
        slope: (E,) place of the derivative, from the piece's first one on.
        to: (E,) place of the sensitivity in the piece's workspace.
        scale: (E,) derivative of the parameter by the direction.
    """

    slope: Indices
    to: Indices
    scale: Array


class Directions(NamedTuple):
    """Directions of the forward sensitivities: what derivatives are taken by.

    Attributes:
        first: (STATES, >= n) derivative of the first state.
        delay_steps: (3,) dead times of steer, drive and pose in integration steps.
        delays: (rows of SENSITIVITIES) derivatives of `delay_steps`.
        n: directions in use, a multiple of SLOTS.
        actuators, rates, specialised, remember, observe: (slope, to, scale) of a `Scatter` each.
    """

    first: Array
    delay_steps: Array
    delays: Array
    n: int
    actuators: Scatter
    rates: Scatter
    specialised: Scatter
    remember: Scatter
    observe: Scatter


class WindowBlock(NamedTuple):
    """Windows of any lengths that fill the slots of one block.

    Attributes:
        commands: (rows, 2) steer [rad] and speed [m/s] of all runs, one after the other.
        spans: (SLOTS, 5) first row, row after the last, row of the first step, integration steps,
            and steps of the actuators alone before it (over known commands, to settle the
            steering).
        t: (SLOTS,) time into the run at the first step [s].
        first: ((STATES + MEMORY) * SLOTS,) first states; the steer is added to the settled one.
        own: how many slots hold a window of their own; the rest are copies.
    """

    commands: Array
    spans: Indices
    t: Array
    first: Array
    own: int


class Readings(NamedTuple):
    """Where windows are read, and the arrays of all windows that the results go into.

    Attributes:
        stations: (S, 4) step, first reading, row of `y`, and 1 for a late pose; each window's
            sorted by time.
        shares: (S,) place within the step, 0 to 1 (outside: extrapolated).
        ranges: (SLOTS, 2) first station of each window, and the one after its last.
        scale: (rows,) by which each row of derivatives is multiplied.
        y: (rows,) readings, written; a pose writes three.
        jy: (rows * width,) their derivatives, written.
        width: derivatives in a row of `jy`, at least `Directions.n`.
        start_pose: 0, or the first of three places in a row of `jy` for derivatives by position and
            heading of the window's start: a car that is the same everywhere moves and turns with
            it.
    """

    stations: Indices
    shares: Array
    ranges: Indices
    scale: Array
    y: Array
    jy: Array
    width: int
    start_pose: int


class PieceWork(NamedTuple):
    """Workspace of one piece.

    Attributes:
        v: rows of SLOTS (of one number each for what is done to one state): inputs, outputs,
            derivatives.
        w: rows of SENSITIVITIES of one window: inputs, outputs.
    """

    v: Array
    w: Array


class TangentWork(NamedTuple):
    """Workspaces of a block with forward sensitivities.

    Attributes:
        actuators, rates, remember, observe: of the pieces.
        stages: derivatives of the rates at every stage of a step.
        fast: (stages,) 1 where those are of the specialised rates.
        gaps: (2 * SLOTS,) older minus newer command, of steer and speed.
    """

    actuators: PieceWork
    rates: PieceWork
    remember: PieceWork
    observe: PieceWork
    stages: Array
    fast: Array
    gaps: Array


class Tangent(NamedTuple):
    """States of a block and their forward sensitivities.

    Attributes:
        now: rows of SLOTS: the states.
        after: the same a step later.
        dx: rows of SENSITIVITIES, STATES + MEMORY for each window in turn: of `now`.
        dx_after: one window's rows: of `after`.
    """

    now: Array
    after: Array
    dx: Array
    dx_after: Array


class AdjointWork(NamedTuple):
    """Workspaces of an adjoint, rows of SLOTS.

    Attributes:
        actuators: inputs and outputs.
        actuators_vjp: inputs, weights, derivatives by inputs and parameters.
        rates: the same for the rates.
        remember: the same for the memory.
        stages: inputs of the rates at every stage.
        after: chassis after the step.
        start: derivative by the chassis at the step's start.
        actuated: derivative by the actuators' outputs.
    """

    actuators: Array
    actuators_vjp: Array
    rates: Array
    remember: Array
    stages: Array
    after: Array
    start: Array
    actuated: Array
