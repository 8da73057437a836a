"""The learner on drives of the hidden four-wheel car."""

import pytest

from steerd.sim_gap.online.learner import REFERENCE, SETTLED
from steerd.sim_gap.online.samples import Ordered, Paused, PoseSeen, Rolled
from steerd.sim_gap.online.values import values_of
from tests.unit.sim_gap.online.conftest import follow

pytestmark = pytest.mark.slow
AT, LONGEST = 30.2, 9.8  # when a car changes, and how long it is looked at after that [s]
quiet = pytest.fixture(lambda learner, drives: follow(learner, drives(32.0)), scope="module")


def test_a_healthy_car_is_learnt_and_has_no_change(quiet):
    state, reports = quiet
    assert state.known is not None
    assert state.seen >= REFERENCE
    assert (state.change, state.past, state.taken_back) == (None, (), 0)
    assert 29 <= reports <= 32
    learnt = {value.name: value for value in values_of(state.known)}
    for name, truth in (("speed_gain", 0.9788), ("steer_delay", 0.0158), ("speed_lag", 0.0909)):
        assert learnt[name].value == pytest.approx(truth, abs=4.0 * learnt[name].sd), name
        assert learnt[name].identifiable
    assert learnt["speed_gain"].sd < 0.003


def standing(state):
    """The car stands for a minute, its commands at zero; then nobody drives it."""
    pose, t = state.recent.poses[-1], state.recent.newest
    for tick in range(1, 6000):
        now = t + 0.01 * tick
        yield PoseSeen(now, pose.x, pose.y, pose.yaw)
        yield Ordered(now, 0.0, 0.0) if tick < 3000 else Paused(now)
        yield Rolled(now, 0.0)


def test_a_standstill_changes_nothing(learner, quiet):
    state, _ = quiet
    after, reports = follow(learner, standing(state), state)
    assert after.known is state.known
    assert after.seen == state.seen
    assert reports >= 59


@pytest.fixture(scope="module")
def before(learner, drives, learn):
    """What is known when the car changes: until then all drives of one length are the same."""
    return learn(learner, (s for s in drives(AT + LONGEST) if s.t < AT))


@pytest.mark.parametrize(("name", "value", "seconds"), [
    ("mocap_yaw", 0.03, LONGEST), ("speed_scale", 0.95, 5.0), ("steer_lag", 0.08, 7.0),
    ("steer_backlash", 0.03, 7.0),  # it has no gradient where there is none
])  # fmt: skip
def test_a_change_is_noticed_and_named(learner, drives, learn, before, name, value, seconds):
    seen = (s for s in drives(AT + LONGEST, name, AT) if AT <= s.t < AT + seconds)
    change = learn(learner, seen, before).change
    assert (change.finding.verdict, change.finding.cause.effect) == ("named", name)
    assert change.noticed - AT < 3.0
    informed, sd, _ = next(iter(change.finding.cause.parameters.values()))
    assert informed == pytest.approx(value, abs=max(4.0 * sd, 0.004))
    settled = len(change.windows) >= SETTLED
    assert (change.proven[0].effect if change.proven else "") == (name if settled else "")
