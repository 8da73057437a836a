"""The viewer: what is drawn, what is advertised, what is refused. Decoded by protobuf itself."""

import asyncio
import json
from dataclasses import fields
from math import atan2, hypot, nan, pi
from types import SimpleNamespace

import pytest
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

from steerd.car_model.car_file import default_car_path
from steerd.car_model.params import DEFAULT_CAR
from steerd.daemon.assembly.build import make_job, make_plan, read_job
from steerd.daemon.common.errors import SteerdError
from steerd.daemon.ipc.requests import parse_setting
from steerd.daemon.process import view
from steerd.daemon.process.view_job import draw_plan, parse_view
from steerd.daemon.process.view_server import ViewServer
from steerd.daemon.settings.run_options import RunOptions
from steerd.steer_bus import messages as m
from steerd.steer_bus import topics
from tests.blank import NOW_NS, blank

CAR = DEFAULT_CAR._replace(lf=0.16, lr=0.17)


def test_a_live_parameter_is_asked_for_until_the_car_changes_it_and_others_cannot_be_set():
    asked = []
    known = ViewServer("x", [], {"live.speed": 1.5, "car.lf": 0.1}, asked.append)
    assert known.set({"live.speed": 1.25}) == {"live.speed": 1.5}
    known.set({"car.lf": 9.0, "live.mass": 9.0, "live.gain": True, "live.offset": -1})
    known.set({"live.gain": "2"})
    assert asked == [b"set speed 1.25", b"set offset -1.0"]
    assert [parse_setting(text.decode()) for text in asked] == [{"speed": 1.25}, {"offset": -1.0}]
    changed = known.show({"live.speed": 1.25, "live.gain": 1.0})
    assert changed == {"live.speed": 1.25, "live.gain": 1.0}
    assert known.show({"live.speed": 1.25}) == {}
    unasked = ViewServer("x", [], {"live.speed": 1.5})
    assert unasked.set({"live.speed": 1.25}) == {"live.speed": 1.5}, "without leave of the run"
    flat = view.make_parameters({"car": {"lf": 0.1}, "record": {"required": True}, "name": "x"})
    assert flat == {"car.lf": 0.1, "record.required": 1.0, "name": "x"}
    known = ViewServer("x", [], flat)
    assert known.set({"car.lf": 9.0, "unknown": 1.0}) == {"car.lf": 0.1}
    assert known.get([]) == flat


def test_what_was_learnt_is_shown_with_its_standard_deviation_once_it_is_new():
    blank = {f.name: nan for f in fields(m.Model)}
    rows = [["steer_gain", 0.88, 0.002, "1", True], ["lf", 0.16, None, "m", False]]
    told = {"verdict": "named", "effect": "steer_gain"}
    told["details"] = json.dumps({"values": rows, "changes": []})
    shown = view.make_learnt_parameters(SimpleNamespace(**blank | told))
    gain = [shown[f"model.steer_gain{part}"] for part in ("", "_sd", "_identifiable")]
    assert gain == [0.88, 0.002, "yes"]
    assert shown["model.lf_identifiable"] == "no"
    assert "model.lf_sd" not in shown
    known = ViewServer("x", [], {})
    assert known.show(shown) == shown
    assert known.show(shown) == {}


def test_every_topic_has_a_channel_with_its_schema():
    channels = {channel["topic"]: channel for channel in view.make_channels("blue")}
    shown = [topic for topic in topics.TOPICS if topic.on_bus]
    for topic in shown:
        channel = channels[f"/steerd/blue/{topic.name}"]
        assert (channel["encoding"], channel["schemaEncoding"]) == ("cdr", "ros2msg")
        assert "std_msgs/Header" in channel["schema"] or topic is topics.LOG
    assert len(channels) == len(shown) + 2


class Client:
    """A client that says these words and is gone; keeps what it was sent."""

    def __init__(self, *words):
        self._words, self.sent = words, []

    async def send(self, message):
        self.sent.append(message)

    async def __aiter__(self):
        for word in self._words:
            await asyncio.sleep(0)
            yield word


@pytest.mark.parametrize("words", [
    "", "{", "[]", "7", "null", b"\0\xff", "[" * 50_000, '{"op": 5}', '{"op": "subscribe"}',
    '{"op": "subscribe", "subscriptions": [{"id": {}, "channelId": "x"}]}',
    '{"op": "unsubscribe", "subscriptionIds": [[]]}',
    '{"op": "setParameters", "parameters": [{"name": [], "value": 1e999}, 3]}',
    '{"op": "subscribeParameterUpdates", "parameterNames": 3}',
])  # fmt: skip
def test_no_word_of_a_client_ends_its_connection(words):
    asked = '{"op": "getParameters", "parameterNames": ["a", "b"], "id": "1"}'
    client = Client(words, asked, *["{}"] * 9)
    server = ViewServer("x", view.make_channels("car1"), {"a": 1.5, "b": nan})
    asyncio.run(server.talk(client))
    said = [json.loads(text) for text in client.sent]
    assert [each["op"] for each in said[:2]] == ["serverInfo", "advertise"]
    assert said[-1]["parameters"] == [{"name": "a", "value": 1.5, "type": "float64"}]
    assert said[-1]["id"] == "1"


def test_the_job_holds_the_lane_and_the_car_file_and_is_json():
    options = RunOptions(str(default_car_path()), path="circle:radius=2", view="9000")
    plan = read_job(json.loads(json.dumps(make_job(make_plan(options)))))
    job = draw_plan(plan)
    assert job["closed"]
    assert [hypot(x, y - 2.0) for x, y, _ in job["lane"]] == pytest.approx([2.0] * len(job["lane"]))
    assert 200 < len(job["lane"]) < 400  # 12.6 m in steps of about 5 cm
    assert view.list_values(plan)["car.lf"] == job["body"]["lf"]


@pytest.mark.parametrize("text", ["", "x", "0", "65536", "127.0.0.1:", "0.0.0.0:8765", "lab:8765"])
def test_good_addresses_are_taken_invalid_refused_and_public_ones_without_insecure_lan(text):
    with pytest.raises(SteerdError):
        parse_view(text, insecure_lan=False)
    assert parse_view("0.0.0.0:8765", insecure_lan=True) == ("0.0.0.0", 8765)
    good = {"8765": ("127.0.0.1", 8765), "localhost:1": ("localhost", 1), "[::1]:80": ("::1", 80)}
    assert {words: parse_view(words, insecure_lan=False) for words in good} == good


def test_a_missing_package_is_one_line_with_its_remedy(cli, monkeypatch):
    monkeypatch.setattr("steerd.daemon.process.view_job.find_spec", lambda name: None)
    said = cli("run", "--sim", "--view", code=3).err
    assert "foxglove-sdk" in said
    assert "pip install" in said
    assert len(said.splitlines()) == 2


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
    sent = decode_foxglove(view.make_transform(blank(m.StateMessage, x=1.5, y=-2.0, yaw=0.75 * pi)))
    (frame,) = sent.transforms
    assert (frame.parent_frame_id, frame.child_frame_id) == (m.WORLD, m.BODY)
    assert (frame.translation.x, frame.translation.y) == (1.5, -2.0)
    assert yaw_of(frame.rotation) == pytest.approx(0.75 * pi)
    assert frame.timestamp.ToNanoseconds() == NOW_NS


def test_the_car_has_its_axles_and_steers_in_front_only():
    state = blank(m.StateMessage, steer=0.3, speed=2.0, slip_angle=-0.05)
    (car,) = decode_foxglove(view.make_car_scene(state, CAR)).entities
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
    (scene,) = decode_foxglove(view.make_lane_scene(points, 0.3, closed=True)).entities
    assert scene.frame_id == m.WORLD
    for line, radius in zip(scene.lines, (2.0, 1.7, 2.3), strict=True):  # path, left, right
        assert [hypot(p.x, p.y) for p in line.points] == pytest.approx([radius] * 3)
    assert {line.type for line in scene.lines} == {1}  # LINE_LOOP
    straight = decode_foxglove(view.make_lane_scene(points[:2], 0.3, closed=False))
    assert {line.type for line in straight.entities[0].lines} == {0}  # LINE_STRIP
