"""Daemon, hardware and operators as processes: pty, sockets, zenoh, real time."""

import os
import pty
import signal
import time
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from steerd.daemon.loop.transitions import SupervisorState
from steerd.steer_bus import messages as m
from steerd.steer_bus.codec import decode
from steerd.steer_bus.session_read import open_session
from steerd.steer_bus.zenoh_bus import Profile, ZenohBus
from steerd.sysid.data.dataset import read_run
from tests.e2e.conftest import changes, replays

pytestmark = [pytest.mark.realtime, pytest.mark.timeout(240)]
EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
ROS_PEER = ("-m", "tests.e2e.ros_peer")
CIRCLE = ("--path", "circle:radius=2", "--speed", "1")
STOPS = {SupervisorState.STOPPING, SupervisorState.FAULT_STOP}


class Watcher:
    """The published states of a run, until something is seen in them."""

    def __init__(self, endpoint):
        self.bus = ZenohBus(Profile(hub=False, endpoint=endpoint))
        self._states = self.bus.subscribe("steerd/car1/state", 64)
        self.seen = []

    def until(self, done, run, seconds=60.0):
        """Wait on the run's output in short slices; the state for which `done` holds."""
        end = time.monotonic() + seconds
        while True:
            for sample in self._states.poll():
                self.seen.append(decode(m.StateMessage, sample.data))
                if done(self.seen[-1]):
                    return self.seen[-1]
            assert time.monotonic() < end, run.text
            assert run.pump(0.02), run.text

    def driving(self, run, seconds):
        first = self.until(lambda s: s.mode == SupervisorState.RUNNING, run)
        end_ns = first.mono_ns + round(seconds * 1e9)
        return self.until(lambda s: s.mode != SupervisorState.RUNNING or s.mono_ns >= end_ns, run)

    def stopped(self, run):
        """Wait until the car is being stopped, and then until it stands."""
        stop = self.until(lambda s: s.mode in STOPS, run)
        self.until(lambda s: s.mode not in STOPS and abs(s.speed) < 0.05, run)
        return SupervisorState(stop.mode)

    def stopped_by_silence(self, run, peer, end):
        """Kill or freeze what the car drives by; wait for the stop, and until it stands."""
        silent_ns = time.monotonic_ns()
        peer.send(end)
        stop = self.until(lambda s: s.mode in STOPS, run)
        assert 0.05 < (stop.mono_ns - silent_ns) * 1e-9 < 0.5
        self.until(lambda s: s.mode not in STOPS and abs(s.speed) < 0.05, run)

    def close(self):
        self.bus.close()


def start_run(steerd, folder, *more, **options):
    record = folder / "drive.mcap"
    argv = ("run", "--listen", steerd.endpoint, "--record", record, *CIRCLE, *more)
    return steerd(*argv, **options), record


def kept_its_lane(record, most, capsys):
    """Whether the car drove within `most` [m] of its path but for a second, and replays."""
    table = open_session(record).columns(m.StateMessage)
    running = table["mode"] == SupervisorState.RUNNING
    t = table["mono_ns"][running]
    return np.abs(table["e1"][running][t - t[0] > 1e9]).max() < most and replays(record, capsys)


def arm_and_start(steerd):
    """From two other terminals, which stay until the car stands."""
    arm = steerd("arm", "--connect", steerd.endpoint)
    arm.expect("armed: `steerd start` from another terminal")
    go = steerd("start", "--connect", steerd.endpoint)
    go.expect("driving")
    return arm, go


def test_arm_start_stop_from_other_terminals_over_natnet(steerd, tmp_path, cli, capsys) -> None:
    port, url = steerd.sim(tmp_path)
    run, record = start_run(steerd, tmp_path, "--port", port, "--mocap", url)
    run.expect("READY")
    bus = ("--connect", steerd.endpoint)
    assert "not ARMED" in cli("start", *bus, code=5).err
    with closing(Watcher(steerd.endpoint)) as watcher:
        arm, go = arm_and_start(steerd)
        watcher.driving(run, 1.0)
        assert cli("status", *bus).out.startswith("car1: RUNNING")
        watcher.driving(run, 1.5)
        cli("stop", *bus)
        assert watcher.stopped(run) is SupervisorState.STOPPING
    assert go.wait() == 0, go.text
    assert run.interrupt() == 0, run.text
    assert arm.wait() == 0, arm.text
    assert "Traceback" not in run.text
    assert kept_its_lane(record, 0.03, capsys)


class Keyboard:
    def __init__(self):
        self._ours, self.theirs = pty.openpty()

    def press(self, key):
        os.write(self._ours, key.encode())

    def close(self):
        os.close(self._ours)
        os.close(self.theirs)


def test_keys_of_its_own_terminal_over_vrpn(steerd, tmp_path, capsys) -> None:
    port, url = steerd.sim(tmp_path, "--mocap", "vrpn")
    assert url.startswith("vrpn://")
    with closing(Keyboard()) as keys:
        argv = ("--port", port, "--mocap", url)
        run, record = start_run(steerd, tmp_path, *argv, stdin=keys.theirs)
        run.expect("READY")
        keys.press("a")
        run.expect(r"\bARMED")
        keys.press("s")
        run.expect("RUNNING")
        with closing(Watcher(steerd.endpoint)) as watcher:
            watcher.driving(run, 2.0)
            keys.press(" ")
            assert watcher.stopped(run) is SupervisorState.STOPPING
        keys.press("q")
        assert run.wait() == 0, run.text
    assert kept_its_lane(record, 0.03, capsys)


def test_poses_from_the_bus(steerd, tmp_path, capsys) -> None:
    """`--mocap zenoh:KEY`, fed by the example program, which reads them from NatNet."""
    port, url = steerd.sim(tmp_path)
    run, record = start_run(steerd, tmp_path, "--port", port, "--mocap", "zenoh:lab/pose/car")
    run.expect("first pose")
    argv = (EXAMPLES / "publish_poses.py", url, "--key", "lab/pose/car")
    steerd(*argv, "--connect", steerd.endpoint, module=())
    run.expect("READY")
    _, go = arm_and_start(steerd)
    with closing(Watcher(steerd.endpoint)) as watcher:
        assert watcher.driving(run, 2.0).mode == SupervisorState.RUNNING, run.text
        go.send(signal.SIGINT)
        assert watcher.stopped(run) is SupervisorState.STOPPING
    assert go.wait() == 0, go.text
    assert run.interrupt() == 0, run.text
    assert kept_its_lane(record, 0.05, capsys)


def test_a_plan_is_driven_and_its_session_identifies(steerd, tmp_path) -> None:
    port, url = steerd.sim(tmp_path)
    record = tmp_path / "drive.mcap"
    run = steerd("collect", "--listen", steerd.endpoint, "--record", record, "--port", port,
                 "--mocap", url, "--plan", "steps", "--box", 14, "--duration", 4)  # fmt: skip
    run.expect("READY")
    _, go = arm_and_start(steerd)
    assert run.wait() == 0, run.text
    assert go.wait() == 0, go.text
    assert "end of the run" in run.text
    asked = open_session(record).columns(m.Actuation)
    assert np.ptp(asked["steer"][asked["mode"] == m.ActuationMode.SPEED]) > 0.05
    read = read_run(open_session(record))
    assert read.duration > 2.5
    assert read.servo_frame == 0.02
    assert np.ptp(read.pose.values[:, 0]) > 1.0


# --- simulated hardware of its own: a stalled machine is reported and stops no car
CONTROLLERS = {
    "steerd control": (
        ("--controller", "zenoh"),
        lambda steerd: steerd("control", "--connect", steerd.endpoint, *CIRCLE), signal.SIGKILL,
    ),
    "a ROS 2 node's /drive": (
        ("--controller", "ros2", "--ros-domain", "0"),
        lambda steerd: steerd("steer", steerd.endpoint, module=ROS_PEER), signal.SIGSTOP,
    ),
}  # fmt: skip


@pytest.mark.parametrize("controller", CONTROLLERS)
def test_an_external_controller_drives_and_its_silence_stops_the_car(
    controller, steerd, tmp_path, capsys
) -> None:
    options, start, end = CONTROLLERS[controller]
    run, record = start_run(steerd, tmp_path, "--sim", "--auto-arm", *options)
    run.expect("DISARMED")  # the bus is up
    with closing(Watcher(steerd.endpoint)) as watcher:
        keeper = start(steerd)
        watcher.driving(run, 2.5)
        assert watcher.seen[-1].mode == SupervisorState.RUNNING, run.text
        watcher.stopped_by_silence(run, keeper, end)
    keeper.send(signal.SIGKILL)
    run.interrupt()
    assert "W25 " in next(c.text for c in changes(record) if c.to_state in STOPS)
    assert open_session(record).columns(m.DriveCommand)["seq"].size > 100
    assert kept_its_lane(record, 0.05, capsys)
