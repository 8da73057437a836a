"""A change that came slowly: its later windows say by how much, where they contradict all."""

import pytest

from steerd.sim_gap.online.fitting import fit_effect, looks_for
from steerd.sim_gap.online.settling import WINDOWS, settled_fit

HALFWAY, ALL = 0.01, 0.02


@pytest.fixture
def fitted(anchor, track):
    """The fit of all windows, and the settled one."""

    def make(looks):
        own = looks_for(anchor, "steer_bias", looks)
        fit = fit_effect(anchor, track, own, "steer_bias")
        return fit, settled_fit(anchor, track, own, fit)

    return make


def test_the_later_half_is_believed_where_the_first_windows_are_halfway(fitted, windows):
    slow = windows(WINDOWS // 2, steer_bias=HALFWAY) + windows(WINDOWS // 2, steer_bias=ALL, seed=4)
    fit, settled = fitted(slow)
    assert fit.z[-1] < 0.9 * ALL
    assert settled.z[-1] == pytest.approx(ALL, abs=4.0 * settled.sd[0])
    assert settled.sd[0] > fit.sd[0]


def test_windows_of_one_value_are_all_believed(fitted, windows):
    fit, settled = fitted(windows(2 * WINDOWS, steer_bias=ALL))
    assert settled is fit


def test_few_windows_are_not_halved(fitted, windows):
    few = windows(WINDOWS // 2, steer_bias=HALFWAY)
    few += windows(WINDOWS // 2 - 1, steer_bias=ALL, seed=4)
    fit, settled = fitted(few)
    assert settled is fit
