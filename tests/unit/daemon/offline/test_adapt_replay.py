"""A drive that follows proposed designs: nearer to its lane, recorded, and the same in a replay."""

import numpy as np
import pytest

from steerd.controller.learnt import approach_learnt
from steerd.daemon.loop.design_desk import make_design, make_no_design
from steerd.daemon.loop.transitions import SupervisorState
from steerd.daemon.offline.fast import make_recording
from steerd.daemon.offline.virtual import EPOCH_NS, drive, make_virtual_run
from steerd.steer_bus import messages as m
from steerd.steer_bus.codec import encode
from steerd.steer_bus.session_read import open_session
from tests.designs import design_for, make_adapt_plan, numbers
from tests.replays import count_differences_without

pytestmark = pytest.mark.slow
AIM = {"steer_gain": 0.88, "steer_bias": 0.02}
FROM_S, DOUBT_S, LONG_S = 12.0, 26.0, 32.0


@pytest.fixture(scope="module")
def session(tmp_path_factory):
    """A car with another servo; a second learner's proposals from some time on, then doubt."""
    effects = ("steer_gain=0.88", "steer_bias=0.02")
    plan = make_adapt_plan(path="figure8:radius=2", duration_s=LONG_S, effects=effects)
    recording = make_recording(plan, tmp_path_factory.mktemp("adapt") / "drive.mcap")

    def sink(records, _t_ns):
        for record in records:
            recording.add(record)

    run, held = make_virtual_run(plan, (sink,)), plan.learnt
    known = {}

    def propose(run):
        t_ns, core = run.t_ns, run.core
        if t_ns < FROM_S * 1e9 or t_ns % 1_000_000_000:
            return
        if t_ns > DOUBT_S * 1e9:
            core.on_proposal(encode(make_no_design(t_ns, EPOCH_NS, "doubt")), t_ns)
            return
        at = core.loop.adapting.car
        car = approach_learnt(at, numbers(held, **AIM), held.bounds, held.steps)
        if car not in known:
            known[car] = design_for(held, **car._asdict())
        core.on_proposal(encode(make_design(t_ns, EPOCH_NS, 1, known[car])), t_ns)

    drive(run, propose)
    assert run.core.error is None
    recording.writer.finish({"reason": "test", "written": str(recording.written)})
    return open_session(recording.writer.path)


def lane_error(session, start, end):
    table = session.columns(m.StateMessage)
    t = (table["mono_ns"] - table["mono_ns"][0]) * 1e-9
    kept = (table["mode"] == SupervisorState.RUNNING) & (t > start) & (t < end)
    return float(np.sqrt((table["e1"][kept] ** 2).mean()))


def test_what_the_core_took_is_recorded(session):
    said = [r.decode() for r in session.messages("/steerd/car1/design")]
    taken = [d for d in said if d.number]
    assert taken[-1].steer_gain == pytest.approx(0.88)
    assert taken[-1].steer_bias == pytest.approx(0.02)
    assert len({d.number for d in taken}) >= 4, "by steps"
    assert said[-1].number == 0
    assert {d.text for d in said if not d.number} == {"doubt"}


def test_the_car_comes_nearer_to_its_lane_and_is_never_stopped(session):
    modes = set(session.columns(m.StateMessage)["mode"])
    assert SupervisorState.FAULT_STOP not in modes
    before, followed = lane_error(session, 6.0, FROM_S), lane_error(session, 20.0, DOUBT_S)
    assert followed < 0.3 * before
    assert lane_error(session, DOUBT_S + 3.0, LONG_S) > 2.0 * followed, "and back again"


def test_no_change_of_designs_jerks_the_wheel(session):
    table = session.columns(m.Actuation)
    steps = np.abs(np.diff(table["steer"][np.isfinite(table["steer"])]))
    assert steps.max() < 0.05


def test_a_replay_gives_every_order_again_and_without_the_designs_others(session):
    assert count_differences_without(session, "/design", ticks=2500) > 500
