"""A suspicion weighed again as the change itself would have it.

The sums of `changes` weigh a window by how badly the anchor explains it: one that shows a change
plainly counts for as little as one that nothing explains. What is nearly a change is therefore
fitted with the loss that decides, Student's t with weights at the fit.
"""

# Why: docs/decisions/diagnosis.md#d98

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from steerd.sim_gap.online.changes import SPANS
from steerd.sim_gap.online.fitting import Fit, fit_effect, looks_for
from steerd.sim_gap.online.looking import Anchor, Look
from steerd.sim_gap.online.tracking import Track

Array = NDArray[np.float64]

WORTH = 6.0
"""Ratios per what is usual from which on a window's suspicions are fitted [nats]; quiet drives get
there every few minutes ..."""
LEADERS = 4
"""... and only so many effects of them ..."""
SHARE = 0.5
"""... over the spans that show this share of it ..."""
LONGEST = 6
"""... and are no longer than this: what is older needs no hurry [windows]."""


def sharpened(
    anchor: Anchor,
    effects: Sequence[str],
    tracks: Sequence[Track],
    looks: Sequence[Look],
    table: Array,
    level: Array,
) -> Array:
    """The ratios, those that are nearly a change fitted; none becomes smaller.

    Args:
        anchor: the car.
        effects: what is looked at.
        tracks: what was known of the base before each of the windows.
        looks: the last windows, oldest first.
        table: (effects, spans) ratios [nats], see `changes.ratios`.
        level: (effects, spans) by what they are divided, see `changes.Usual`.
    """
    judged = np.nan_to_num(table / level, nan=-np.inf)
    if not judged.size or judged.max() < WORTH:
        return table
    table = table.copy()
    leaders = np.argsort(-judged.max(axis=1), kind="stable")[:LEADERS]
    for column, windows in enumerate(SPANS):
        rows = [row for row in leaders if judged[row, column] >= SHARE * WORTH]
        if windows > LONGEST or not rows:
            continue
        before, part = tracks[-windows], looks[-windows:]
        null = _fit(anchor, before, part, "")
        for row in rows:
            fit = _fit(anchor, before, part, effects[row])
            gain = null.total - fit.total + fit.freedom
            table[row, column] = max(table[row, column], gain)
    return table


def _fit(anchor: Anchor, before: Track, looks: Sequence[Look], effect: str) -> Fit:
    return fit_effect(anchor, before, looks_for(anchor, effect, looks), effect)
