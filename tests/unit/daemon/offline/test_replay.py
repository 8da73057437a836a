"""Replay: a recorded drive gives the recorded orders; a changed one is found and described."""

from dataclasses import replace

import pytest
from mcap.writer import Writer  # noqa: TID251

from steerd.daemon.assembly.build import make_plan
from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.daemon.offline.fast import record_virtual
from steerd.daemon.offline.replay import check_same, describe_difference, make_replay_plan, replay
from steerd.daemon.settings.run_options import RunOptions
from steerd.steer_bus import messages as m
from steerd.steer_bus.codec import encode
from steerd.steer_bus.fields import schema_text
from steerd.steer_bus.session_read import open_session

TICKS = 300
OPTIONS = RunOptions(
    car_file="", path="line", speed=1.0, simulated=True, auto_arm=True, duration_s=1.0
)


@pytest.fixture(scope="module")
def session(tmp_path_factory):
    """The first three seconds of a drive in virtual time."""
    path = tmp_path_factory.mktemp("replay") / "drive.mcap"
    record_virtual(make_plan(OPTIONS), path, lambda run: [run.step() for _ in range(TICKS)])
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
    plan, boot_id, _, leased = make_replay_plan(session, "drive.mcap")
    assert (plan.options, leased) == (replace(OPTIONS, car_file=plan.options.car_file), False)
    assert boot_id == OPTIONS.seed + 1


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
