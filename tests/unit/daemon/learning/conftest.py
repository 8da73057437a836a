"""A report as the learner sends it."""

from collections.abc import Callable
from dataclasses import replace
from math import nan

import pytest

from steerd.daemon.learning.feed import make_model
from steerd.daemon.learning.reported import ReportedChange, ReportedValue, pack
from steerd.sim_gap.online.learner import State
from steerd.steer_bus import messages as m

NOON = 1_763_812_800_000_000_000
"""12:00:00 UTC of a day, in UNIX time [ns]; the monotonic clock then read 100 s."""
MONO = 100_000_000_000


@pytest.fixture
def make_change() -> Callable[..., ReportedChange]:
    """A change 40 s before noon; a named one is a steering bias."""

    def make(verdict: str = "named", alternatives: tuple[str, ...] = ()) -> ReportedChange:
        since, noticed = MONO - 40_000_000_000, MONO - 39_000_000_000
        if verdict != "named":
            return ReportedChange(since, noticed, verdict, "", nan, (), ())
        bias = ReportedValue("bias", 0.0213, 0.0021, "rad")
        return ReportedChange(since, noticed, verdict, "steer_bias", 0.97, alternatives, (bias,))

    return make


@pytest.fixture
def make_report() -> Callable[..., m.Model]:
    """A report at noon of a car without changes, or with these."""

    def make(verdict: str = "none", *changes: ReportedChange) -> m.Model:
        values = [
            ReportedValue("steer_gain", 0.98, 0.012, "1", True),
            ReportedValue("inertia_z", 0.046, nan, "kg m^2", False),
        ]
        model = make_model(State(seen=120), MONO, NOON - MONO, 3, {})
        return replace(model, verdict=verdict, details=pack(values, list(changes)))

    return make
