"""From the death of a control core to the first brake byte on a pty, and from its freezing.

    python -m benchmarks.stop_latency --trials 200 --log stop.jsonl

A real guardian over a pty. The core is a process with all of steerd's imports, locked memory and,
where allowed, SCHED_FIFO; it writes a drive frame every 10 ms until it is killed (SIGKILL) or
stopped (SIGSTOP, later SIGCONT) at a random phase of its period. Counted too: motion frames after
the first brake frame. A core is started anew for each trial, as `steerd run` does: one forked from
a warm process would share its memory, dies otherwise, and gave up to 16 ms. Like the real one it
has a thread of ordinary priority, which mostly dies last and takes the memory apart: at the core's
priority that keeps the kernel from passing the guardian's bytes through the pty for up to 54 ms.
`noticed_ms` is when the guardian took over, `ms` when its bytes came out of the pty.

Each trial is one line of the log; the same command again goes on where it ended. Watchers, one a
CPU and above everything in priority, note when the machine itself stood still (`stall_ms`).
"""

import argparse
import contextlib
import json
import os
import pty
import select
import signal
import struct
import subprocess
import sys
import termios
import time
import tty
from pathlib import Path
from typing import Any

import numpy as np

from steerd.daemon.process.heartbeat import HeartbeatPage
from steerd.daemon.process.realtime import enter_realtime
from steerd.vesc_link.commands import SetCurrentBrake, SetErpm
from steerd.vesc_link.frames import FrameParser, encode_frame
from steerd.vesc_link.packets import decode_command, encode_command

DRIVE = encode_frame(encode_command(SetErpm(4000.0)))
BRAKE = encode_frame(encode_command(SetCurrentBrake(20.0)))
ROOT = Path(__file__).parents[1]
PERIOD_NS, BEFORE_NS, AFTER_NS = 10_000_000, 200_000_000, 150_000_000
BOUND_MS = {"kill": 20.0, "stop": 50.0}
STALL_NS = 1_000_000
"""A watcher that wakes later than this has been held up by no program of ours."""
GAP = struct.Struct("=qq")


def be_core(serial_fd: int) -> None:
    """Drive at 100 Hz under a guardian, as `steerd.daemon.process.runner` does."""
    import steerd.daemon.process.core_process  # noqa: F401  (as much memory as the real one)
    from steerd.daemon.ipc.signals import make_stop_signal_pipe
    from steerd.daemon.process.guard import ProcessGuard
    from steerd.daemon.process.realtime import settle_memory

    make_stop_signal_pipe()  # its thread has no fixed priority and often dies last
    report = enter_realtime()
    settle_memory()
    guard = ProcessGuard(report.fifo)
    guard.watch(serial_fd, BRAKE, time.monotonic_ns())
    pause, due = select.poll(), time.monotonic_ns()
    page = guard.page
    assert page is not None
    while not page.words.guardian_ns:
        pause.poll(5)  # as the loop does: nothing is armed before the guardian shows itself
    while True:
        now = time.monotonic_ns()
        page.write_heartbeat(now, engaged=True)
        staged = page.stage(DRIVE)
        if guard.may_write(now, time.monotonic_ns()):
            os.write(serial_fd, staged)
        due = max(due + PERIOD_NS, now)
        pause.poll(max(0, (due - time.monotonic_ns()) // 1_000_000))


def be_watcher(cpu: int, pipe_fd: int) -> None:
    """Wake every millisecond on one CPU, and report how late that was."""
    os.sched_setaffinity(0, {cpu})
    enter_realtime(priority=90)
    pause, hangs_up = select.poll(), select.POLLERR | select.POLLHUP
    pause.register(pipe_fd, hangs_up)
    while True:
        began = time.monotonic_ns()
        if pause.poll(1):
            return
        ended = time.monotonic_ns()
        if ended - began > 1_000_000 + STALL_NS:
            os.write(pipe_fd, GAP.pack(began, ended))


class Watchers:
    """One watcher a CPU; what they saw."""

    def __init__(self) -> None:
        self._read_fd, write_fd = os.pipe()
        os.set_blocking(self._read_fd, False)
        for cpu in sorted(os.sched_getaffinity(0)):
            command = [sys.executable, __file__, "--watch", str(cpu), str(write_fd)]
            subprocess.Popen(command, pass_fds=(write_fd,), cwd=ROOT)
        os.close(write_fd)

    def worst_ms(self, begin_ns: int, end_ns: int) -> float:
        """The longest stall of a CPU that touched an interval, beyond the watcher's own pause."""
        data = b""
        with contextlib.suppress(BlockingIOError):
            data = os.read(self._read_fd, GAP.size * 2048)
        gaps = [g for g in GAP.iter_unpack(data) if g[0] < end_ns and g[1] > begin_ns]
        return max((b - a - 1_000_000 for a, b in gaps), default=0) / 1e6


def read_until(master: int, end_ns: int, log: list[tuple[int, bytes]]) -> None:
    """Read the pty until a moment, noting when bytes came."""
    while (left := end_ns - time.monotonic_ns()) > 0:
        if select.select([master], [], [], left * 1e-9)[0]:
            data = os.read(master, 4096)
            log.append((time.monotonic_ns(), data))


def find_page(core_pid: int) -> HeartbeatPage | None:
    """The page that a core's guardian has, mapped here too."""
    children = Path(f"/proc/{core_pid}/task/{core_pid}/children").read_text(encoding="ascii")
    for child in children.split():
        for link in Path(f"/proc/{child}/fd").iterdir():
            if "steerd-heartbeat" in str(link.readlink()):
                fd = os.open(link, os.O_RDWR)
                page = HeartbeatPage(fd)
                os.close(fd)
                return page
    return None


def run_trial(how: str, phase_ns: int, watchers: Watchers) -> dict[str, Any]:
    """One trial: milliseconds to the first brake frame (None: never), motion frames after it."""
    master, slave = pty.openpty()
    tty.setraw(slave, termios.TCSANOW)
    os.set_blocking(slave, False)
    command = [sys.executable, __file__, "--core", str(slave)]
    core = subprocess.Popen(command, pass_fds=(slave,), cwd=ROOT)
    os.close(slave)
    log: list[tuple[int, bytes]] = []
    while not log:
        read_until(master, time.monotonic_ns() + 50_000_000, log)
    read_until(master, time.monotonic_ns() + BEFORE_NS + phase_ns, log)
    page = find_page(core.pid)
    log.clear()
    hit_ns = time.monotonic_ns()
    core.send_signal(signal.SIGKILL if how == "kill" else signal.SIGSTOP)
    read_until(master, hit_ns + AFTER_NS, log)
    if how == "stop":
        core.send_signal(signal.SIGCONT)
        read_until(master, time.monotonic_ns() + AFTER_NS, log)
        core.kill()
    core.wait()
    os.close(master)
    first_ns, late = judge(log, hit_ns)
    return {
        "how": how,
        "ms": None if first_ns is None else round((first_ns - hit_ns) / 1e6, 3),
        "noticed_ms": round((page.words.tripped_ns - hit_ns) / 1e6, 3) if page else None,
        "motion_after_brake": late,
        "stall_ms": round(watchers.worst_ms(hit_ns, first_ns or hit_ns + AFTER_NS), 2),
        "runnable": Path("/proc/loadavg").read_text(encoding="ascii").split()[3],
    }


def judge(log: list[tuple[int, bytes]], hit_ns: int) -> tuple[int | None, int]:
    """When the first brake frame came, and how many motion frames followed it."""
    parser, first, late = FrameParser(), None, 0
    for t_ns, data in log:
        for payload in parser.feed(data, t_ns):
            if isinstance(decode_command(payload), SetErpm):
                late += first is not None
            elif first is None:
                first = t_ns
    return first, late


def summarise(how: str, rows: list[dict[str, Any]]) -> dict[str, Any]:
    """One kind's row of docs/results/safety.md; no brake frame counts as infinite."""
    took = np.array([np.inf if row["ms"] is None else row["ms"] for row in rows])
    p50, p99 = np.percentile(took, (50, 99), method="higher")
    return {
        "what": "SIGKILL" if how == "kill" else "SIGSTOP",
        "fifo": all(row["fifo"] for row in rows),
        "trials": len(rows),
        "ms_p50": round(float(p50), 2),
        "ms_p99": round(float(p99), 2),
        "ms_max": round(float(took.max()), 2),
        "within_bound": int((took <= BOUND_MS[how]).sum()),
        "bound_ms": BOUND_MS[how],
        "motion_after_brake": sum(row["motion_after_brake"] for row in rows),
        "trials_with_a_stall": sum(row["stall_ms"] > 0 for row in rows),
        "missed": [row for row in rows if row["ms"] is None or row["ms"] > BOUND_MS[how]],
    }


def load_log(path: Path | None) -> list[dict[str, Any]]:
    """The trials that are there already."""
    if path is None or not path.exists():
        return []
    return [json.loads(line) for line in path.read_text(encoding="ascii").splitlines()]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--trials", type=int, default=200, help="of each kind")
    parser.add_argument("--core", type=int, metavar="FD", help=argparse.SUPPRESS)
    parser.add_argument("--watch", type=int, nargs=2, help=argparse.SUPPRESS)
    parser.add_argument("--only", choices=("kill", "stop"), help="one kind")
    parser.add_argument("--seed", type=int, default=0, help="of the phases")
    parser.add_argument("--log", type=Path, help="append each trial here; go on where it ends")
    args = parser.parse_args()
    if args.core is not None:
        be_core(args.core)
    if args.watch is not None:
        be_watcher(*args.watch)
        return 0
    rows, watchers = load_log(args.log), Watchers()
    fifo = enter_realtime(priority=70).fifo
    kinds = [how for how in BOUND_MS if args.only in (None, how)]
    for trial in range(args.trials):
        for how in kinds:
            if sum(row["how"] == how for row in rows) > trial:
                continue
            rng = np.random.default_rng([args.seed, trial, how == "stop"])
            row = run_trial(how, int(rng.integers(PERIOD_NS)), watchers)
            rows.append({"trial": trial, "seed": args.seed, "fifo": fifo, **row})
            if args.log is not None:
                with args.log.open("a", encoding="ascii") as file:
                    file.write(json.dumps(rows[-1]) + "\n")
    for how in kinds:
        print(json.dumps(summarise(how, [row for row in rows if row["how"] == how])), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
