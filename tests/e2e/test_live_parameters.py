"""Live parameters over the wire: from the page, from `watch` and from Foxglove, then replayed."""

import asyncio
import contextlib
import json
import signal

import pytest
import websockets  # noqa: TID251

from steerd.daemon.cli.main import run_cli
from steerd.steer_bus.session_read import open_session
from tests.e2e.conftest import free_port
from tests.e2e.test_live import Watcher, start_run

pytestmark = [pytest.mark.realtime, pytest.mark.timeout(240)]


def answers(session):
    """Every answer to a request, in order: accepted, speed, offset, gain."""
    said = [r.decode() for r in open_session(session).messages("/steerd/car1/parameters")]
    by_request = {(p.lease_id, p.seq): p for p in said if p.lease_id}
    return [(bool(p.accepted), p.speed, p.offset, p.gain) for p in by_request.values()]


def end_and_replay(run, record, capsys):
    """End the run; its replay must give every order again."""
    run.send(signal.SIGINT)
    assert run.wait() == 0, run.text
    capsys.readouterr()
    assert run_cli(["replay", str(record)]) == 0
    assert "all equal the recorded ones" in capsys.readouterr().out


async def set_in_foxglove(url, name, value):
    """What a viewer does to set a parameter; the value that the car confirms."""
    protocol = [websockets.Subprotocol("foxglove.sdk.v1")]
    async with websockets.connect(url, subprotocols=protocol, max_size=None) as client:
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
    end_and_replay(run, record, capsys)
    assert answers(record) == [(True, 0.5, 0.0, 1.0)]
    said = open_session(record).messages("/steerd/car1/parameters")
    assert "set by viewer" in {r.decode().text for r in said}
