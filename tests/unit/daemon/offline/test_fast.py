"""Drives in virtual time: reproducible, interrupted, unplugged; and recorded ones again."""

from dataclasses import replace
from itertools import pairwise

import pytest
from mcap.writer import Writer  # noqa: TID251

from steerd.daemon.assembly.build import VIRTUAL_EPOCH_NS, make_plan, make_world_config
from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.daemon.loop.findings import Flag
from steerd.daemon.loop.transitions import SupervisorState
from steerd.daemon.offline.fast import check_driven, record_virtual
from steerd.daemon.offline.replay import check_same, describe_difference, make_replay_plan, replay
from steerd.daemon.offline.virtual import drive, make_virtual_run
from steerd.daemon.settings.run_options import RunOptions
from steerd.sim_hw.plant.faults import Fault
from steerd.sim_hw.world import World
from steerd.steer_bus import messages as m
from steerd.steer_bus import topics
from steerd.steer_bus.codec import encode
from steerd.steer_bus.fields import schema_text
from steerd.steer_bus.session_read import open_session

OPTIONS = RunOptions(
    car_file="", path="line", speed=1.0, simulated=True, auto_arm=True, duration_s=0.5
)


@pytest.fixture(scope="module")
def plan():
    return make_plan(OPTIONS)


def go(ticks):
    """Drives so many ticks."""

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
    ticks = [record for record in seen if record.topic is topics.TICK]
    assert len(ticks) == 50
    written = session.messages(topics.make_session_topic("car1", topics.TICK))
    assert [record.data for record in written] == [record.data for record in ticks]


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


# Drives in virtual time: reproducible, parked at the end, and what a lost link does to them.

NS = 10**9
UNPLUGGED_NS = round(0.2 * NS)


def test_a_drive_ends_parked_and_the_same_seed_gives_the_same_bytes(plan):
    runs = [make_virtual_run(plan) for _ in range(2)]
    for run in runs:
        drive(run)
    first, second = runs
    assert first.core.loop.ran
    assert first.core.loop.parked
    assert not first.core.loop.faulted
    assert (first.t_ns, first.wire.hexdigest()) == (second.t_ns, second.wire.hexdigest())


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


def test_an_unplugged_port_is_noticed_and_opened_again(plan):
    gone = Fault("unplug", UNPLUGGED_NS, 2 * UNPLUGGED_NS)
    run = make_virtual_run(plan, (), World(make_world_config(plan), (gone,)))
    linked = []
    while run.t_ns < 5 * UNPLUGGED_NS:
        run.step()
        linked.append(bool(run.core.flags & Flag.LINKED))
    assert [a for a, b in pairwise(linked) if a != b] == [True, False]
    assert not run.core.flags & Flag.SERIAL_FAULT
    assert run.core.loop.supervisor.state is not SupervisorState.RUNNING


# Replay: a recorded drive gives the recorded orders; a changed one is found and described.

TICKS = 300
DRIVEN = RunOptions(
    car_file="", path="line", speed=1.0, simulated=True, auto_arm=True, duration_s=1.0
)


@pytest.fixture(scope="module")
def session(tmp_path_factory):
    """The first three seconds of a drive in virtual time."""
    path = tmp_path_factory.mktemp("replay") / "drive.mcap"
    record_virtual(make_plan(DRIVEN), path, lambda run: [run.step() for _ in range(TICKS)])
    return open_session(path)


def test_every_order_is_the_recorded_one(session):
    run, differences = replay(session, "drive.mcap")
    assert list(differences) == []
    assert run.ticks == TICKS
    assert check_same(0, run.ticks) is ExitCode.OK


def test_a_changed_order_is_found_and_described(session):
    run, _ = replay(session, "drive.mcap")

    def changed(record):
        message = record.decode()
        if isinstance(message, m.Actuation) and message.seq == 9:
            wrong = replace(message, speed=9.0, mode=m.ActuationMode.SPEED)
            return run.take(replace(record, data=encode(wrong)))
        return run.take(record)

    found = [d for d in map(changed, session.messages()) if d is not None]
    assert [difference.seq for difference in found] == [9]
    text = describe_difference(found[0], found[0].t_ns - 1_000_000_000)
    assert text.startswith("tick 9 (1.00 s): recorded SPEED")
    assert check_same(1, run.ticks) is ExitCode.DIFFERS


def test_the_plan_of_a_session_is_that_of_its_drive(session):
    plan = make_replay_plan(session, "drive.mcap")
    assert plan.options == replace(DRIVEN, car_file=plan.options.car_file)
    assert plan.run == make_plan(DRIVEN).run


def test_nothing_compared_is_an_error():
    with pytest.raises(SteerdError):
        check_same(0, 0)


def test_a_session_of_another_version_is_refused_and_names_the_field(tmp_path):
    path = tmp_path / "old.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start("ros2")
        text = schema_text(m.Tick).replace("uint32 flags", "uint32 ticked")
        schema = writer.register_schema("steerd_msgs/msg/Tick", "ros2msg", text.encode())
        channel = writer.register_channel("/steerd/car1/tick", "cdr", schema)
        data = encode(m.Tick(m.make_header(0, m.BODY), 1, 2, 3, 4, 5))
        writer.add_message(channel, 1, data, 1)
        writer.finish()
    with pytest.raises(SteerdError, match=r"lacks \['uint32 flags'\].*another version") as caught:
        replay(open_session(path), path.name)
    assert caught.value.code is ExitCode.INVALID
