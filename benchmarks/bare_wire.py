"""The control path with nothing in it: what the machine itself takes.

A C program, compiled on the spot, stands where the core stands: a datagram comes, bytes for the
VESC leave at once. Sockets, pty, priorities and the stamping process are those of the real path.
"""

import contextlib
import os
import select
import shutil
import socket
import subprocess
import tempfile
import time
import tty
from pathlib import Path

from steer_bus.clock import MonotonicClock

_CLOCK = MonotonicClock()
_ORDER = 24
"""Bytes of one tick's write, about."""
_ECHO = """
#include <arpa/inet.h>
#include <fcntl.h>
#include <sched.h>
#include <stdio.h>
#include <sys/mman.h>
#include <unistd.h>
int main(int argc, char **argv) {
    struct sched_param priority = {50};
    struct sockaddr_in here = {0};
    socklen_t size = sizeof here;
    char data[65536] = {0};
    int in = socket(AF_INET, SOCK_DGRAM, 0), out = open(argv[1], O_RDWR | O_NOCTTY);
    if (argc > 2) sched_setscheduler(0, SCHED_FIFO, &priority);
    mlockall(MCL_CURRENT | MCL_FUTURE);
    here.sin_family = AF_INET;
    here.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    bind(in, (struct sockaddr *)&here, sizeof here);
    getsockname(in, (struct sockaddr *)&here, &size);
    printf("%d\\n", ntohs(here.sin_port));
    fflush(stdout);
    while (recv(in, data, sizeof data, 0) > 0)
        if (write(out, data, ORDER) < 0) return 1;
    return 0;
}
"""


def _compiled(folder: Path) -> Path | None:
    compiler = shutil.which("cc")
    if compiler is None:
        return None
    source, program = folder / "echo.c", folder / "echo"
    source.write_text(_ECHO.replace("ORDER", str(_ORDER)), encoding="ascii")
    subprocess.run([compiler, "-O2", str(source), "-o", str(program)], check=True)
    return program


def bare_path_ns(rate: int, seconds: float, fifo: bool) -> list[int]:
    """From datagram to bytes through the C program [ns], `rate` times a second; empty without cc.

    For a process that has `tap`'s priority.
    """
    with tempfile.TemporaryDirectory() as folder, contextlib.ExitStack() as stack:
        program = _compiled(Path(folder))
        if program is None:
            return []
        near, far = os.openpty()
        stack.callback(os.close, near)
        stack.callback(os.close, far)
        tty.setraw(far)
        command = [str(program), os.ttyname(far), *(["fifo"] if fifo else [])]
        echo = stack.enter_context(subprocess.Popen(command, stdout=subprocess.PIPE, text=True))
        stack.callback(echo.kill)
        sender = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
        port = int(echo.stdout.readline()) if echo.stdout else 0
        return _timed(sender, port, near, rate, round(rate * seconds))


def _timed(sender: socket.socket, port: int, near: int, rate: int, count: int) -> list[int]:
    found, due = [], _CLOCK.now_ns()
    for _ in range(count):
        due += 1_000_000_000 // rate
        time.sleep(max(due - _CLOCK.now_ns(), 0) * 1e-9)
        sent = _CLOCK.now_ns()
        sender.sendto(bytes(256), ("127.0.0.1", port))
        select.select([near], [], [])
        os.read(near, 4096)
        found.append(_CLOCK.now_ns() - sent)
    return found
