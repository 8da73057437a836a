"""The guardian: its decisions with injected time, and its bytes with real processes and a pty."""

import os
import pty
import runpy
import select
import signal
import subprocess
import sys
import time
import tty
from pathlib import Path
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from steerd.daemon.process import guardian, heartbeat
from steerd.daemon.process.guard import find_pause, make_page_fd
from steerd.daemon.process.guardian import BRAKE_NS, PERIOD_NS, brake, wait_for_fault
from steerd.daemon.process.heartbeat import OUTGOING_BYTES, PAUSE_NS, STALE_NS, HeartbeatPage

BRAKE, MOTION = b"\x02\x05BRAKE\x03", b"\x02\x05MOVE!\x03"  # as long as each other
MS = 1_000_000
ROOT = Path(__file__).resolve().parents[4]


class Times:
    """A clock that gives the given times, then runs on by a step."""

    def __init__(self, *times, step=0):
        self.times, self.step, self.last = list(times), step, 0

    def __call__(self):
        self.last = self.times.pop(0) if self.times else self.last + self.step
        return self.last


class Core:
    """Stands for the poll object of the core's pidfd: ends after so many polls."""

    def __init__(self, polls, each=lambda: None):
        self.polls, self.each, self.waits = polls, each, []

    def poll(self, timeout_ms):
        self.waits.append(timeout_ms)
        self.each()
        self.polls -= 1
        return [] if self.polls else [(0, 1)]


def make_sides():
    """The page as the core and as the guardian see it."""
    fd = make_page_fd()
    sides = HeartbeatPage(fd), HeartbeatPage(fd)
    os.close(fd)
    return sides


page = pytest.fixture(lambda: make_sides()[0])


def test_the_page_tells_when_the_guardian_itself_stood_still(page):
    start = 10**12
    assert find_pause(page, start) is None, "it never lived"
    for k in range(3):
        page.watch(start + k * PERIOD_NS)
    now = start + 2 * PERIOD_NS
    assert find_pause(page, now + PAUSE_NS) == (0, 0)
    assert find_pause(page, now + PAUSE_NS + 1) == (now, now + PAUSE_NS + 1), "it goes on"
    page.watch(now + 45 * MS)
    page.watch(now + 55 * MS)
    assert find_pause(page, now + 56 * MS) == (now, now + 45 * MS)
    page.watch(now + 55 * MS + PAUSE_NS)
    assert find_pause(page, now + 71 * MS) == (now, now + 45 * MS), "no pause: its ordinary sleep"


def test_core_may_write_only_fresh_ticks_and_never_after_a_trip(page):
    for tick_ns in (0, 10**12):
        assert page.may_write(tick_ns, tick_ns + STALE_NS - 1)
        assert not page.may_write(tick_ns, tick_ns + STALE_NS)
    assert page.may_write(0, STALE_NS, stale_ns=STALE_NS + 1)
    page.trip(1, BRAKE)
    assert not page.may_write(0, 0)


@given(st.binary(max_size=OUTGOING_BYTES), st.binary(min_size=1, max_size=20))
def test_what_a_core_has_staged_is_a_brake_frame_once_the_guardian_took_over(wire, frame):
    core, watcher = make_sides()
    core.write_heartbeat(7, True)
    staged = core.stage(wire)
    assert bytes(staged) == wire
    watcher.trip(9, frame)
    assert bytes(staged) == frame.ljust(OUTGOING_BYTES, b"\0")[: len(wire)]
    assert (core.words.heartbeat_ns, core.words.tripped_ns, core.words.engaged) == (7, 9, True)


def test_a_frame_that_does_not_fit_is_refused(page):
    assert bytes(page.stage(bytes([7]) * OUTGOING_BYTES)) == bytes([7]) * OUTGOING_BYTES
    with pytest.raises(ValueError, match="257 bytes: at most 256"):
        page.stage(bytes(OUTGOING_BYTES + 1))


@pytest.mark.parametrize(("age", "faulty"), [(STALE_NS, False), (STALE_NS + 1, True)])
def test_heartbeat_is_stale_strictly_beyond_its_limit(page, age, faulty):
    page.write_heartbeat(1000, True)
    core = Core(1, lambda: setattr(page.words, "clean", 1))
    assert wait_for_fault(page, core, STALE_NS, Times(1000 + age)) is faulty
    assert page.words.guardian_ns == 1000 + age
    assert (STALE_NS, heartbeat.STALE_NS_NO_RT) == (30 * MS, 60 * MS)
    assert core.waits == ([] if faulty else [1])


@pytest.mark.parametrize(("engaged", "times", "waits"), [
    (False, (10**12,), [10] * 3), (True, (0, 25 * MS, 28 * MS + 1, STALE_NS), [10, 6, 2, 1]),
], ids=["a disarmed core's stale heartbeat is none of its business", "armed"])  # fmt: skip
def test_it_wakes_when_a_heartbeat_would_be_stale_but_at_least_every_10_ms(
    page, engaged, times, waits
):
    page.write_heartbeat(0, engaged)
    core = Core(len(waits))
    assert wait_for_fault(page, core, STALE_NS, Times(*times, step=MS)) is engaged
    assert core.waits == waits


@pytest.mark.parametrize("engaged", [True, False])
@pytest.mark.parametrize("clean", [True, False])
def test_end_of_the_core_is_a_fault_if_it_was_driving_and_did_not_say_goodbye(page, engaged, clean):
    page.write_heartbeat(5, engaged)
    if clean:
        page.words.clean = 1
    assert wait_for_fault(page, Core(1), STALE_NS, Times(6)) is (engaged and not clean)


@pytest.mark.parametrize("refused", [False, True])
def test_brake_trips_first_and_repeats_for_two_seconds_whatever_the_device_says(
    page, monkeypatch, refused
):
    seen = []

    def write(fd, data):
        seen.append((page.words.tripped_ns, fd, data))
        if refused:
            raise BlockingIOError

    monkeypatch.setattr(guardian.os, "write", write)
    brake(page, 42, BRAKE, Times(7, step=PERIOD_NS))
    assert seen == [(7, 42, BRAKE)] * (BRAKE_NS // PERIOD_NS) == [(7, 42, BRAKE)] * 200
    assert page.words.guardian_ns > 7


@pytest.mark.parametrize(("step", "waits"), [(0, range(10, 2001, 10)), (BRAKE_NS, [0] * 200)])
def test_brake_frames_are_10_ms_apart_and_late_ones_do_not_wait(page, monkeypatch, step, waits):
    pauses = []
    monkeypatch.setattr(guardian.select, "poll", lambda: SimpleNamespace(poll=pauses.append))
    monkeypatch.setattr(guardian.os, "write", lambda fd, data: len(data))
    brake(page, 42, BRAKE, Times(7, step=step))
    assert pauses == list(waits)


@pytest.mark.parametrize("engaged", [True, False])
@pytest.mark.parametrize("allowed", [True, False])
def test_main_ignores_signals_asks_for_priority_and_guards(monkeypatch, engaged, allowed):
    ignored, requested, braked = [], [], []

    def schedule(pid, policy, parameter):
        requested.append((pid, policy, parameter.sched_priority))
        if not allowed:
            raise PermissionError

    monkeypatch.setattr(guardian.signal, "signal", lambda s, h: ignored.append((s, h)))
    monkeypatch.setattr(guardian.os, "sched_setscheduler", schedule)
    monkeypatch.setattr(guardian, "brake", lambda page, fd, frame, now: braked.append((fd, frame)))
    fd = make_page_fd()
    HeartbeatPage(fd).write_heartbeat(1, engaged)
    read_end, write_end = os.pipe()
    os.close(write_end)  # the read end is ready at once, like the pidfd of a core that has ended
    arguments = [str(k) for k in (7, fd, read_end)]
    guardian.main([*arguments, BRAKE.hex(), str(STALE_NS)])
    assert braked == ([(7, BRAKE)] if engaged else [])
    assert ignored == [(s, signal.SIG_IGN) for s in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)]
    assert requested == [(0, os.SCHED_FIFO, 60)]
    os.close(fd)
    os.close(read_end)


def test_run_as_a_program_it_wants_its_five_words(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["guardian"])
    with pytest.raises(SystemExit, match="2"):
        runpy.run_path(guardian.__file__, run_name="__main__")
    assert "serial_fd" in capsys.readouterr().err


def test_a_port_that_an_unarmed_core_lets_go_is_guarded_no_longer(page):
    page.write_heartbeat(0, engaged=False)
    page.words.clean = 1
    assert not wait_for_fault(page, Core(2), STALE_NS, Times(0))
    page.write_heartbeat(0, engaged=True)
    assert wait_for_fault(page, Core(99), STALE_NS, Times(0, STALE_NS + 1)), "armed: it stays"


def test_guardian_is_small_and_stands_alone():
    lines = Path(guardian.__file__).read_text(encoding="utf-8").splitlines()
    assert len(lines) <= 150
    code = (
        "import sys; import steerd.daemon.process.guardian;"
        "print([m for m in sys.modules if m.split('.')[0] in"
        " ('numpy', 'serial', 'zenoh', 'vesc_link', 'controller', 'car_model', 'msgspec')])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True, cwd=ROOT)
    assert done.stdout.strip() == b"[]"


CORE = """
import os, signal, sys, time, select
from steerd.daemon.process.heartbeat import HeartbeatPage
fd, page = int(sys.argv[1]), HeartbeatPage(int(sys.argv[2]))
engaged, motion = bool(int(sys.argv[3])), bytes.fromhex(sys.argv[4])
pause = select.poll()
while True:
    tick = time.monotonic_ns()
    page.write_heartbeat(tick, engaged)
    staged = page.stage(motion)
    if page.may_write(tick, time.monotonic_ns()):
        if os.path.exists(sys.argv[5]):  # the worst moment: looked, and not yet written
            os.kill(os.getpid(), signal.SIGSTOP)
        os.write(fd, staged)
    pause.poll(5)
"""


class Rig:
    """A pty, a core that writes motion frames every 5 ms, and a real guardian."""

    def __init__(self, freeze, engaged=True, frame=MOTION):
        self.device, serial = pty.openpty()
        self.serial = serial  # held open, so that the other end lives on
        tty.setraw(serial)
        os.set_blocking(serial, False)
        page_fd = make_page_fd()
        self.page = HeartbeatPage(page_fd)
        self.core = self.spawn(
            ["-c", CORE, str(serial), str(page_fd), str(int(engaged)), frame.hex(), freeze],
            (serial, page_fd),
        )
        pidfd = os.pidfd_open(self.core.pid)
        self.read_until(lambda data: frame in data)
        arguments = [str(k) for k in (serial, page_fd, pidfd)]
        self.guardian = self.spawn(
            ["-m", "steerd.daemon.process.guardian", *arguments, BRAKE.hex(), str(10 * STALE_NS)],
            (serial, page_fd, pidfd),
        )
        for fd in (page_fd, pidfd):
            os.close(fd)
        self.read_until(lambda _: self.page.words.guardian_ns > 0)
        self.read_until(lambda data: len(data) > 5 * len(frame))

    def spawn(self, arguments, fds):
        env = {**os.environ, "PYTHONPATH": str(ROOT)}
        return subprocess.Popen([sys.executable, *arguments], pass_fds=fds, env=env, cwd=ROOT)

    def read_until(self, done, seconds=10.0):
        """Read what arrives until ``done(bytes so far)``."""
        data, deadline = b"", time.monotonic() + seconds
        while time.monotonic() < deadline:
            if select.select([self.device], [], [], 0.01)[0]:
                data += os.read(self.device, 4096)
            if done(data):
                return data
        raise AssertionError(f"nothing for {seconds} s; last bytes {data[-40:]!r}")

    def close(self):
        for process in (self.core, self.guardian):
            if process.poll() is None:
                process.kill()
            process.wait()
        os.close(self.device)
        os.close(self.serial)


@pytest.fixture
def rig(request, tmp_path):
    made = Rig(str(tmp_path / "freeze"), **getattr(request, "param", {}))
    yield made
    made.close()


def assert_only_brakes_after_the_first(data):
    """Motion frames, perhaps one cut short, then nothing but whole brake frames."""
    first = data.index(BRAKE)
    tail = data[first:]
    assert MOTION[1:] not in tail
    assert tail == BRAKE * (len(tail) // len(BRAKE)) + BRAKE[: len(tail) % len(BRAKE)]


def test_a_core_frozen_between_its_last_look_and_the_write_sends_a_brake_frame(rig, tmp_path):
    (tmp_path / "freeze").touch()
    data = rig.read_until(lambda data: data.count(BRAKE) >= 3)
    (tmp_path / "freeze").unlink()
    before_ns = rig.page.words.heartbeat_ns
    rig.core.send_signal(signal.SIGCONT)
    more = rig.read_until(
        lambda data: data.count(BRAKE) >= 20 and rig.page.words.heartbeat_ns > before_ns
    )
    assert_only_brakes_after_the_first(data + more)


@pytest.mark.parametrize("rig", [{"engaged": False, "frame": b"\x02POLL\x03"}], indirect=True)
def test_disarmed_core_may_die_without_a_byte(rig):
    rig.core.kill()
    data = rig.read_until(lambda _: rig.guardian.poll() is not None)
    assert rig.guardian.returncode == 0
    assert rig.page.words.tripped_ns == 0
    assert BRAKE not in data
    assert not select.select([rig.device], [], [], 0.0)[0]


def test_ctrl_c_to_the_whole_group_does_not_end_the_guardian(rig):
    for number in (signal.SIGINT, signal.SIGHUP, signal.SIGTERM):
        rig.guardian.send_signal(number)
    alive = rig.page.words.guardian_ns
    rig.read_until(lambda _: rig.page.words.guardian_ns > alive + 50 * MS)
    assert rig.guardian.poll() is None
    rig.core.kill()
    data = rig.read_until(lambda data: data.count(BRAKE) >= 20)
    assert_only_brakes_after_the_first(data)
    assert rig.page.words.tripped_ns > 0
    rig.read_until(lambda _: rig.guardian.poll() is not None)
    assert rig.guardian.returncode == 0
