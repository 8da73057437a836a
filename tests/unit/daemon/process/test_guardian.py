"""The guardian: decisions with injected time, bytes with real processes; who holds the lifeline."""

import os
import pty
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
from steerd.daemon.process.guard import START_NS, ProcessGuard, find_pause, make_page_fd
from steerd.daemon.process.guardian import BRAKE_NS, PERIOD_NS, brake, wait_for_fault
from steerd.daemon.process.heartbeat import STALE_NS, HeartbeatPage, Lifeline

OUTGOING_BYTES, PAUSE_NS = heartbeat.OUTGOING_BYTES, heartbeat.PAUSE_NS
BRAKE, MOTION = b"\x02\x05BRAKE\x03", b"\x02\x05MOVE!\x03"  # as long as each other
MS = 1_000_000
ROOT = Path(__file__).resolve().parents[4]


def spawn(arguments, fds, **options):
    """Python with these words and descriptors."""
    command = [sys.executable, *map(str, arguments)]
    return subprocess.Popen(command, pass_fds=fds, cwd=ROOT, **options)


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


def test_it_asks_for_a_priority_above_the_cores_and_guards_without_it_too(monkeypatch):
    requested = []

    def refuse(pid, policy, parameter):
        requested.append((pid, policy, parameter.sched_priority))
        raise PermissionError

    monkeypatch.setattr(guardian.os, "sched_setscheduler", refuse)
    monkeypatch.setattr(guardian.signal, "signal", lambda *_: None)
    fd, (read_end, write_end) = make_page_fd(), os.pipe()
    os.close(write_end)  # the read end is ready at once, like the pidfd of a core that has ended
    guardian.main([*map(str, (7, fd, read_end)), BRAKE.hex(), str(STALE_NS)])
    assert requested == [(0, os.SCHED_FIFO, 60)]
    os.close(fd)
    os.close(read_end)


def test_a_port_that_an_unarmed_core_lets_go_is_guarded_no_longer(page):
    page.write_heartbeat(0, engaged=False)
    page.words.clean = 1
    assert not wait_for_fault(page, Core(2), STALE_NS, Times(0))
    page.write_heartbeat(0, engaged=True)
    assert wait_for_fault(page, Core(99), STALE_NS, Times(0, STALE_NS + 1)), "armed: it stays"


def test_guardian_is_small_and_stands_alone():
    assert len(Path(guardian.__file__).read_text(encoding="utf-8").splitlines()) <= 150
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
        told = ["-c", CORE, serial, page_fd, int(engaged), frame.hex(), freeze]
        self.core = spawn(told, (serial, page_fd))
        fds = (serial, page_fd, os.pidfd_open(self.core.pid))
        self.read_until(lambda data: frame in data)
        module = "steerd.daemon.process.guardian"
        self.guardian = spawn(["-m", module, *fds, BRAKE.hex(), 10 * STALE_NS], fds)
        for fd in fds[1:]:
            os.close(fd)
        self.read_until(lambda _: self.page.words.guardian_ns > 0)
        self.read_until(lambda data: len(data) > 5 * len(frame))

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


# The core's side of the guardian.
def test_before_a_port_is_open_nothing_may_move_and_nothing_is_missed():
    guard = ProcessGuard(realtime=True)
    now = time.monotonic_ns()
    guard.mark_clean()
    assert not any((guard.may_write(now, now), guard.is_silent(now), guard.has_tripped()))


@pytest.mark.parametrize(("realtime", "simulated", "stale_ms"), [
    (True, False, 30), (False, False, 60), (True, True, 300),
])  # fmt: skip
def test_how_late_a_heartbeat_may_be(realtime, simulated, stale_ms):
    guard = ProcessGuard(realtime, simulated=simulated)
    guard.page = HeartbeatPage(make_page_fd())
    now, stale_ns = time.monotonic_ns(), stale_ms * 1_000_000
    guard.page.write_heartbeat(now, engaged=True)
    assert guard.may_write(now, now + stale_ns - 1)
    assert not guard.may_write(now, now + stale_ns)


def test_a_guardian_shows_itself_brakes_a_silent_core_and_is_missed_when_killed(pipe):
    read, write = pipe
    guard = ProcessGuard(realtime=False, simulated=True)
    start = time.monotonic_ns()
    guard.watch(write, BRAKE, start)
    assert not guard.is_silent(start + START_NS - 1), "it has a second to come up"
    assert guard.is_silent(start + START_NS), "and no longer"
    end = time.monotonic() + 20.0
    while not guard.page.words.guardian_ns and time.monotonic() < end:
        guard.page.write_heartbeat(time.monotonic_ns(), engaged=False)
        select.select([], [], [], 0.005)
    shown = guard.page.words.guardian_ns
    assert shown
    assert not guard.is_silent(shown + 300_000_000)
    assert guard.is_silent(shown + 300_000_001)
    now = time.monotonic_ns()
    guard.page.write_heartbeat(now, engaged=True)
    assert guard.may_write(now, now)
    assert not guard.may_write(now, now + 300_000_000), "a tick of before a stop is not sent after"
    assert select.select([read], [], [], 20.0)[0], "no heartbeat any more: the guardian brakes"
    assert os.read(read, 1000).startswith(BRAKE)
    assert guard.has_tripped()
    assert not guard.may_write(time.monotonic_ns(), time.monotonic_ns())
    guard._process.kill()
    guard._process.wait()
    assert guard.is_silent(time.monotonic_ns())


def test_a_plug_that_flaps_leaves_nothing_behind(pipe):
    read, write = pipe
    guard = ProcessGuard(realtime=False, simulated=True)
    counts = []
    for _ in range(4):
        guard.watch(write, BRAKE, time.monotonic_ns())
        counts.append(len(list(Path("/proc/self/fd").iterdir())))
        guard.mark_clean()
        assert guard._process.wait(20.0) == 0, "let go of, and the car is not armed"
    assert len(set(counts[1:])) == 1
    assert not select.select([read], [], [], 0.0)[0], "nobody braked"


# Who holds the lifeline, and what the other end hears of its death.
HOLDER = """
import os, sys, select
from steerd.daemon.process.heartbeat import HeartbeatPage, Lifeline
line = Lifeline(int(sys.argv[1]))
line.hold()
if sys.argv[2] == "0":
    del line
    os._exit(0)
memory = bytearray(int(sys.argv[2]))
memory[::4096] = b"x" * len(memory[::4096])
print("held", flush=True)
select.poll().poll(60_000)
"""


def hold(size, **options):
    """A process that holds a lifeline with so much memory, its page, and this end of the line."""
    page_fd = make_page_fd()
    holder = spawn(["-c", HOLDER, page_fd, size], (page_fd,), **options)
    return holder, page_fd, Lifeline(page_fd, os.pidfd_open(holder.pid))


@pytest.fixture
def held(request):
    """A holder that lives on."""
    holder, *line = hold(getattr(request, "param", 1) << 20, stdout=subprocess.PIPE)
    assert holder.stdout.readline() == b"held\n"
    holder.stdout.close()
    yield holder, *line
    holder.kill()
    holder.wait()


def test_a_holder_that_unmapped_its_page_before_it_left_is_heard_of():
    """The kernel cannot hand on a mutex that is not in memory any more: Python's own tidy end."""
    holder, _, line = hold(0)
    assert holder.wait() == 0
    assert line.poll(5)
    assert line.poll(5)


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGABRT, signal.SIGTERM])
def test_every_kind_of_death_is_heard_of_and_a_stopped_holder_is_not_dead(held, how):
    holder, _, line = held
    holder.send_signal(signal.SIGSTOP)
    assert not line.poll(30)
    holder.send_signal(signal.SIGCONT)
    holder.send_signal(how)
    assert line.poll(5_000)
    assert holder.wait() == -how


@pytest.mark.parametrize("held", [512], indirect=True)
def test_the_lifeline_does_not_wait_for_the_memory_to_be_taken_apart(held):
    holder, _, line = held
    gone = select.poll()
    gone.register(os.pidfd_open(holder.pid), select.POLLIN)
    holder.kill()
    assert line.poll(5_000)
    assert not gone.poll(0), "the kernel is still at it"
    assert gone.poll(5_000)


@pytest.mark.parametrize("mutex", ["there is none", "nobody holds it"])
def test_without_a_mutex_the_pidfd_has_to_do(held, monkeypatch, mutex):
    holder, page_fd, _ = held
    if mutex == "there is none":
        monkeypatch.setattr(heartbeat, "_library", lambda: None)
        Lifeline(page_fd).hold()
    else:
        page_fd = make_page_fd()
    line = Lifeline(page_fd, os.pidfd_open(holder.pid))
    assert not line.poll(5)
    holder.kill()
    assert line.poll(5_000)
