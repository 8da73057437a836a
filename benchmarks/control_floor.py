"""What the machine itself takes of the control path.

    python -m benchmarks.control_floor

The path with nothing in it: a C program, compiled on the spot, stands where the core stands and
answers every datagram with bytes at once; sockets, pty, priorities and the stamping process are
those of the real path. And the price of a rest: the core's tick on the same events, one after the
other and with the process asleep in between, as it is in a car.
"""

import contextlib
import json
import os
import select
import shutil
import socket
import subprocess
import sys
import tempfile
import time
import tty
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from benchmarks.control_path import percentiles
from benchmarks.perf_virtual import plan_of
from steerd.daemon.assembly.build import make_world_config
from steerd.daemon.offline.virtual import VirtualRun, make_virtual_run
from steerd.daemon.process.realtime import enter_realtime, keep_busy, settle_memory
from steerd.sim_hw.world import World
from steerd.steer_bus.clock import MonotonicClock

CLOCK = MonotonicClock()
RATE, SECONDS = 200, 6.0
_BYTES = 24
"""Of one tick's write, about."""
_ECHO = """
#include <arpa/inet.h>
#include <fcntl.h>
#include <sched.h>
#include <stdio.h>
#include <sys/mman.h>
#include <unistd.h>
int main(int count, char **arguments) {
    struct sched_param priority = {50};
    struct sockaddr_in here = {0};
    socklen_t size = sizeof here;
    char data[65536] = {0};
    int in = socket(AF_INET, SOCK_DGRAM, 0), out = open(arguments[1], O_RDWR | O_NOCTTY);
    sched_setscheduler(0, SCHED_FIFO, &priority);
    mlockall(MCL_CURRENT | MCL_FUTURE);
    here.sin_family = AF_INET;
    here.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    bind(in, (struct sockaddr *)&here, sizeof here);
    getsockname(in, (struct sockaddr *)&here, &size);
    printf("%d\\n", ntohs(here.sin_port));
    fflush(stdout);
    while (recv(in, data, sizeof data, 0) > 0)
        if (write(out, data, BYTES) < 0) return 1;
    return 0;
}
"""


def bare_path() -> dict[str, float]:
    """From datagram to bytes through the C program [ms]."""
    with tempfile.TemporaryDirectory() as folder, contextlib.ExitStack() as stack:
        source, program = Path(folder) / "echo.c", Path(folder) / "echo"
        source.write_text(_ECHO.replace("BYTES", str(_BYTES)), encoding="ascii")
        subprocess.run(["cc", "-O2", str(source), "-o", str(program)], check=True)
        near, far = os.openpty()
        stack.callback(os.close, near)
        stack.callback(os.close, far)
        tty.setraw(far)
        command = [str(program), os.ttyname(far)]
        echo = stack.enter_context(subprocess.Popen(command, stdout=subprocess.PIPE, text=True))
        stack.callback(echo.kill)
        sender = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
        sender.connect(("127.0.0.1", int(echo.stdout.readline() if echo.stdout else 0)))
        return percentiles(measure_answers(sender, near))


def measure_answers(sender: socket.socket, near: int) -> list[int]:
    """How long each answer took [ns]."""
    found, due = [], CLOCK.now_ns()
    for _ in range(round(RATE * SECONDS)):
        due += 1_000_000_000 // RATE
        time.sleep(max(due - CLOCK.now_ns(), 0) * 1e-9)
        sent = CLOCK.now_ns()
        sender.send(bytes(256))
        select.select([near], [], [])
        os.read(near, 4096)
        found.append(CLOCK.now_ns() - sent)
    return found


def ticking(rest: Callable[[int], None]) -> dict[str, float]:
    """The core's tick in virtual time, every one with a fresh pose [ms]; `rest` comes between."""
    plan = plan_of(RATE)
    config = make_world_config(plan)
    config = replace(config, mocap=replace(config.mocap, rate_hz=RATE))
    run: VirtualRun = make_virtual_run(plan, (lambda _records, _t_ns: None,), World(config))
    spent: list[int] = []
    tick, post_tick = run.core.tick, run.core.post_tick

    def timed_tick(due_ns: int, now_ns: int, work_ns: int = 0) -> bytes:
        rest(len(spent))
        began = CLOCK.now_ns()
        wire = tick(due_ns, now_ns, work_ns)
        spent.append(CLOCK.now_ns() - began)
        return wire

    def timed_post_tick(written: bytes) -> None:
        began = CLOCK.now_ns()
        post_tick(written)
        spent[-1] += CLOCK.now_ns() - began

    run.core.tick, run.core.post_tick = timed_tick, timed_post_tick  # type: ignore[method-assign]
    while len(spent) < RATE * (2 + SECONDS):
        run.step()
    return percentiles(spent[2 * RATE :])


def until_due(begin_ns: int) -> Callable[[int], None]:
    """Sleep until a tick of this rate is due, as the runner does."""

    def rest(number: int) -> None:
        due = begin_ns + number * 1_000_000_000 // RATE
        time.sleep(max(due - CLOCK.now_ns(), 0) * 1e-9)

    return rest


def main() -> int:
    enter_realtime(60)
    settle_memory()
    said: dict[str, Any] = {"rate": RATE, "bare": {}}
    if shutil.which("cc"):
        for name, busy in (("idle", 0), ("loaded", os.cpu_count() or 1)):
            with keep_busy(busy):
                said["bare"][name] = bare_path()
    in_a_row = ticking(lambda _number: None)
    said["tick"] = {"in a row": in_a_row, "after a sleep": ticking(until_due(CLOCK.now_ns()))}
    print(json.dumps(said))
    return 0


if __name__ == "__main__":
    sys.exit(main())
