"""The learner's proposals: by steps, from where the core is, and none in doubt."""

import pytest

from steerd.daemon.learning import feed
from steerd.daemon.learning.feed import PAUSE_NS, Proposals, Wiring, make_sample
from steerd.daemon.loop.adapting import REFUSED, make_design, make_no_design, read_design
from steerd.sim_gap.online.samples import Ordered, Paused, PoseSeen, Rolled
from steerd.steer_bus import messages as m
from steerd.steer_bus import topics
from steerd.steer_bus.codec import decode
from steerd.vesc_link.scaling import Scaling
from tests.blank import blank
from tests.designs import numbers, standard

S = 1_000_000_000


@pytest.fixture
def aims(monkeypatch):
    """What is learnt, to be set by a test."""
    now = {"aim": "the car is being learnt"}
    monkeypatch.setattr(feed, "find_aim", lambda learner, state: now["aim"])
    return now


class Proposer(Proposals):
    """Proposals that are decoded as they go out; of designs it is only counted how many."""

    def __init__(self):
        self.held, self.sent, self.made = standard(), [], 0
        super().__init__(self.held, self.make_table, lambda *sent: self.sent.append(sent))

    def make_table(self, car, config, timing, speed):
        self.made += 1
        return self.held.file.table

    def say(self, t_ns):
        self.propose(None, None, t_ns, 0)
        data, sent_ns = self.sent[-1]
        assert sent_ns == t_ns
        return decode(m.Design, data)


at = pytest.fixture(lambda: Proposer())


def test_in_doubt_or_for_the_car_of_the_file_the_reason_is_proposed(at, aims):
    said = at.say(5 * S)
    assert (said.number, said.text, said.mono_ns) == (0, "the car is being learnt", 5 * S)
    aims["aim"] = numbers(at.held)
    said = at.say(6 * S)
    assert (said.number, said.text) == (0, "the car is as in the car file")


def test_the_learnt_car_is_reached_by_steps_that_the_core_took(at, aims):
    aims["aim"] = numbers(at.held, steer_gain=0.88)
    unanswered = [at.say(k * S).steer_gain for k in range(4)]
    assert unanswered == pytest.approx([0.97] * 4)
    seen = []
    for k in range(4, 12):
        said = at.say(k * S)
        seen.append(said.steer_gain)
        at.hear(make_design(k * S, 0, k + 1, read_design(said)))
    assert seen == pytest.approx([0.97, 0.94, 0.91, 0.88, 0.88, 0.88, 0.88, 0.88])
    assert at.made == 4, "what stays is not designed again"


def test_after_a_refusal_it_pauses_and_begins_at_the_files(at, aims):
    aims["aim"] = numbers(at.held, steer_gain=0.88)
    at.hear(make_design(S, 0, 1, read_design(at.say(S))))
    at.hear(make_no_design(2 * S, 0, REFUSED + "a gain is absurd"))
    said = at.say(3 * S)
    assert (said.number, said.text) == (0, "a design was refused")
    assert at.say(2 * S + PAUSE_NS).steer_gain == pytest.approx(0.97)


# Messages of a drive as samples of the learner.
EPOCH = 1_700_000_000_000_000_000
WIRING = Wiring(EPOCH, Scaling(4000.0, 100.0))


def at_s(seconds, cls, **values):
    """A message with a header of so long after the session's zero."""
    return blank(cls, **{"header": m.make_header(EPOCH + seconds * S, m.BODY), **values})


POSE = {"t_valid_ns": 2 * S, "x": 1.0, "y": 2.0, "yaw": 0.3}
OTHER_ORDERS = [mode for mode in m.ActuationMode if mode != m.ActuationMode.SPEED]
TOLD = {"t_sent_ns": S, "t_received_ns": S + 2_000_000, "erpm": 6100}


def actuation(mode):
    return at_s(3, m.Actuation, mode=mode, steer=0.1, speed=1.5)


@pytest.mark.parametrize(("topic", "message", "sample"), [
    (topics.MOCAP, at_s(2, m.MocapPose, **POSE), PoseSeen(2.0, 1.0, 2.0, 0.3)),
    (topics.MOCAP, at_s(2, m.MocapPose, **POSE, reject="jump"), None),
    (topics.ACTUATION, actuation(m.ActuationMode.SPEED), Ordered(3.0, 0.1, 1.5)),
    *((topics.ACTUATION, actuation(mode), Paused(3.0)) for mode in OTHER_ORDERS),
    (topics.VESC, at_s(1, m.VescTelemetry, **TOLD), Rolled(pytest.approx(1.001), 1.5)),
    (topics.WHEEL, at_s(4, m.WheelSpeed, t_ns=4 * S, speed=1.25), Rolled(4.0, 1.25)),
])  # fmt: skip
def test_a_message_counts_when_it_was_valid_in_the_sessions_own_scaling(topic, message, sample):
    assert make_sample(WIRING, topic, message) == sample
