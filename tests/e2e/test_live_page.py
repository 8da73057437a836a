"""The live page: what it shows in a real browser, and whom it answers."""

import asyncio
import json
import math
import threading
import urllib.error
import urllib.request
from contextlib import contextmanager

import pytest
from websockets.exceptions import InvalidStatus  # noqa: TID251
from websockets.sync.client import connect  # noqa: TID251

from steerd.car_model.path.path_spec import parse_path
from steerd.controller.live import LiveBounds, LiveValues
from steerd.daemon.ipc.requests import make_badge
from steerd.daemon.loop.live import make_live, make_parameters, take_request
from steerd.daemon.loop.transitions import SupervisorState
from steerd.daemon.process.bus_operator import BusOperator, CarView
from steerd.daemon.process.page import NAME, make_page, pass_on, run_page, show_car
from steerd.daemon.process.view_job import make_lane_job
from steerd.steer_bus import messages as m
from steerd.steer_bus import topics
from steerd.steer_bus.clock import MonotonicClock
from steerd.steer_bus.codec import decode, encode
from steerd.steer_bus.messages import BODY, OperatorRequest, RequestKind, make_header
from steerd.steer_bus.topics import make_key
from tests.blank import status_message
from tests.browser import CHROMIUM, NO_BROWSER, browsing
from tests.local_bus import LocalBus, LocalHub

HEADER = make_header(0, BODY)
BOUNDS = LiveBounds(LiveValues(0.3, -0.15, 0.5), LiveValues(1.5, 0.15, 1.2), LiveValues(1.5, 0, 1))
NOBODYS = m.ParameterRequest(HEADER, 77, 0, 0, math.nan, math.nan, math.nan, "")
LANE = parse_path("figure8")


def a_state(level=0.0, **given):
    """A state whose numbers are all `level` but those given."""
    numbers = dict.fromkeys(m.StateMessage.__dataclass_fields__, level)
    numbers |= {"header": HEADER, "mono_ns": 0, "seq": 0, "flags": 0}
    return m.StateMessage(**{**numbers, **given})


class FakeCar:
    """A car on an in-process bus that drives its lane and notes what it is asked for."""

    def __init__(self):
        hub = LocalHub()
        self.bus = LocalBus(hub)
        self._requests = self.bus.subscribe(make_key("car1", topics.OPERATOR), 4096)
        self._stops = self.bus.subscribe(make_key("car1", topics.STOP), 4096)
        self._settings = self.bus.subscribe(make_key("car1", topics.SET_PARAMETERS), 64)
        self.live = take_request(make_live(BOUNDS), NOBODYS, admitted=True)
        self.live_asked = []
        self.view = CarView(LocalBus(hub), "car1", MonotonicClock())
        self.state, self.holder, self.speaks, self.asked = SupervisorState.READY, 0, True, []
        self.leased, self.level = "1", 0.01  # of every number that is not one of the lane's
        self._step = 0

    def publish(self):
        for sample in (*self._requests.poll(), *self._stops.poll()):
            request = decode(OperatorRequest, sample.data)
            self.asked.append(request)
            self._obey(request)
        for sample in self._settings.poll():
            wanted = decode(m.ParameterRequest, sample.data)
            self.live_asked.append(wanted)
            admitted = make_badge("", wanted.lease_id) == self.holder
            self.live = take_request(self.live, wanted, admitted=admitted)
        if not self.speaks:
            return
        self._say(topics.PARAMETERS, make_parameters(self.live, 0))
        self._step += 3
        i = self._step % len(LANE.x)
        place = {"x": LANE.x[i], "y": LANE.y[i], "yaw": LANE.yaw[i], "e1": math.nan}
        self._say(topics.STATE, a_state(self.level, mode=self.state, **place))
        said = {"state": self.state.name, "reason": "all well", "waiting": "an operator",
                "warnings": "the battery is low: 10.1 V", "boot_id": "77", "leased": self.leased,
                "holder": str(self.holder), "mocap": "ok", "mocap_rate_hz": "100.0"}  # fmt: skip
        self._say(topics.DIAGNOSTICS, status_message(**said))

    def _obey(self, request):
        states = SupervisorState
        wanted = {
            RequestKind.ARM: states.ARMED, RequestKind.START: states.RUNNING,
            RequestKind.STOP: states.READY, RequestKind.ESTOP: states.ESTOP,
        }  # fmt: skip
        if RequestKind(request.kind) is RequestKind.ARM:
            self.holder = make_badge("", request.lease_id)
        new = wanted.get(RequestKind(request.kind), self.state)
        if new is not self.state:
            change = m.Transition(HEADER, self.state, new, "operator", "a button of the page")
            self.state = new
            self._say(topics.TRANSITION, change)

    def _say(self, topic, message):
        self.bus.publish(make_key("car1", topic), encode(message))

    def kinds(self):
        return [RequestKind(request.kind) for request in self.asked]


@contextmanager
def served(car):
    """The car's page on a free port: its address."""
    ready, address, ended, loops = threading.Event(), [], asyncio.Event(), []

    def opened(url):
        address.append(url)
        ready.set()

    async def drive():
        while True:
            car.publish()
            await asyncio.sleep(0.01)

    async def serve():
        loops.append(asyncio.get_running_loop())
        driving = asyncio.create_task(drive())
        page = make_page("car1", make_lane_job("figure8"))
        await run_page(car.view, page, 0, opened, ended)
        driving.cancel()

    thread = threading.Thread(target=asyncio.run, args=(serve(),))
    thread.start()
    assert ready.wait(60.0)
    try:
        yield address[0]
    finally:
        loops[0].call_soon_threadsafe(ended.set)
        thread.join()


car = pytest.fixture(lambda: FakeCar())

UNREAD = {"max_queue": None, "ping_interval": None, "close_timeout": 0.2}
"""Pictures that a test does not read must not stop the socket, nor its closing the test."""


def live(url, **options):
    """The page's WebSocket, as its own script opens it."""
    address, origin = url.replace("http", "ws") + "live", url[: url.index("/", 8)]
    return connect(address, origin=origin, **{**UNREAD, **options})


def until(socket, done):
    """The first picture for which `done` holds."""
    while True:
        seen = json.loads(socket.recv(30.0))
        if done(seen):
            return seen


def test_only_its_own_page_is_answered(car):
    with served(car) as url:
        with urllib.request.urlopen(url) as page:
            assert "Emergency stop" in page.read().decode()
            assert "default-src 'none'" in page.headers["Content-Security-Policy"]
        with pytest.raises(urllib.error.HTTPError, match="404"):
            urllib.request.urlopen(url.rsplit("/", 2)[0] + "/guess/")
        named = urllib.request.Request(url, headers={"Host": "evil.example"})
        with pytest.raises(urllib.error.HTTPError, match="403"):
            urllib.request.urlopen(named)
        for origin in ("http://evil.example", None):
            with pytest.raises(InvalidStatus, match="403"):
                connect(url.replace("http", "ws") + "live", origin=origin)
    assert car.asked == []


def test_a_page_is_an_operator_like_any_other(car):
    with served(car) as url, live(url) as socket:
        first = until(socket, lambda seen: seen["state"] == "READY")
        assert (first["mine"], first["held"], first["e1"]) == (False, False, None)
        socket.send("arm")
        until(socket, lambda seen: seen["state"] == "ARMED" and seen["mine"])
        socket.send("start")
        until(socket, lambda seen: seen["state"] == "RUNNING")
        with live(url) as other:
            seen = until(other, lambda seen: seen["state"] == "RUNNING")
            assert (seen["mine"], seen["held"]) == (False, True)
            other.send("nonsense")
            other.send("estop")
            until(socket, lambda seen: seen["state"] == "ESTOP")
    assert car.kinds()[:3] == [RequestKind.ARM, RequestKind.START, RequestKind.ESTOP]
    assert set(car.kinds()[3:]) <= {RequestKind.ESTOP}, "again until it is seen"
    arm, start, estop = car.asked[:3]
    assert arm.boot_id == start.boot_id == 77
    assert arm.lease_id == start.lease_id != estop.lease_id
    assert start.seq == arm.seq + 1


def test_live_parameters_are_set_by_who_holds_the_car(car):
    with served(car) as url, live(url) as socket:
        until(socket, lambda seen: seen["live"].get("speed") == [1.5, 0.3, 1.5])
        socket.send("arm")
        until(socket, lambda seen: seen["mine"])
        for wrong in ("speed", "speed fast", "speed nan", "mass 1", "speed 1 2"):
            socket.send(f"set {wrong}")
        socket.send("set speed 0.75")
        seen = until(socket, lambda seen: seen["live"]["speed"][0] == 0.75)
        assert not seen["live"]["refused"]
        socket.send("set gain 2")
        seen = until(socket, lambda seen: seen["live"]["refused"])
        assert "gain 2, allowed 0.5 to 1.2" in seen["live"]["text"]
        with live(url) as other:
            other.send("set offset 0.1")
            until(socket, lambda seen: "somebody else" in seen["live"]["text"])
    assert (len(car.live_asked), car.live.aim) == (3, LiveValues(0.75, 0, 1))
    numbers = [request.seq for request in (car.asked[0], *car.live_asked[:2])]
    assert numbers == [numbers[0] + k for k in range(3)], "one number for all of a page's requests"


def test_nothing_is_sent_that_the_browser_did_not_send():
    """A silent browser is a silent operator: no timer of ours keeps a lease alive."""
    car = FakeCar()
    operator = BusOperator(car.view.bus, "car1", car.view.clock, NAME, car.view.pulse)
    assert not pass_on(car.view, operator, "keepalive"), "not before the car was heard"
    car.publish()
    car.view.poll()
    assert pass_on(car.view, operator, "keepalive")
    for _ in range(50):
        car.publish()
        car.view.poll()
        show_car(car.view)
    assert car.kinds() == [RequestKind.KEEPALIVE]


def test_its_stop_needs_no_status_and_survives_a_garbled_one(car):
    car.speaks = False
    with served(car) as url, live(url) as socket:
        socket.send("estop")
        while RequestKind.ESTOP not in car.kinds():
            socket.recv(30.0)
        for values in ({"boot_id": "seven"}, {"state": "FLYING"}):
            car._say(topics.DIAGNOSTICS, status_message(**values))
        car._say(topics.STATE, a_state(mode=200))
        car.bus.publish(make_key("car1", topics.STATE), b"\0\1\2")
        sent = len(car.asked)
        socket.send("stop")
        while RequestKind.STOP not in car.kinds()[sent:]:
            socket.recv(30.0)
        car.speaks = True
        until(socket, lambda seen: seen["state"] == "READY")  # and nobody repeats the stop


@pytest.mark.slow
@pytest.mark.skipif(not CHROMIUM, reason=NO_BROWSER)
def test_in_a_browser_it_is_whole_and_its_buttons_work_with_and_without_a_holder(car):
    with served(car) as url, browsing() as browser:
        for width, dark in ((1280, False), (420, True)):
            browser.open(url, width, dark=dark)
            browser.wait("document.documentElement.dataset.ready === '1'")
            assert (browser.faults_of_layout(), browser.console) == ([], [])
        browser.ask("document.getElementById('arm').click()")
        browser.wait("!document.getElementById('start').disabled")
        browser.ask(
            "(() => { const box = document.getElementById('live-offset'); box.value = '50';"
            " box.dispatchEvent(new Event('input'));"
            " document.querySelector('#live button').click(); })()"
        )
        browser.wait("document.getElementById('live-answer').textContent === 'set by page'")
        browser.wait("document.getElementById('live-offset').value === '50'")
        assert car.live.aim == LiveValues(1.5, 0.05, 1)
        browser.ask("document.getElementById('start').click()")
        browser.wait("document.getElementById('state').textContent === 'running'")
        assert "You hold this car" in browser.ask("document.getElementById('hold').textContent")
        browser.wait("document.querySelectorAll('#events li').length === 2")
        while car.kinds().count(RequestKind.KEEPALIVE) < 5:
            browser.ask("new Promise(r => setTimeout(r, 20))")
        car.speaks = False
        browser.wait("document.getElementById('alarm').textContent.includes('still running?')")
        car.speaks = True
        browser.open("about:blank")  # the page is left
        assert browser.ask("1 + 1") == 2
        while RequestKind.STOP not in car.kinds():
            browser.ask("new Promise(r => setTimeout(r, 20))")
        assert car.kinds()[-1] is RequestKind.STOP, "after that it is silent"
        car.level = -0.001
        browser.open(url)
        figures = "document.getElementById('figures').textContent"
        browser.wait(f"{figures}.includes('speed0.00 m/s')")  # and not -0.00 of a car that stands
        # As on simulated hardware with `--auto-arm`: it drives on, whoever is silent.
        car.asked.clear()
        car.leased, car.state = "0", SupervisorState.RUNNING
        asked = "document.getElementById('hold').textContent"
        browser.wait(f"{asked}.includes('needs no holder')")
        assert "drives on when this page is closed" in browser.ask(asked)
        car.state = SupervisorState.READY
        browser.wait("!document.getElementById('arm').disabled")
        browser.ask("document.getElementById('arm').click()")
        browser.wait(f"{asked}.startsWith('You hold this car')")  # leaving it asks for a stop
        browser.open(url, 420)
        browser.wait(f"{asked}.includes('needs no holder')")
        assert browser.faults_of_layout() == []
    assert RequestKind.STOP in car.kinds()
