"""From the death of a control core to the first brake byte on a pty, and from its freezing.

    python benchmarks/stop_latency.py --trials 200

A real guardian over a pty. The core is a process with all of steerd's imports, locked memory and,
where allowed, SCHED_FIFO; it writes a drive frame every 10 ms until it is killed (SIGKILL) or
stopped (SIGSTOP, later SIGCONT) at a random phase of its period. Counted too: motion frames after
the first brake frame. A core is started anew for each trial, as `steerd run` does: one forked from
a warm process would share its memory, dies otherwise, and gave up to 16 ms.
"""

import argparse
import json
import os
import pty
import select
import signal
import subprocess
import sys
import termios
import time
import tty
from pathlib import Path

import numpy as np

from daemon.realtime import enter_realtime
from vesc_link.commands import SetCurrentBrake, SetErpm
from vesc_link.frames import FrameParser, encode_frame
from vesc_link.packets import decode_command, encode_command

DRIVE = encode_frame(encode_command(SetErpm(4000.0)))
BRAKE = encode_frame(encode_command(SetCurrentBrake(20.0)))
ROOT = Path(__file__).parents[1]
PERIOD_NS, BEFORE_NS, AFTER_NS = 10_000_000, 200_000_000, 150_000_000


def be_core(serial_fd: int) -> None:
    """Drive at 100 Hz under a guardian, as `daemon.runner` does."""
    import daemon.core_process  # noqa: F401  (as much memory as the real one)
    from daemon.guard import ProcessGuard
    from daemon.realtime import settle_memory

    report = enter_realtime()
    settle_memory()
    guard = ProcessGuard(report.fifo)
    guard.watch(serial_fd, BRAKE, time.monotonic_ns())
    pause, due = select.poll(), time.monotonic_ns()
    while not guard._page.guardian_ns:  # type: ignore[union-attr]  # noqa: SLF001
        pause.poll(5)  # as the loop does: nothing is armed before the guardian shows itself
    while True:
        now = time.monotonic_ns()
        guard.beat(now, engaged=True)
        if guard.may_write(now, time.monotonic_ns()):
            os.write(serial_fd, DRIVE)
        due = max(due + PERIOD_NS, now)
        pause.poll(max(0, (due - time.monotonic_ns()) // 1_000_000))


def read_until(master: int, end_ns: int, log: list[tuple[int, bytes]]) -> None:
    """Read the pty until a moment, noting when bytes came."""
    while (left := end_ns - time.monotonic_ns()) > 0:
        if select.select([master], [], [], left * 1e-9)[0]:
            data = os.read(master, 4096)
            log.append((time.monotonic_ns(), data))


def run_trial(how: str, phase_ns: int) -> tuple[float, int]:
    """One trial: milliseconds to the first brake frame, motion frames after it."""
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
    return judge(log, hit_ns)


def judge(log: list[tuple[int, bytes]], hit_ns: int) -> tuple[float, int]:
    parser, first, late = FrameParser(), float("nan"), 0
    for t_ns, data in log:
        for payload in parser.feed(data, t_ns):
            braked = first == first
            if isinstance(decode_command(payload), SetErpm):
                late += braked
            elif not braked:
                first = (t_ns - hit_ns) / 1e6
    return first, late


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--trials", type=int, default=200, help="of each kind")
    parser.add_argument("--core", type=int, metavar="FD", help=argparse.SUPPRESS)
    parser.add_argument("--only", choices=("kill", "stop"), help="one kind")
    parser.add_argument("--seed", type=int, default=0, help="of the phases")
    parser.add_argument("--raw", action="store_true", help="print each trial's figure too")
    args = parser.parse_args()
    if args.core is not None:
        be_core(args.core)
    fifo = enter_realtime(priority=70).fifo
    rng = np.random.default_rng(args.seed)
    for how, bound in (("kill", 20.0), ("stop", 50.0)):
        if args.only not in (None, how):
            continue
        got = []
        for _ in range(args.trials):
            got.append(run_trial(how, int(rng.integers(PERIOD_NS))))
            if args.raw:
                print(how, f"{got[-1][0]:.2f}", got[-1][1], flush=True)
        took = np.array([ms for ms, _ in got])
        print(
            json.dumps(
                {
                    "what": "SIGKILL" if how == "kill" else "SIGSTOP",
                    "fifo": fifo,
                    "trials": len(got),
                    "ms_p50": round(float(np.percentile(took, 50)), 2),
                    "ms_p99": round(float(np.percentile(took, 99)), 2),
                    "ms_max": round(float(took.max()), 2),
                    "within_bound": int((took <= bound).sum()),
                    "bound_ms": bound,
                    "motion_after_brake": sum(late for _, late in got),
                }
            ),
            flush=True,
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
