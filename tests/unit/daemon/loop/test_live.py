"""Live parameters of a run: who may set them, what is refused and why, what ends them."""

from dataclasses import replace
from math import inf, isnan, nan

import pytest

from steerd.controller.lane_controller import ControlReport
from steerd.controller.live import AS_DESIGNED, LiveBounds, LiveValues
from steerd.daemon.assembly.build import RunId, make_plan
from steerd.daemon.loop import live as lv
from steerd.daemon.loop.live import make_live, make_parameters, take_request
from steerd.daemon.loop.loop import Loop
from steerd.daemon.loop.transitions import SupervisorState
from steerd.daemon.settings.run_options import ControllerKind, RunOptions
from steerd.steer_bus import messages as m
from steerd.steer_bus.quick_values import changed

BOUNDS = LiveBounds(
    LiveValues(0.25, -0.125, 0.5), LiveValues(1.5, 0.125, 1.25), LiveValues(1.5, 0.0, 1.0)
)
LIVE = make_live(BOUNDS)
SEEN = ControlReport(*(nan,) * len(ControlReport._fields))._replace(e1=0.0)
ANN, BOB = 5, 9


def ask(speed=nan, offset=nan, gain=nan, *, boot=1, who=ANN, seq=1):
    header = m.make_header(0, m.BODY)
    return m.ParameterRequest(header, boot, who, seq, speed, offset, gain, "desk")


def test_what_a_request_leaves_out_stays():
    live = take_request(LIVE, ask(speed=1.0), admitted=True)
    live = take_request(live, ask(offset=0.0625, seq=2), admitted=True)
    assert live.aim == LiveValues(1.0, 0.0625, 1.0)
    assert (live.accepted, live.seq, live.lease_id) == (True, 2, ANN)
    assert live.text == "set by desk"


@pytest.mark.parametrize("edge", [BOUNDS.low, BOUNDS.high])
def test_the_bounds_themselves_are_allowed(edge):
    assert take_request(LIVE, ask(*edge), admitted=True).aim == edge


@pytest.mark.parametrize(("wrong", "said"), [
    ({"speed": 1.51}, "speed 1.51 m/s, allowed 0.25 to 1.5 m/s: the run was started"),
    *(({"speed": speed}, f"speed {speed:g} m/s") for speed in (0.0, -1.0, inf)),
    ({"offset": 0.126}, "offset 0.126 m, allowed -0.125 to 0.125 m"),
    ({"offset": -inf}, "offset -inf m"),
    ({"gain": 1.26}, "gain 1.26, allowed 0.5 to 1.25: the closed loop was checked"),
    ({"gain": 0.0}, "gain 0"), ({"speed": 1.0, "gain": 9.0}, "gain 9"),
])  # fmt: skip
def test_a_value_out_of_bounds_is_refused_with_its_reason_and_all_others_with_it(wrong, said):
    live = take_request(LIVE, ask(**wrong), admitted=True)
    assert (live.aim, live.accepted) == (LIVE.aim, False)
    assert live.text.startswith("refused: ")
    assert said in live.text


@pytest.mark.parametrize(("before", "admitted", "aim", "said"), [
    (make_live(None), True, AS_DESIGNED, "not the lane keeper alone"),
    (LIVE, False, LIVE.aim, "somebody else holds this car"),
], ids=["something else drives", "somebody else holds the car"])  # fmt: skip
def test_who_may_not_sets_nothing(before, admitted, aim, said):
    live = take_request(before, ask(speed=1.0), admitted=admitted)
    assert (live.aim, live.accepted) == (aim, False)
    assert said in live.text


def test_a_moving_car_comes_to_its_values_gradually_and_a_parked_one_has_them():
    live = take_request(replace(LIVE, t_ns=10**9), ask(offset=0.125), admitted=True)
    for t_ns in (10**9 + 10**8, 10**12):  # the later one after a pause
        moving = lv.step_live(live, t_ns, parked=False)
        assert moving.now.offset == pytest.approx(0.01)
    assert lv.step_live(live, 0, parked=False).now.offset == 0.0, "time does not run backwards"
    assert lv.step_live(live, 10**9, parked=True).now == live.aim


@pytest.mark.parametrize(("e1", "offset", "judged"), [
    (0.1, 0.0, 0.1), (0.2, 0.1, 0.3), (-0.2, 0.1, -0.2), (-0.04, 0.1, 0.06), (0.0, -0.1, -0.1),
])  # fmt: skip
def test_watchdogs_judge_the_larger_of_both_errors(e1, offset, judged):
    report = lv.judge_both_lanes(SEEN._replace(e1=e1), LiveValues(1.0, offset, 1.0))
    assert report.e1 == pytest.approx(judged)


def test_the_message_holds_values_bounds_and_the_answer():
    live = take_request(LIVE, ask(gain=3.0), admitted=True)
    message = make_parameters(live, 7)
    assert (message.speed, message.speed_min, message.speed_max) == (1.5, 0.25, 1.5)
    assert (message.gain_min, message.gain, message.gain_max) == (0.5, 1.0, 1.25)
    assert (message.accepted, message.seq, message.text) == (0, 1, live.text)
    assert make_parameters(make_live(None), 7) is None
    refused = make_parameters(take_request(make_live(None), ask(), admitted=True), 7)
    assert isnan(refused.speed_max)
    assert not refused.accepted


def make_loop(leased=True, **options):
    given = RunOptions("", path="line", port="somewhere", simulated=True, **options)
    return Loop(make_plan(given, real=RunId(1, 0, leased)))


def hold(loop, who, seq, t_ns):
    kind = int(m.RequestKind.KEEPALIVE)
    loop.on_operator(m.OperatorRequest(m.make_header(0, m.BODY), 1, who, seq, kind, "desk"), t_ns)


def test_the_lease_is_that_of_every_other_request():
    loop = make_loop()
    hold(loop, ANN, 1, 0)
    for wrong in (ask(0.5, who=BOB), ask(0.5, seq=1), ask(0.5, boot=2, seq=2), ask(0.5, who=0)):
        loop.on_parameters(wrong, 10**8)
        assert (loop.live.accepted, loop.live.aim.speed) == (False, 1.0)
    loop.on_parameters(ask(0.5, seq=2), 2 * 10**8)
    assert (loop.live.accepted, loop.live.aim.speed) == (True, 0.5)
    assert loop.lease.renewed_ns == 2 * 10**8
    hold(loop, ANN, 2, 3 * 10**8)
    assert loop.lease.seq == 2, "one number for all requests"


@pytest.fixture
def tuned():
    """A loop whose parameters Ann has set."""
    loop = make_loop()
    hold(loop, ANN, 1, 0)
    loop.on_parameters(ask(0.5, 0.1, 1.2, seq=2), 0)
    assert loop.live.aim == LiveValues(0.5, 0.1, 1.2)
    return loop


def test_another_operator_does_not_inherit_what_was_tuned(tuned):
    hold(tuned, BOB, 1, 2 * 10**9)
    assert tuned.live.aim == LiveValues(0.5, 0.0, 1.0)
    assert "another operator" in tuned.live.text


def test_without_a_deadman_there_is_nobody_to_inherit_from():
    loop = make_loop(leased=False)
    loop.on_parameters(ask(0.5, 0.1, 1.2), 0)
    loop.on_parameters(ask(0.6, who=BOB), 2 * 10**9)
    assert loop.live.aim == LiveValues(0.6, 0.1, 1.2)


def test_only_the_lane_keeper_alone_has_live_parameters():
    assert make_loop().plan.live is not None
    assert make_loop(controller=ControllerKind.ZENOH).plan.live is None
    assert make_loop(drill="mixed;closed").plan.live is None


def test_a_fault_ends_what_was_tuned(tuned):
    tuned.supervisor = changed(tuned.supervisor, state=SupervisorState.FAULT_STOP)
    tuned._apply_transition(SupervisorState.RUNNING, None, 0, "")
    assert tuned.live.aim == LiveValues(0.5, 0.0, 1.0)
