"""The viewer: what is drawn, what is advertised, what is refused. Decoded by protobuf itself."""

import asyncio
import json
import os
from dataclasses import fields
from math import nan
from types import SimpleNamespace

import pytest

from steerd.daemon.ipc.live_setting import parse_setting
from steerd.daemon.ipc.outbox import Outbox
from steerd.daemon.ipc.pipe_records import PipeWriter, make_pipe, pack_record
from steerd.daemon.process.view import Viewer, make_channels
from steerd.daemon.process.view_scene import (
    Body,
    make_lane,
    make_learnt_parameters,
    make_parameters,
)
from steerd.daemon.process.view_server import ViewParameters, ViewServer
from steerd.steer_bus import messages as m
from steerd.steer_bus import topics
from tests.blank import blank

BODY = Body(0.16, 0.17, 0.27)


def test_parameters_are_flat_and_cannot_be_set():
    flat = make_parameters({"car": {"lf": 0.1}, "record": {"required": True}, "name": "x"})
    assert flat == {"car.lf": 0.1, "record.required": 1.0, "name": "x"}
    known = ViewParameters(flat)
    assert known.set({"car.lf": 9.0, "unknown": 1.0}) == {"car.lf": 0.1}
    assert known.get([]) == flat


def test_a_live_parameter_is_asked_for_and_keeps_its_value_until_the_car_changes_it():
    asked = []
    known = ViewParameters({"live.speed": 1.5, "car.lf": 0.1}, asked.append)
    assert known.set({"live.speed": 1.25}) == {"live.speed": 1.5}
    known.set({"car.lf": 9.0, "live.mass": 9.0, "live.gain": True, "live.offset": -1})
    known.set({"live.gain": "2"})
    assert asked == ["set speed 1.25", "set offset -1.0"]
    assert [parse_setting(text) for text in asked] == [{"speed": 1.25}, {"offset": -1.0}]
    changed = known.take({"live.speed": 1.25, "live.gain": 1.0})
    assert changed == {"live.speed": 1.25, "live.gain": 1.0}
    assert known.take({"live.speed": 1.25}) == {}


def test_without_leave_of_the_run_nothing_is_asked_for():
    known = ViewParameters({"live.speed": 1.5})
    assert known.set({"live.speed": 1.25}) == {"live.speed": 1.5}


def test_what_was_learnt_is_shown_with_its_standard_deviation_once_it_is_new():
    blank = {f.name: nan for f in fields(m.Model)}
    rows = [["steer_gain", 0.88, 0.002, "1", True], ["lf", 0.16, None, "m", False]]
    told = {"verdict": "named", "effect": "steer_gain"}
    told["details"] = json.dumps({"values": rows, "changes": []})
    shown = make_learnt_parameters(SimpleNamespace(**blank | told))
    assert shown["model.steer_gain"] == 0.88
    assert shown["model.steer_gain_sd"] == 0.002
    assert shown["model.steer_gain_identifiable"] == "yes"
    assert shown["model.lf_identifiable"] == "no"
    assert "model.lf_sd" not in shown
    known = ViewParameters({})
    assert known.take(shown) == shown
    assert known.take(shown) == {}


def test_a_viewer_counts_what_the_pipe_dropped():
    read_fd, write_fd = make_pipe()
    sent = []
    box = Outbox(0, (lambda records, t_ns: sent.extend(records),))
    for tick in range(5):
        box.post(topics.STATE, blank(m.StateMessage, seq=tick), tick)
        box.flush(tick)
    kept = [record for record in sent if record.sequence not in (1, 2)]
    PipeWriter(write_fd).write([pack_record(record) for record in kept], 0)
    os.close(write_fd)
    lane = make_lane([(0.0, 0.0, 0.0), (1.0, 0.0, 0.0)], 0.3, closed=False)
    server = ViewServer("x", make_channels("car1"), ViewParameters({}))
    viewer = Viewer("car1", BODY, lane, server)
    while data := os.read(read_fd, 1000):
        viewer.read(data)
    os.close(read_fd)
    assert viewer.missed == 2


def test_every_topic_has_a_channel_with_its_schema():
    channels = {channel.topic: channel for channel in make_channels("blue")}
    for topic in topics.TOPICS:
        channel = channels[f"/steerd/blue/{topic.name}"] if topic.on_bus else None
        if channel is not None:
            assert (channel.encoding, channel.schema_encoding) == ("cdr", "ros2msg")
            assert "std_msgs/Header" in channel.schema or topic is topics.LOG
    assert len(channels) == sum(topic.on_bus for topic in topics.TOPICS) + 2


class Client:
    """A client that says these words and is gone; keeps what it was sent."""

    def __init__(self, *words):
        self._words, self.sent = list(words), []

    async def send(self, message):
        self.sent.append(message)

    def __aiter__(self):
        return self

    async def __anext__(self):
        await asyncio.sleep(0)
        if not self._words:
            raise StopAsyncIteration
        return self._words.pop(0)


@pytest.mark.parametrize(
    "words",
    [
        "", "{", "[]", "7", "null", b"\0\xff", "[" * 50_000, '{"op": 5}', '{"op": "subscribe"}',
        '{"op": "subscribe", "subscriptions": [{"id": {}, "channelId": "x"}]}',
        '{"op": "unsubscribe", "subscriptionIds": [[]]}',
        '{"op": "setParameters", "parameters": [{"name": [], "value": 1e999}, 3]}',
        '{"op": "subscribeParameterUpdates", "parameterNames": 3}',
    ],
)  # fmt: skip
def test_no_word_of_a_client_ends_its_connection(words):
    asked = '{"op": "getParameters", "parameterNames": ["a", "b"], "id": "1"}'
    client = Client(words, asked, *["{}"] * 9)
    server = ViewServer("x", make_channels("car1"), ViewParameters({"a": 1.5, "b": nan}))
    asyncio.run(server.talk(client))
    said = [json.loads(text) for text in client.sent]
    assert [each["op"] for each in said[:2]] == ["serverInfo", "advertise"]
    assert said[-1]["parameters"] == [{"name": "a", "value": 1.5, "type": "float64"}]
    assert said[-1]["id"] == "1"
