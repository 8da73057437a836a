"""A stop arrives: under a flood of garbage, under garbled status, with the holder frozen.

Real processes on a pty, a stranger's process that floods the bus, and the byte log of the wire.
Nothing but the outside world is changed.
"""

import contextlib
import select
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from websockets.sync.client import connect  # noqa: TID251

from steerd.daemon.loop.transitions import SupervisorState
from steerd.daemon.process.bus_operator import Operator
from steerd.steer_bus import topics
from steerd.steer_bus.messages import RequestKind
from steerd.steer_bus.topics import make_key
from steerd.steer_bus.zenoh_bus import Profile, ZenohBus
from tests.e2e.conftest import Program
from tests.safety.judge import find_stop
from tests.safety.live import BOOT_ID, CLOCK, LEASE_ID, Live, start_live

pytestmark = [pytest.mark.realtime, pytest.mark.timeout(240)]
FLOOD = Path(__file__).parent / "flood.py"
RATE, BOUND_S = 40_000, 0.2
REQUESTS = ["steerd/car1/cmd/operator", "steerd/car1/cmd/stop", "steerd/car1/cmd/parameters"]
STATUS = ["steerd/car1/diagnostics", "steerd/car1/transition", "steerd/car1/state"]


@contextlib.contextmanager
def flood(live: Live, keys: list[str]) -> Iterator[None]:
    """40 000 messages a second of garbage under these keys, by a process that stands aside."""
    command = ["nice", sys.executable, str(FLOOD), live.listen, str(RATE), *keys]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    with subprocess.Popen(command, text=True, **pipes) as process:
        live.until(lambda: bool(select.select([process.stdout], [], [], 0.0)[0]))
        assert process.stdout.readline() == "flooding\n"
        try:
            yield
        finally:
            process.stdin.close()
            print("flooded with", process.stdout.read().strip(), "a second")


@contextlib.contextmanager
def page(live: Live) -> Iterator[str]:
    """`steerd page` beside the car: where its WebSocket is; the car is held until it opens."""
    with contextlib.closing(Program("page", "--connect", live.listen)) as program:
        live.until(lambda: not program.pump(0.0) or "http:" in program.text)
        yield "ws:" + program.expect(r"http:(\S+)\s")[1] + "live"


def brake_bytes(live: Live, since_ns: int) -> float:
    """Seconds until the first brake bytes, once the car is stopped."""
    live.until(lambda: live.state is SupervisorState.ESTOP, 10.0)
    live.live(0.1)
    stop = find_stop(live.frames(), since_ns)
    assert stop is not None
    return (stop.t_ns - since_ns) * 1e-9


@pytest.mark.parametrize("keys", [REQUESTS, STATUS], ids=["requests", "status"])
def test_the_page_s_stop_button_brakes_within_200_ms(tmp_path, keys):
    """The page opens in the flood: of the status it has hardly heard anything true."""
    with start_live(tmp_path) as live:
        live.reach("P5")
        with flood(live, keys), page(live) as address:
            origin = address.replace("ws:", "http:")
            with connect(address, origin=origin[: origin.index("/", 8)], max_queue=None) as socket:
                assert live.state is SupervisorState.RUNNING, live.transitions
                now_ns = CLOCK.now_ns()
                socket.send("estop")
                live.alive = False  # the holder's terminal is frozen in this very moment
                took = brake_bytes(live, now_ns)
        print(f"brake bytes after {took * 1e3:.1f} ms")
        assert took <= BOUND_S
        assert "emergency stop called" in live.transitions[-1][2]


@pytest.mark.parametrize("name", ["stop", "estop"])
@pytest.mark.parametrize("keys", [REQUESTS, STATUS], ids=["requests", "status"])
def test_the_command_stops_and_says_so(tmp_path, keys, name):
    with start_live(tmp_path) as live:
        live.reach("P5")
        with flood(live, keys):
            live.live(0.5)
            with contextlib.closing(Program(name, "--connect", live.listen)) as program:
                live.until(lambda: program.process.poll() is not None, 20.0)
                assert program.wait() == 0, program.text
        assert live.state is not SupervisorState.RUNNING


def test_nobody_s_keepalives_but_the_holder_s_keep_the_car_driving(tmp_path):
    """What is known of the holder is known to everybody: its name in the status, and the run's."""
    thief = Operator(BOOT_ID, LEASE_ID, "terminal", seq=2_000_000_000)
    with start_live(tmp_path) as live, ZenohBus(Profile(False, live.listen)) as bus:
        live.reach("P5")
        key = make_key("car1", topics.OPERATOR)

        def steal() -> bool:
            bus.publish(key, thief.make_request(RequestKind.KEEPALIVE, CLOCK.realtime_ns()))
            return live.state is not SupervisorState.RUNNING

        live.alive = False
        live.until(steal, 3.0)
        assert "lease" in live.transitions[-1][2]
