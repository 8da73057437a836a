"""Drives in virtual time: recorded, interrupted, tuned on the way; and what can be replayed."""

from math import nan

import numpy as np
import pytest

from steerd.car_model.car_file import default_car_path, load_car
from steerd.car_model.path.path import locate
from steerd.daemon.analysis.gap_closed_loop import compare_lane
from steerd.daemon.assembly.build import VIRTUAL_EPOCH_NS, make_plan
from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.daemon.loop.transitions import SupervisorState
from steerd.daemon.offline.fast import check_driven, record_virtual
from steerd.daemon.offline.replay import replay
from steerd.daemon.offline.virtual import drive, make_virtual_run
from steerd.daemon.settings.run_options import RunOptions
from steerd.steer_bus import messages as m
from steerd.steer_bus import topics
from steerd.steer_bus.codec import encode
from steerd.steer_bus.session_read import open_session
from tests.replays import count_differences_without
from tests.unit.daemon.sessions.test_bad_content import replacing, write


@pytest.fixture(scope="module")
def plan():
    on = {"simulated": True, "auto_arm": True, "duration_s": 0.5}
    return make_plan(RunOptions("", path="line", speed=1.0, **on))


def go(ticks):
    def steps(run):
        for _ in range(ticks):
            run.step()

    return steps


def test_every_record_is_seen_and_in_the_file(plan, tmp_path):
    seen = []
    path = tmp_path / "drive.mcap"
    record_virtual(plan, path, go(50), lambda records, _t_ns: seen.extend(records))
    session = open_session(path)
    assert session.info().clean
    assert session.info().start_ns >= VIRTUAL_EPOCH_NS
    ticks = [record.data for record in seen if record.topic is topics.TICK]
    assert len(ticks) == 50
    written = session.messages(topics.make_session_topic("car1", topics.TICK))
    assert [record.data for record in written] == ticks


def test_an_interrupted_drive_is_kept_and_says_so(plan, tmp_path):
    def interrupt(run):
        go(30)(run)
        raise KeyboardInterrupt

    path = tmp_path / "drive.mcap"
    with pytest.raises(KeyboardInterrupt):
        record_virtual(plan, path, interrupt)
    info = open_session(path).info()
    assert info.metadata["steerd.end"]["reason"] == "interrupted"
    assert info.count > 30


def test_a_car_that_never_drove_is_an_error_that_says_what_was_missing(plan):
    run = make_virtual_run(plan)
    go(3)(run)
    with pytest.raises(SteerdError, match=r"never driven: waiting for ..") as caught:
        check_driven(run)
    assert caught.value.code is ExitCode.STOPPED
    run.core.loop.ran = True
    check_driven(run)


# Time in a virtual run.
@pytest.mark.parametrize(("late", "periods"), [(0, 1), (0.4, 1), (2.5, 3)])
def test_a_late_tick_skips_whole_periods(plan, late, periods):
    run = make_virtual_run(plan)
    run.step()
    before = run.t_ns
    run.step(round(late * run.period_ns))
    assert run.t_ns - before == periods * run.period_ns


def test_a_failed_drive_raises_its_own_reason_after_that_tick(plan):
    run = make_virtual_run(plan)

    def fail(now):
        now.failed = OSError("no space left")

    with pytest.raises(OSError, match="no space left"):
        drive(run, fail)
    assert run.t_ns == 2 * run.period_ns


# Replay: what cannot be compared.
def test_a_session_of_another_version_is_refused(tmp_path):
    tick = m.Tick(m.make_header(0, m.BODY), 1, 2, 3, 4, 5)
    schema = replacing("uint32 flags", "uint32 ticked")
    path = write(tmp_path / "old.mcap", [("/steerd/car1/tick", 1, tick)], **schema)
    with pytest.raises(SteerdError, match=r"lacks \['uint32 flags'\].*another version") as caught:
        replay(open_session(path), path.name)
    assert caught.value.code is ExitCode.INVALID


def test_a_drive_without_a_tick_is_nothing_to_replay(plan, tmp_path, cli):
    record_virtual(plan, tmp_path / "a.mcap", lambda run: None)
    said = cli("replay", tmp_path / "a.mcap", code=ExitCode.INVALID).err
    assert "nothing to replay" in said


# A drive with live parameters: what the car does, and a replay.
OPTIONS = RunOptions(
    "", path="figure8", speed=1.5, simulated=True, auto_arm=True, duration_s=25.0, port="virtual"
)
CHANGES = [
    (6.0, {"speed": 0.75}), (10.0, {"offset": 0.1, "gain": 1.3}), (11.0, {"speed": 3.0}),
    (11.0, {"speed": 3.0, "offset": -0.1}), (18.0, {"speed": 1.25, "offset": -0.05}),
]  # fmt: skip
"""Seconds of the run, and what is requested then."""


@pytest.fixture(scope="module")
def session(tmp_path_factory):
    """A drive in virtual time with an operator's changes."""
    path = tmp_path_factory.mktemp("live") / "drive.mcap"
    record_virtual(make_plan(OPTIONS), path, ask_on_the_way)
    return open_session(path)


def ask_on_the_way(run):
    for seq, (t_s, values) in enumerate(CHANGES):
        while run.t_ns < t_s * 1e9:
            run.step()
        wanted = {"speed": nan, "offset": nan, "gain": nan, **values}
        request = m.ParameterRequest(
            m.make_header(run.t_ns, m.BODY), run.core.loop.lease.boot_id, 7, seq, *wanted.values(),
            "desk",
        )  # fmt: skip
        assert run.core.on_request(topics.SET_PARAMETERS.name, encode(request), run.t_ns)
    while not (run.core.loop.ran and run.core.loop.parked):
        run.step()


def running(session, start, end):
    """The states of the running car between these times [s]."""
    table = session.columns(m.StateMessage)
    t = (table["mono_ns"] - table["mono_ns"][0]) * 1e-9
    kept = (table["mode"] == SupervisorState.RUNNING) & (t > start) & (t < end)
    return {name: column[kept] for name, column in table.items()}


@pytest.mark.slow
def test_the_car_does_as_asked_and_is_never_stopped_for_it(session):
    assert SupervisorState.FAULT_STOP not in session.columns(m.StateMessage)["mode"]
    assert running(session, 8.0, 10.0)["speed"] == pytest.approx(0.75, abs=0.02)
    assert running(session, 4.0, 5.9)["speed"].max() > 1.4
    assert running(session, 20.0, 24.0)["speed"].max() == pytest.approx(1.25, abs=0.03)
    assert running(session, 6.0, 24.0)["speed_ref"].max() <= 1.5
    assert np.abs(running(session, 14.0, 18.0)["e1"]).max() < 0.01, "of the shifted lane"


@pytest.mark.slow
def test_such_a_drive_is_no_measure_of_a_simulated_one(session):
    with pytest.raises(SteerdError, match="live parameters were changed"):
        compare_lane(session, load_car(default_car_path()), {})


@pytest.mark.slow
def test_the_lane_lies_beside_the_path(session):
    path = make_plan(OPTIONS).path
    for start, end, offset in ((14.0, 18.0, 0.1), (21.5, 24.0, -0.05)):
        states = running(session, start, end)
        places = np.column_stack([states[name][::10] for name in ("x", "y", "yaw")])
        beside = [locate(path, *place).e1 for place in places.tolist()]
        assert beside == pytest.approx([offset] * len(places), abs=0.02)
        assert len(places) > 20


@pytest.mark.slow
def test_a_replay_gives_every_order_again_and_without_the_requests_others(session):
    assert count_differences_without(session, "cmd/parameters", ticks=2000) > 1000
