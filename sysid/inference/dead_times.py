"""A dead time some steps away: the likelihood has kinks in it that stop a search.

A servo at its slew limit starts on the step in which a command arrives, whatever the fraction. So a
search comes to rest where the dead time is a whole number of steps, and the pose's delay, the lag
and the inertia make good what is missing. From there the dead time is moved by whole steps, for as
long as that lowers the cost.
"""

# Why: docs/decisions/identification.md#d89

from steerd.sysid.inference.engine import Engine
from steerd.sysid.inference.levenberg_marquardt import ENOUGH, Fitted, minimise

NAME = "steer_delay"
MOST = 8
"""Steps, at most."""


def try_other_dead_times(engine: Engine, fitted: Fitted) -> Fitted:
    """The fit, or a better one with another dead time of the steering.

    Args:
        engine: the windows.
        fitted: where a search came to rest.
    """
    if NAME not in fitted.space.chart.free:
        return fitted
    best = fitted
    for direction in (1.0, -1.0):
        for _ in range(MOST):
            found = _moved(engine, best, direction * engine.readings.layout.h)
            if found is None or found.cost > best.cost - ENOUGH:
                break
            best = found
        if best is not fitted:
            break
    return best


def _moved(engine: Engine, fitted: Fitted, by: float) -> Fitted | None:
    """The nearest optimum from another dead time [s]; None where there is none."""
    space, place = fitted.space, fitted.space.chart.free.index(NAME)
    z = fitted.z.copy()
    z[place] += by
    if not space.low[place] <= z[place] <= space.high[place]:
        return None
    try:
        return minimise(engine, space, z, fitted.x.copy())
    except FloatingPointError:
        return None
