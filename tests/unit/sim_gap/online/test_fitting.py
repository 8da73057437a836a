"""Hypotheses looked at again: a step is taken only as far as it makes the windows better."""

from dataclasses import replace

import numpy as np
import pytest

from steerd.sim_gap.online import fitting
from steerd.sim_gap.online.fitting import look_closer, rank
from steerd.sim_gap.online.looking import cut

FAR, MANY = -0.6, 5


@pytest.fixture
def closer(anchor, windows, track, monkeypatch):
    """Where a hypothesis that points too far ends up, if a car slides beyond `cliff`."""

    def find(cliff):
        def look_again(anchor, seen, effect, z):
            own = cut(seen, [*range(anchor.space.nuisance), *anchor.places(effect)])
            worse = 1e4 * own.dof if z[-1] < cliff else 0.0
            return replace(own, square=own.square + worse)

        monkeypatch.setattr(fitting, "look_again", look_again)
        looks = windows(MANY, tyre_friction=-0.2)
        null, fits = rank(anchor, ["tyre_friction"], track, looks)
        far = replace(fits[0], z=np.append(np.zeros(anchor.space.nuisance), FAR))
        return look_closer(anchor, null, [far], looks, {})["tyre_friction"]

    return find


def test_a_step_to_where_no_car_drives_is_halved(closer):
    assert closer(cliff=-0.25).z[-1] == pytest.approx(-0.15)


def test_a_step_that_makes_nothing_better_is_not_taken(closer):
    point = closer(cliff=-1e-6)
    assert not point.z.any()
    assert len(point.looks) == MANY
