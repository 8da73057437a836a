"""Drives in virtual time: recorded, interrupted; and what cannot be replayed."""

import pytest

from steerd.daemon.assembly.build import VIRTUAL_EPOCH_NS, make_plan
from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.daemon.offline.fast import check_driven, record_virtual
from steerd.daemon.offline.replay import replay
from steerd.daemon.offline.virtual import drive, make_virtual_run
from steerd.daemon.settings.run_options import RunOptions
from steerd.steer_bus import messages as m
from steerd.steer_bus import topics
from steerd.steer_bus.session_read import open_session
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
