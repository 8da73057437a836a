"""The viewer's scene, decoded by protobuf from the schema that is sent."""

from math import atan2, hypot, pi

import pytest
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

from steerd.daemon.process.view_scene import (
    Body,
    make_car_scene,
    make_lane,
    make_lane_scene,
    make_transform,
)
from steerd.steer_bus import messages as m
from tests.blank import NOW_NS, blank

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


def yaw_of(turn):
    return 2.0 * atan2(turn.z, turn.w)


def test_the_transform_puts_the_body_where_the_estimate_is():
    sent = decode_foxglove(make_transform(blank(m.StateMessage, x=1.5, y=-2.0, yaw=0.75 * pi)))
    (frame,) = sent.transforms
    assert (frame.parent_frame_id, frame.child_frame_id) == (m.WORLD, m.BODY)
    assert (frame.translation.x, frame.translation.y) == (1.5, -2.0)
    assert yaw_of(frame.rotation) == pytest.approx(0.75 * pi)
    assert frame.timestamp.ToNanoseconds() == NOW_NS


def test_the_car_has_its_axles_and_steers_in_front_only():
    state = blank(m.StateMessage, steer=0.3, speed=2.0, slip_angle=-0.05)
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
