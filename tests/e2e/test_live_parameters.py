"""Live parameters over the wire: from the page, from `watch` and from Foxglove, then replayed."""

import asyncio
import contextlib
import json
import signal

import pytest
import websockets  # noqa: TID251

from steerd.daemon.cli.main import run_cli
from steerd.daemon.loop.transitions import SupervisorState
from steerd.steer_bus.session_read import open_session
from tests.e2e.conftest import free_port
from tests.e2e.test_live import Keyboard, Watcher, start_run
from tests.e2e.test_live_page import live, until

IN_A_TERMINAL = (
    "-c", "import pty, sys; pty.spawn([sys.executable, '-m', 'steerd', *sys.argv[1:]])"
)  # fmt: skip
"""Starts a command whose output is a terminal too."""
EVIL = "http://evil.example"
"""Where a page of somebody else comes from."""
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


def test_from_the_page_and_back_in_a_replay(steerd, tmp_path, capsys):
    run, record = start_run(steerd, tmp_path, "--sim", "--auto-arm", "--page")
    address = run.expect(r"page: (\S+)")[1]
    with contextlib.closing(Watcher(steerd.endpoint)) as watcher, live(address) as socket:
        watcher.driving(run, 2.5)
        for wanted in ("set speed 0.6", "set offset 0.05", "set speed 3"):
            socket.send(wanted)
        seen = until(socket, lambda seen: seen["live"] and seen["live"]["refused"])
        assert "speed 3 m/s, allowed 0.3 to 1 m/s" in seen["live"]["text"]
        slow = watcher.driving(run, 3.0)
        assert slow.speed == pytest.approx(0.6, abs=0.05)
        assert abs(slow.e1) < 0.03
    end_and_replay(run, record, capsys)
    assert [answer[:3] for answer in answers(record)] == [
        (True, 0.6, 0.0), (True, 0.6, 0.05), (False, 0.6, 0.05)
    ]  # fmt: skip


async def set_in_foxglove(url, name, value, **headers):
    """What a viewer does to set a parameter; the value that the car confirms."""
    protocol = [websockets.Subprotocol("foxglove.sdk.v1")]
    async with websockets.connect(url, subprotocols=protocol, max_size=None, **headers) as client:
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
        stranger = set_in_foxglove(f"ws://127.0.0.1:{port}", "live.speed", 0.3, origin=EVIL)
        with pytest.raises(websockets.InvalidStatus, match="404"):
            asyncio.run(stranger)
        assert asyncio.run(set_in_foxglove(url, "live.speed", 0.5))
        assert watcher.driving(run, 2.0).speed == pytest.approx(0.5, abs=0.05)
    end_and_replay(run, record, capsys)
    assert answers(record) == [(True, 0.5, 0.0, 1.0)]
    said = open_session(record).messages("/steerd/car1/parameters")
    assert "set by viewer" in {r.decode().text for r in said}


def test_from_watch_by_its_keys(steerd, tmp_path, capsys):
    run, record = start_run(steerd, tmp_path, "--sim", "--auto-arm")
    run.expect("RUNNING")
    with (
        contextlib.closing(Watcher(steerd.endpoint)) as watcher,
        contextlib.closing(Keyboard()) as keys,
    ):
        watcher.driving(run, 2.0)
        at = ("watch", "--connect", steerd.endpoint, "--seconds", "30")
        watch = steerd(*at, module=IN_A_TERMINAL, stdin=keys.theirs)
        watch.expect("speed up to 1.00 m/s")
        keys.press("--")
        watch.expect("speed up to 0.80 m/s")
        keys.press("+++")
        watch.expect("refused: speed 1.1 m/s")
        assert watcher.driving(run, 0.5).mode == SupervisorState.RUNNING
    end_and_replay(run, record, capsys)
    assert [speed for _, speed, _, _ in answers(record)] == [0.9, 0.8, 0.9, 1.0, 1.0]
