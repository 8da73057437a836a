"""The Foxglove view with a client of another make: what it sees, what it sets, its death."""

import asyncio
import base64
import contextlib
import json
import os
import signal
import struct
from functools import partial

import pytest
import websockets  # noqa: TID251
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from steerd.daemon.loop.transitions import SupervisorState
from steerd.steer_bus import messages as m
from steerd.steer_bus.session_read import open_session
from tests.e2e.conftest import changes, replays
from tests.e2e.test_live import Watcher, start_run
from tests.safety.live import free_port

pytestmark = [pytest.mark.realtime, pytest.mark.timeout(240)]
WANTED = ("/steerd/car1/state", "/steerd/car1/odom", "/scene", "/tf")
LATE_MODES = (SupervisorState.FAULT_STOP, SupervisorState.FAULT_LATCHED, SupervisorState.ESTOP)

PROTOCOLS = [websockets.Subprotocol("foxglove.sdk.v1")]
join = partial(websockets.connect, subprotocols=PROTOCOLS, max_size=None)


async def look(url, seconds, **headers):
    """What a client sees: server info, channels, messages by topic, parameters."""
    received, heard = {}, {topic: [] for topic in WANTED}
    async with join(url, **headers) as client:
        async with asyncio.timeout(seconds):
            while not all(heard.values()) or "parameterValues" not in received:
                frame = await client.recv()
                if isinstance(frame, bytes):
                    number, at_ns = struct.unpack_from("<IQ", frame, 1)
                    heard[WANTED[number]].append((at_ns, frame[13:]))
                    continue
                said = json.loads(frame)
                received[said["op"]] = said
                if said["op"] == "advertise":
                    await subscribe(client, said["channels"])
    return received, heard


async def subscribe(client, channels):
    ids = {c["topic"]: c["id"] for c in channels}
    wanted = [{"id": n, "channelId": ids[topic]} for n, topic in enumerate(WANTED)]
    await client.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))
    request = {"op": "getParameters", "parameterNames": ["car.lf", "run.path"], "id": "1"}
    await client.send(json.dumps(request))


def decode_ros(channel, payload):
    """By rosbags, from the schema that was advertised."""
    store = get_typestore(Stores.EMPTY)
    name = channel["schemaName"]
    store.register(get_types_from_msg(channel["schema"], name))
    return store.deserialize_cdr(payload, name)


def test_a_client_sees_the_drive_and_the_viewers_death_changes_nothing(steerd, tmp_path):
    port, record = free_port(), tmp_path / "drive.mcap"
    run = steerd(
        "run", "--sim", "--auto-arm", "--path", "circle:radius=2", "--duration", "4",
        "--view", port, "--listen", steerd.endpoint, "--record", record,
    )  # fmt: skip
    url = run.expect(rf"view: (ws://127.0.0.1:{port}/\S+)")[1]
    run.expect("RUNNING")
    for guess in (url[: url.index("/", 5 + 8)], url[:-4], url + "live"):
        with pytest.raises(websockets.InvalidStatus, match="404"):
            asyncio.run(look(guess, 5.0))
    for origin in ("http://evil.example", "null", None):
        with pytest.raises(websockets.InvalidStatus, match="404"):
            asyncio.run(look(f"ws://127.0.0.1:{port}", 5.0, origin=origin))
    received, heard = asyncio.run(look(url, 20.0))
    channels = {c["topic"]: c for c in received["advertise"]["channels"]}
    state = decode_ros(channels[WANTED[0]], heard[WANTED[0]][-1][1])
    assert state.mode == SupervisorState.RUNNING
    odom = decode_ros(channels[WANTED[1]], heard[WANTED[1]][-1][1])
    assert odom.child_frame_id == m.BODY
    assert odom.pose.pose.position.x == pytest.approx(state.x, abs=0.2)
    assert base64.b64decode(channels["/scene"]["schema"])
    values = {p["name"]: p["value"] for p in received["parameterValues"]["parameters"]}
    assert values == {"car.lf": 0.15875, "run.path": "circle:radius=2"}
    assert received["serverInfo"]["capabilities"] == ["parameters", "parametersSubscribe"]

    os.kill(run.child("steerd.daemon.process.view\0"), signal.SIGKILL)
    assert run.wait() == 0, run.text
    assert "the viewer ended with code -9" in run.text
    table = open_session(record).columns(m.StateMessage)
    assert not set(table["mode"]) & set(LATE_MODES)
    recorded = {c.to_state for c in changes(record)}
    assert SupervisorState.RUNNING in recorded


# Live parameters set from Foxglove, then replayed.
async def set_in_foxglove(url, name, value):
    """What a viewer does to set a parameter; the value that the car confirms."""
    async with join(url) as client:
        await client.send(json.dumps({"op": "subscribeParameterUpdates", "parameterNames": [name]}))
        wanted = {"op": "setParameters", "parameters": [{"name": name, "value": value}]}
        await client.send(json.dumps(wanted))
        async with asyncio.timeout(20.0):
            while True:
                frame = await client.recv()
                said = {} if isinstance(frame, bytes) else json.loads(frame)
                for each in said.get("parameters", []):
                    if each["name"] == name and each.get("value") == value:
                        return said


def test_from_foxglove_where_the_run_allows_it(steerd, tmp_path, capsys):
    port = free_port()
    options = ("--sim", "--auto-arm", "--view", port, "--view-sets")
    run, record = start_run(steerd, tmp_path, *options)
    run.expect("RUNNING")
    with contextlib.closing(Watcher(steerd.endpoint)) as watcher:
        watcher.driving(run, 2.0)
        url = run.expect(r"view: (\S+)")[1]
        assert asyncio.run(set_in_foxglove(url, "live.speed", 0.5))
        assert watcher.driving(run, 2.0).speed == pytest.approx(0.5, abs=0.05)
    assert run.interrupt() == 0, run.text
    assert replays(record, capsys)
    said = [r.decode() for r in open_session(record).messages("/steerd/car1/parameters")]
    answers = {(p.lease_id, p.seq): p for p in said if p.lease_id}.values()
    assert [(p.accepted, p.speed, p.offset, p.gain) for p in answers] == [(True, 0.5, 0.0, 1.0)]
    assert "set by viewer" in {p.text for p in said}
