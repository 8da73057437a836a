"""`steerd watch`: what it shows is what was received, and silence is not standing still."""

import pytest
from rich.console import Console

from steerd.daemon.common.errors import SteerdError
from steerd.daemon.loop.transitions import SupervisorState
from steerd.daemon.terminal.dashboard import Dashboard
from steerd.daemon.terminal.watch import SECOND, Watch, find_car
from steerd.steer_bus import messages as m
from steerd.steer_bus.bus import Sample
from steerd.steer_bus.codec import encode
from tests.blank import blank
from tests.local_bus import LocalBus, LocalHub

HEADER = m.make_header(SECOND, m.WORLD)


def sample(name, message):
    return Sample(f"steerd/car1/{name}", encode(message))


def state(speed=1.5, e1=0.012):
    return blank(m.StateMessage, mode=SupervisorState.RUNNING, speed=speed, e1=e1)


def vesc(fault=0):
    return m.VescTelemetry(HEADER, 0, 0, 0, 0, 0, 0, fault, 0, 11.5, *[1.0] * 9)


def shown(watch, t_ns, width=100):
    console = Console(width=width, record=True, file=open("/dev/null", "w"))  # noqa: SIM115, PTH123
    with console.capture() as caught:
        console.print(watch.render(t_ns))
    console.file.close()
    return caught.get()


def test_state_rates_and_faults():
    watch = Watch(Dashboard("car1"))
    for i in range(200):
        t = i * SECOND // 100
        watch.take(sample("state", state()), t)
        if i % 2:
            watch.take(sample("vesc", vesc(fault=4)), t)
    assert watch.rates(2 * SECOND) == pytest.approx({"state": 100, "vesc": 50}, abs=1)
    line = watch.line(2 * SECOND)
    assert line.startswith("RUNNING       +1.50 m/s, e1 +12.0 mm; state 100, vesc 50 Hz; fault ")
    assert "none" not in line
    text = shown(watch, 2 * SECOND)
    assert "e1  +12.0 mm" in text
    assert "11.5 V" in text
    assert "state 100" in text


def test_silence_is_reported():
    watch = Watch(Dashboard("car1"))
    assert watch.silence(9 * SECOND) == 0.0
    watch.take(sample("state", state()), SECOND)
    assert watch.silence(2 * SECOND) == 0.0
    assert watch.silence(5 * SECOND) == 4.0
    assert "no message for 4.0 s" in watch.line(5 * SECOND)
    assert "no message for 4.0 s" in shown(watch, 5 * SECOND)
    watch.take(sample("state", state()), 6 * SECOND)
    assert watch.silence(6 * SECOND) == 0.0


def test_what_is_no_message_of_ours_is_counted_and_requests_are_left_alone():
    watch = Watch(Dashboard("car1"))
    assert watch.take(Sample("steerd/car1/state", b"\0\1\0\0nonsense"), 0) is None
    assert watch.take(Sample("steerd/car1/diagnostics", b""), 0) is None
    assert watch.undecodable == 2
    assert watch.take(Sample("steerd/car1/cmd/drive", b"x"), 0) is None
    assert watch.take(Sample("other/key", b"x"), 0) is None
    assert watch.undecodable == 2
    change = m.Transition(
        HEADER, SupervisorState.ARMED, SupervisorState.RUNNING, "c", "start requested"
    )
    assert watch.take(sample("transition", change), 0) == "RUNNING       start requested"


def test_which_car():
    hub = LocalHub()
    here, there = LocalBus(hub), LocalBus(hub)
    with pytest.raises(SteerdError, match="no car is on the bus"):
        find_car(here, None)
    there.declare_alive("steerd/blue/alive")
    assert find_car(here, None) == "blue"
    assert find_car(here, "blue") == "blue"
    with pytest.raises(SteerdError, match="no car 'red'") as caught:
        find_car(here, "red")
    assert "blue" in caught.value.hint
    there.declare_alive("steerd/red/alive")
    with pytest.raises(SteerdError, match="several"):
        find_car(here, None)
