"""`steerd teleop` on simulated hardware: driven by a gamepad's bytes, stopped when it goes."""

import contextlib
import os
import signal
import threading
import time

import pytest

from steerd.daemon.loop.transitions import SupervisorState
from steerd.daemon.process.gamepad import ABS, AXES, BUTTONS, EVENT, KEY
from steerd.steer_bus import messages as m
from steerd.steer_bus.session_read import open_session
from tests.e2e.test_live import Watcher, start_run

pytestmark = [pytest.mark.realtime, pytest.mark.timeout(240)]
QUIET_S = 0.5


class Hand:
    """A hand on a gamepad, whose events come through a pipe; its sticks never rest quite still."""

    def __init__(self, path):
        self.path = path
        os.mkfifo(path)
        self._still = threading.Event()
        self._fd = -1

    def take(self):
        """Take the gamepad; waits until it is read."""
        self._fd = os.open(self.path, os.O_WRONLY)
        self._thread = threading.Thread(target=self._tremble)
        self._thread.start()

    def send(self, kind, code, value):
        with contextlib.suppress(BrokenPipeError):
            os.write(self._fd, EVENT.pack(0, 0, kind, code, value))

    def press(self, name):
        self.send(KEY, BUTTONS[name], 1)

    def _tremble(self):
        while not self._still.wait(0.05):
            self.send(ABS, AXES["ry"], 1)

    def rest(self):
        """No event any more, with the buttons as they are."""
        self._still.set()
        self._thread.join()

    def unplug(self):
        if self._fd >= 0:
            self.rest()
            os.close(self._fd)
            self._fd = -1


def press_until_driving(hand, run):
    """Press start as a person does: again, if the car was not ready for it."""
    end = time.monotonic() + 60.0
    while "RUNNING" not in run.text:
        assert time.monotonic() < end, run.text
        hand.press("start")
        assert run.pump(0.5), run.text
        hand.send(KEY, BUTTONS["start"], 0)


def drive(steerd, folder, hand):
    """A car driven by gamepad for two seconds: run, teleop, watcher, the last driving state."""
    port, url = steerd.sim(folder)
    options = ("--port", port, "--mocap", url, "--controller", "zenoh")
    run, record = start_run(steerd, folder, *options)
    run.expect("DISARMED")
    at = ("--connect", steerd.endpoint, "--device", hand.path, "--quiet", QUIET_S)
    teleop = steerd("teleop", *at)
    hand.take()
    teleop.expect("hold tl")
    hand.press("tl")
    press_until_driving(hand, run)
    hand.send(ABS, AXES["x"], -16000)
    hand.send(ABS, AXES["rz"], 700)
    watcher = Watcher(steerd.endpoint)
    driven = watcher.driving(run, 2.5)
    assert driven.mode == SupervisorState.RUNNING, run.text
    return run, teleop, watcher, driven, record


ENDS = {
    "unplugged": lambda hand, teleop: hand.unplug(),
    "silent": lambda hand, teleop: hand.rest(),
    "killed": lambda hand, teleop: teleop.send(signal.SIGKILL),
    "frozen": lambda hand, teleop: teleop.send(signal.SIGSTOP),
}


@pytest.mark.parametrize("end", ENDS)
def test_a_gamepad_that_goes_stops_the_car_within_the_lease(undisturbed, end):
    def scenario(steerd, folder):
        hand = Hand(folder / "pad")
        try:
            run, teleop, watcher, driven, record = drive(steerd, folder, hand)
            assert driven.speed > 0.4
            assert driven.steer > 0.05, "left is left"
            ENDS[end](hand, teleop)
            assert watcher.stopped(run) is SupervisorState.STOPPING
        finally:
            hand.unplug()
        seen = [s for s in watcher.seen if s.mono_ns > driven.mono_ns]
        stop = next(s for s in seen if s.mode != SupervisorState.RUNNING)
        late_s = (stop.mono_ns - driven.mono_ns) * 1e-9
        print(f"{end}: stopping {1e3 * late_s:.0f} ms later")
        assert late_s < 0.3 + 0.35 + (QUIET_S if end == "silent" else 0.0)
        watcher.close()
        if end == "frozen":
            teleop.send(signal.SIGKILL)
        if end == "unplugged":
            assert teleop.wait() == 3
            assert "is gone; the car stops" in teleop.text
        run.send(signal.SIGINT)
        # Who lets go asks for a stop; a process that is gone or hangs is W25.
        assert run.wait() == (5 if end in ("killed", "frozen") else 0), run.text
        commands = [r.decode() for r in open_session(record).messages("/steerd/car1/cmd/drive")]
        assert max(c.speed for c in commands) <= 1.0
        table = open_session(record).columns(m.StateMessage)
        assert SupervisorState.FAULT_STOP not in set(table["mode"])

    undisturbed(scenario)
