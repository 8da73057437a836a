"""The viewer: what is drawn, what is advertised, what is refused. Decoded by protobuf itself."""

import json
import os
from math import atan2, hypot, pi
from types import SimpleNamespace

import pytest
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

from steerd.car_model.car_file import default_car_path
from steerd.daemon.assembly.build import make_plan
from steerd.daemon.cli.main import run_cli
from steerd.daemon.common.errors import SteerdError
from steerd.daemon.ipc.outbox import Outbox
from steerd.daemon.ipc.pipe_records import PipeWriter, make_pipe, pack_record, unpack_records
from steerd.daemon.process.view import ReadOnlyParameters, Viewer, make_channel, run_viewer
from steerd.daemon.process.view_job import make_view_job, parse_view
from steerd.daemon.process.view_scene import (
    Body,
    make_car_scene,
    make_lane,
    make_lane_scene,
    make_parameters,
    make_transform,
)
from steerd.daemon.settings.run_options import RunOptions
from steerd.steer_bus import messages as m
from steerd.steer_bus import topics

BODY = Body(0.16, 0.17, 0.27)


def decode_foxglove(message):
    """The message as protobuf decodes it, by the schema that the SDK sends."""
    schema = type(message).get_schema()
    files = descriptor_pb2.FileDescriptorSet.FromString(schema.data)
    pool = descriptor_pool.DescriptorPool()
    for file in files.file:
        pool.Add(file)
    made = message_factory.GetMessageClass(pool.FindMessageTypeByName(schema.name))
    return made.FromString(message.encode())


def make_state(**values):
    numbers = dict.fromkeys(m.State.__dataclass_fields__, 0.0)
    numbers |= {"header": m.make_header(1_500_000_000_250_000_000, m.WORLD)}
    numbers |= {"mono_ns": 1, "seq": 1, "flags": 0, "mode": 0}
    return m.State(**{**numbers, **values})


def yaw_of(turn):
    return 2.0 * atan2(turn.z, turn.w)


def test_the_transform_puts_the_body_where_the_estimate_is():
    sent = decode_foxglove(make_transform(make_state(x=1.5, y=-2.0, yaw=0.75 * pi)))
    (frame,) = sent.transforms
    assert (frame.parent_frame_id, frame.child_frame_id) == (m.WORLD, m.BODY)
    assert (frame.translation.x, frame.translation.y) == (1.5, -2.0)
    assert yaw_of(frame.rotation) == pytest.approx(0.75 * pi)
    assert frame.timestamp.ToNanoseconds() == 1_500_000_000_250_000_000


def test_the_car_has_its_axles_and_steers_in_front_only():
    state = make_state(steer=0.3, speed=2.0, slip_angle=-0.05)
    (car,) = decode_foxglove(make_car_scene(state, BODY)).entities
    assert (car.frame_id, car.frame_locked) == (m.BODY, True)
    chassis, *wheels = car.cubes
    assert len(wheels) == 4
    assert {round(w.pose.position.x, 6) for w in wheels} == {0.16, -0.17}
    for wheel in wheels:
        front = wheel.pose.position.x > 0.0
        assert yaw_of(wheel.pose.orientation) == pytest.approx(0.3 if front else 0.0)
        assert abs(wheel.pose.position.y) == pytest.approx(0.135)
    assert chassis.size.x > 0.33
    (arrow,) = car.arrows
    assert yaw_of(arrow.pose.orientation) == pytest.approx(-0.05)
    assert arrow.shaft_length == pytest.approx(0.6)


def test_a_lane_runs_beside_its_path():
    points = [(2.0, 0.0, pi / 2), (0.0, 2.0, pi), (-2.0, 0.0, -pi / 2)]
    lane = make_lane(points, 0.3, closed=True)
    (scene,) = decode_foxglove(make_lane_scene(lane)).entities
    assert scene.frame_id == m.WORLD
    path, left, right = scene.lines
    assert [hypot(p.x, p.y) for p in path.points] == pytest.approx([2.0] * 3)
    assert [hypot(p.x, p.y) for p in left.points] == pytest.approx([1.7] * 3)
    assert [hypot(p.x, p.y) for p in right.points] == pytest.approx([2.3] * 3)
    assert {line.type for line in scene.lines} == {1}  # LINE_LOOP
    straight = decode_foxglove(make_lane_scene(make_lane(points[:2], 0.3, closed=False)))
    assert {line.type for line in straight.entities[0].lines} == {0}  # LINE_STRIP


def test_parameters_are_flat_and_cannot_be_set():
    flat = make_parameters({"car": {"lf": 0.1}, "record": {"required": True}, "name": "x"})
    assert flat == {"car.lf": 0.1, "record.required": 1.0, "name": "x"}
    known = ReadOnlyParameters(flat)
    asked = [SimpleNamespace(name="car.lf"), SimpleNamespace(name="unknown")]
    (kept,) = known.on_set_parameters(None, asked)
    assert (kept.name, kept.get_value()) == ("car.lf", 0.1)
    assert len(known.on_get_parameters(None, [])) == 3


def test_the_job_holds_the_lane_and_the_car_file_and_is_json():
    options = RunOptions(str(default_car_path()), path="circle:radius=2", view="9000")
    job = json.loads(json.dumps(make_view_job(make_plan(options))))
    assert (job["host"], job["port"], job["closed"]) == ("127.0.0.1", 9000, True)
    assert [hypot(x, y - 2.0) for x, y, _ in job["lane"]] == pytest.approx([2.0] * len(job["lane"]))
    assert 200 < len(job["lane"]) < 400  # 12.6 m in steps of about 5 cm
    assert make_parameters(job["parameters"])["car.lf"] == job["body"]["lf"]


def test_a_viewer_counts_what_the_pipe_dropped():
    read_fd, write_fd = make_pipe()
    sent = []
    box = Outbox(0, (lambda records, t_ns: sent.extend(records),))
    for tick in range(5):
        box.post(topics.STATE, make_state(seq=tick), tick)
        box.flush(tick)
    kept = [record for record in sent if record.sequence not in (1, 2)]
    PipeWriter(write_fd).write([pack_record(record) for record in kept], 0)
    os.close(write_fd)
    viewer = Viewer("car1", BODY, make_lane([(0.0, 0.0, 0.0), (1.0, 0.0, 0.0)], 0.3, closed=False))
    run_viewer(viewer, read_fd)
    os.close(read_fd)
    assert viewer.missed == 2


def test_a_viewer_that_is_gone_or_full_costs_the_core_one_write():
    record = next(unpack_records(bytearray(pack_record(first_record()))))
    read_fd, write_fd = make_pipe()
    pipe = PipeWriter(write_fd)
    for tick in range(20_000):
        pipe.write([pack_record(record)], tick)
    assert pipe.dropped > 0
    assert not pipe.dead
    os.close(read_fd)
    pipe.write([pack_record(record)], 20_001)
    pipe.write([pack_record(record)], 20_002)
    os.close(write_fd)
    assert pipe.dead


def first_record():
    sent = []
    box = Outbox(0, (lambda records, t_ns: sent.extend(records),))
    box.post(topics.STATE, make_state(), 0)
    box.flush(0)
    return sent[0]


def test_every_topic_has_a_channel_with_its_schema():
    import foxglove  # noqa: TID251

    context = foxglove.Context()
    for topic in topics.TOPICS:
        channel = make_channel("blue", topic, context)
        assert channel.topic() == f"/steerd/blue/{topic.name}"
        assert channel.message_encoding == "cdr"
        schema = channel.schema()
        assert schema.encoding == "ros2msg"
        assert b"std_msgs/Header" in schema.data or topic is topics.LOG


@pytest.mark.parametrize(
    ("text", "host", "port"),
    [("8765", "127.0.0.1", 8765), ("localhost:1", "localhost", 1), ("[::1]:80", "::1", 80)],
)
def test_addresses(text, host, port):
    assert parse_view(text, insecure_lan=False) == (host, port)


@pytest.mark.parametrize("text", ["", "x", "0", "65536", "127.0.0.1:", "0.0.0.0:8765", "lab:8765"])
def test_addresses_that_are_none_or_not_private(text):
    with pytest.raises(SteerdError):
        parse_view(text, insecure_lan=False)


def test_others_may_look_on_if_that_is_meant():
    assert parse_view("0.0.0.0:8765", insecure_lan=True) == ("0.0.0.0", 8765)


def test_virtual_time_is_not_shown_live(capsys):
    assert run_cli(["run", "--sim", "--fast", "--view"]) == 2
    assert "steerd plot" in capsys.readouterr().err


def test_a_missing_package_is_one_line_with_its_mend(capsys, monkeypatch):
    monkeypatch.setattr("steerd.daemon.process.view_job.find_spec", lambda name: None)
    assert run_cli(["run", "--sim", "--view"]) == 3
    said = capsys.readouterr().err
    assert "foxglove-sdk" in said
    assert "pip install" in said
    assert len(said.splitlines()) == 2
