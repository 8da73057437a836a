"""Two processes beside a soak: one that sends nonsense everywhere, one that stops the car for real.

    python -m benchmarks.soak_strangers fuzz ENDPOINT PAGE VIEW SECONDS SEED
    python -m benchmarks.soak_strangers stops ENDPOINT PAGE SECONDS EVERY

`soak.py --fuzz` starts both. The first sends 1000 messages a second under every key of the car, to
the page and to the viewer, whose secrets it knows. What would be a stop by right is left out:
a stop, and a request of no known kind, are obeyed from anybody. The second operates the car: it
arms and starts it, and every minute stops it, by the bus and by the page in turn, and prints as
JSON what it did and when.
"""

import contextlib
import itertools
import json
import select
import socket
import sys
import time
from typing import Any

import numpy as np
from websockets.exceptions import WebSocketException
from websockets.sync.client import ClientConnection, connect

from steerd.daemon.loop.transitions import SupervisorState
from steerd.daemon.process.bus_operator import BusOperator, CarView
from steerd.steer_bus.clock import MonotonicClock
from steerd.steer_bus.codec import CodecError, decode, encode
from steerd.steer_bus.messages import BODY, OperatorRequest, RequestKind, make_header
from steerd.steer_bus.topics import TOPICS, make_key
from steerd.steer_bus.zenoh_bus import Profile, ZenohBus

CAR, RATE, PAUSE_S = "car1", 1000.0, 0.002
HARMLESS = (RequestKind.ARM, RequestKind.START, RequestKind.CLEAR, RequestKind.KEEPALIVE)
AGAIN_NS = 500_000_000
"""Between two requests of the same kind."""
NEXT = {
    SupervisorState.READY: RequestKind.ARM,
    SupervisorState.ARMED: RequestKind.START,
    SupervisorState.ESTOP: RequestKind.CLEAR,
    SupervisorState.FAULT_LATCHED: RequestKind.CLEAR,
}
ODD = [b"\0", b"stop it", b"set speed", b"set speed nan", b"{}", b"[" * 60, b"alive\xff"]
OPS = ("subscribe", "unsubscribe", "getParameters", "setParameters", "advertise", "")


def make_nonsense(chance: np.random.Generator) -> bytes:
    """Bytes, or a request with one changed byte, that is nobody's by right."""
    data = chance.bytes(int(chance.integers(200)))
    if chance.random() < 0.3:
        kind = int(chance.choice(HARMLESS))
        boot, lease = (int(n) for n in chance.integers(1 << 62, size=2))
        request = OperatorRequest(make_header(0, BODY), boot, lease, 1, kind, "nobody")
        spoilt = bytearray(encode(request))
        spoilt[int(chance.integers(len(spoilt)))] = int(chance.integers(256))
        data = bytes(spoilt)
    try:
        stops = decode(OperatorRequest, data).kind not in HARMLESS
    except CodecError:
        stops = False
    return b"" if stops else data


def make_words(chance: np.random.Generator) -> str:
    """A message for the viewer, seldom a whole one."""
    said: dict[str, Any] = {"op": str(chance.choice(OPS)), "id": "1", "parameterNames": [3]}
    said["subscriptions"] = [{"id": int(chance.integers(9)), "channelId": int(chance.integers(30))}]
    said["subscriptionIds"], said["parameters"] = [1, "x"], [{"name": "car.lf", "value": 9.0}]
    text = json.dumps(said)
    return text[: int(chance.integers(len(text)))] if chance.random() < 0.5 else text


class Talker:
    """A WebSocket that is opened again whenever the other side closes it, and that reads little."""

    def __init__(self, url: str, origin: str | None, protocols: list[Any] | None = None) -> None:
        self._url = url
        self._how: dict[str, Any] = {"origin": origin, "subprotocols": protocols}
        self._open = contextlib.ExitStack()
        self._socket: ClientConnection | None = None

    def say(self, words: str | bytes) -> None:
        """Send, and open it first where it is not."""
        with contextlib.suppress(WebSocketException, OSError, TimeoutError):
            if self._socket is None:
                opened = connect(self._url, max_queue=None, close_timeout=0.1, **self._how)
                self._socket = self._open.enter_context(opened)
            try:
                self._socket.send(words)
                while True:
                    self._socket.recv(0)
            except TimeoutError:
                return
            except WebSocketException:
                self._socket = None
                self._open.close()


def open_page(url: str) -> Talker:
    """The page's WebSocket, as its own script opens it."""
    return Talker(url.replace("http", "ws", 1) + "live", url[: url.index("/", 8)])


def knock(url: str, data: bytes) -> None:
    """Bytes that are no HTTP, on the port of an address."""
    host, port = url.split("/")[2].rsplit(":", 1)
    with contextlib.suppress(OSError), socket.create_connection((host, int(port)), 0.2) as other:
        other.sendall(data)


def fuzz(endpoint: str, page: str, view: str, seconds: float, seed: int) -> None:
    """Send nonsense until the time is over or standard input ends."""
    chance = np.random.default_rng(seed)
    keys = [make_key(CAR, topic, who) for topic in TOPICS for who in ("", "desk")]
    shown, viewer = open_page(page), Talker(view, None, ["foxglove.sdk.v1"])
    began, sent = time.monotonic(), 0
    with ZenohBus(Profile(False, endpoint)) as bus:
        while (t := time.monotonic() - began) < seconds:
            if select.select([sys.stdin], [], [], PAUSE_S)[0]:
                break
            for sent in range(sent + 1, round(t * RATE) + 1):  # noqa: B020
                data = make_nonsense(chance)
                if sent % 100 == 0:
                    knock(page if sent % 200 else view, data)
                elif sent % 7 == 0:
                    shown.say(str(chance.choice(ODD)) if sent % 2 else data)
                elif sent % 7 == 1:
                    viewer.say(make_words(chance) if sent % 2 else data)
                else:
                    bus.publish(str(chance.choice(keys)), data)
    print(json.dumps({"sent": sent, "seconds": time.monotonic() - began}), flush=True)


def stop_often(endpoint: str, page: str, seconds: float, every: float) -> None:
    """Operate the car and stop it again and again; prints each stop with its UNIX time [ns]."""
    clock, shown = MonotonicClock(), open_page(page)
    ways = itertools.cycle(
        itertools.product((RequestKind.STOP, RequestKind.ESTOP), ("bus", "page"))
    )
    began, stopped_ns, asked_ns = clock.now_ns(), clock.now_ns(), 0
    with ZenohBus(Profile(False, endpoint)) as bus:
        view = CarView(bus, CAR, clock)
        operator = BusOperator(bus, CAR, clock, "soak", view.pulse)
        while (now := clock.now_ns()) - began < seconds * 1e9:
            if select.select([sys.stdin], [], [], PAUSE_S)[0]:
                return
            view.poll()
            operator.repeat(view.mode)
            wanted = NEXT.get(view.mode) if view.mode is not None else None
            if wanted is not None and now - asked_ns > AGAIN_NS:
                asked_ns = now
                operator.ask(view.boot_id, wanted)
            if view.mode is SupervisorState.RUNNING and now - stopped_ns > every * 1e9:
                kind, way = next(ways)
                stopped_ns, sent_ns = now, clock.realtime_ns()
                if way == "bus":
                    operator.ask(view.boot_id, kind)
                else:
                    shown.say(kind.name.lower())
                print(json.dumps({"t_ns": sent_ns, "kind": kind.name, "way": way}), flush=True)


if __name__ == "__main__":
    what, *given = sys.argv[1:]
    if what == "fuzz":
        fuzz(given[0], given[1], given[2], float(given[3]), int(given[4]))
    else:
        stop_often(given[0], given[1], float(given[2]), float(given[3]))
