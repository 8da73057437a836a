"""By how much, where a change came slowly: what its later windows say, once they contradict all.

A screw that gives way or a body that slips is halfway in the first windows; their mean is no value
that the car ever keeps. An estimate from part of the windows differs from that of all of them by
the difference of their variances (Hausman, 1978), unless the windows are not of one value.
"""

from collections.abc import Sequence

import numpy as np

from steerd.sim_gap.online.fitting import Fit, fit_effect
from steerd.sim_gap.online.looking import Anchor, Look
from steerd.sim_gap.online.tracking import Track

WINDOWS = 12
"""Windows from which on the later half is looked at by itself."""
CONTRADICTED = 3.0
"""Standard deviations of the difference from which on the later half is believed."""


def settled_fit(anchor: Anchor, before: Track, looks: Sequence[Look], fit: Fit) -> Fit:
    """The fit, or that of the later half of its windows where these contradict it.

    Args:
        anchor: the car.
        before: what was known of the base before the windows.
        looks: the windows, in the base's coordinates and the effect's.
        fit: of the effect to all of them.
    """
    if len(looks) < WINDOWS:
        return fit
    n = anchor.space.nuisance
    late = fit_effect(anchor, before, looks[len(looks) // 2 :], fit.effect)
    moved = np.abs(late.z[n:] - fit.z[n:])
    sd = np.sqrt(np.maximum(late.sd**2 - fit.sd**2, 0.0))
    return late if (moved > CONTRADICTED * sd).any() else fit
