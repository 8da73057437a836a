"""From a mocap datagram to the VESC's bytes, both ends stamped in a process of their own.

    python -m benchmarks.control_path --seconds 8

Real processes (core, recorder, gateway, guardian) drive simulated hardware. Between them sits a
tap: it passes datagrams and serial bytes on and stamps both (CLOCK_MONOTONIC), so that neither
the core nor the simulation times itself: `path`. In step with mocap, the core ticks as a pose
comes in; before that, poses wait for the next deadline. `work` is the core's own work in a tick,
as recorded; `late`, how far past its deadline a tick began. A machine that stalls rightly stops
the car; the drive is then called `stopped`.
"""

import argparse
import contextlib
import json
import math
import multiprocessing as mp
import os
import select
import socket
import sys
import tempfile
import tty
from collections.abc import Iterator
from dataclasses import replace
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np

from steerd.daemon.assembly.build import RunId, make_plan, make_world_config
from steerd.daemon.ipc.pipe_records import unpack_records
from steerd.daemon.loop.transitions import SupervisorState
from steerd.daemon.process.children import RunProcesses, start_processes
from steerd.daemon.process.realtime import keep_busy
from steerd.daemon.settings.run_options import RunOptions
from steerd.sim_hw.real_time.links import spawn_sim
from steerd.steer_bus import messages as m
from steerd.steer_bus import topics
from steerd.steer_bus.clock import MonotonicClock
from steerd.steer_bus.codec import decode
from steerd.steer_bus.session_read import open_session

CLOCK = MonotonicClock()
BOOT_ID = 815
FRAME = b"\x07\x00"
"""A NatNet frame of data begins so."""
RATES = (100, 200, 500)


def tap(port: str, server: tuple[str, int], pipe: Connection) -> None:
    """Pass bytes between core and hardware until a stop message; then report the times."""
    with contextlib.suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(60))
    near, far = os.openpty()
    tty.setraw(far)
    device = os.open(port, os.O_RDWR | os.O_NOCTTY)
    tty.setraw(device)
    client, upstream = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))
    client.bind(("127.0.0.1", 0))
    upstream.connect(server)
    pipe.send((os.ttyname(far), client.getsockname()[1]))
    core: Any = None
    frames: list[int] = []
    orders: list[int] = []
    while True:
        ready, _, _ = select.select([near, device, client, upstream, pipe], [], [])
        if upstream in ready:
            data = upstream.recv(65536)
            if core is not None:
                stamp = CLOCK.now_ns()
                client.sendto(data, core)
                if data.startswith(FRAME):
                    frames.append(stamp)
        if near in ready:
            data = os.read(near, 4096)
            orders.append(CLOCK.now_ns())
            os.write(device, data)
        if device in ready:
            os.write(near, os.read(device, 4096))
        if client in ready:
            data, core = client.recvfrom(65536)
            upstream.send(data)
        if pipe in ready:
            pipe.send((frames, orders))
            return


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def cpu_s(pid: int) -> float:
    """User and system time of a process [s]; NaN once it is gone."""
    if not Path(f"/proc/{pid}/stat").exists():
        return math.nan
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def guardian_of(core: int) -> list[int]:
    text = Path(f"/proc/{core}/task/{core}/children").read_text(encoding="ascii")
    return [int(pid) for pid in text.split()]


def read_records(processes: RunProcesses, buffer: bytearray, seconds: float) -> bool:
    """Read the core's records for a while; return whether the car moves."""
    end, moves = CLOCK.now_ns() + round(seconds * 1e9), False
    while (left := end - CLOCK.now_ns()) > 0:
        if select.select([processes.fds["status"]], [], [], left * 1e-9)[0]:
            data = os.read(processes.fds["status"], 1 << 16)
            if not data:
                return moves
            buffer += data
            for record in unpack_records(buffer):
                if record.topic is topics.STATE:
                    moves = moves or decode(m.StateMessage, record.data).speed > 0.3
    return moves


def wait_moving(processes: RunProcesses) -> None:
    buffer = bytearray()
    for _ in range(60):
        if read_records(processes, buffer, 0.2):
            return
    raise TimeoutError("the car never drove")


def set_scheduling(pids: list[int], fifo: bool) -> bool:
    """Core and guardian under SCHED_FIFO (as they ask for themselves) or not; whether granted."""
    granted = os.sched_getscheduler(pids[0]) & ~os.SCHED_RESET_ON_FORK == os.SCHED_FIFO
    if granted and not fifo:
        for pid in pids:
            os.sched_setscheduler(pid, os.SCHED_OTHER, os.sched_param(0))
    return granted and fifo


def percentiles(values: Any) -> dict[str, float]:
    """p50, p99, p99.9 and the worst [ms]."""
    ms = np.asarray(values) / 1e6
    if not ms.size:
        return {"p50": math.nan, "p99": math.nan, "p999": math.nan, "max": math.nan, "n": 0}
    p50, p99, p999 = np.percentile(ms, [50, 99, 99.9]).round(3).tolist()
    return {"p50": p50, "p99": p99, "p999": p999, "max": round(float(ms.max()), 3), "n": ms.size}


def judge(session: Path, frames: list[int], orders: list[int], begin: int, end: int) -> Any:
    """Figures of one drive between two moments [ns]."""
    drive = open_session(session)
    ticks, changes = drive.columns(m.Tick), drive.columns(m.Transition)
    epoch = int(ticks["stamp_ns"][0] - ticks["woke_ns"][0])
    reached = changes["to_state"][changes["stamp_ns"] - epoch < end]
    due, woke, work = (ticks[name] for name in ("due_ns", "woke_ns", "work_ns"))
    numbers = ticks["seq"].astype(np.int64)
    inside = (due >= begin) & (due < end)
    sent, mocap = np.array(orders), np.array(frames)
    mocap = mocap[(mocap >= begin) & (mocap < end)]
    # The tick that answers a datagram is the first that wakes after it.
    tick = np.searchsorted(woke, mocap)
    kept = tick < due.size
    tick, mocap = tick[kept], mocap[kept]
    answer = np.searchsorted(sent, woke[tick])
    kept = answer < sent.size
    return {
        "path_ms": percentiles(sent[answer[kept]] - mocap[kept]),
        "late_ms": percentiles(np.maximum(woke - due, 0)[inside]),
        "work_ms": percentiles(work[inside]),
        "ticks": int(inside.sum()),
        "stopped": bool(
            np.isin(reached, [SupervisorState.FAULT_STOP, SupervisorState.ESTOP]).any()
        ),
        "unrecorded": int(numbers[-1] - numbers[0]) + 1 - numbers.size,
    }


def measure(
    rate: int, seconds: float, busy: bool, fifo: bool, learns: bool = False
) -> dict[str, Any]:
    """One drive, with a learner or without."""
    options = RunOptions(
        car_file="", path="figure8", speed=1.0, rate_hz=float(rate), simulated=True, auto_arm=True,
        duration_s=60.0, listen=f"tcp/127.0.0.1:{free_port()}", learn=learns,
    )  # fmt: skip
    config = make_world_config(make_plan(options))
    config = replace(config, mocap=replace(config.mocap, rate_hz=rate), keep_bytes=False)
    context = mp.get_context("spawn")
    with tempfile.TemporaryDirectory() as folder, spawn_sim(config) as sim:
        ours, theirs = context.Pipe()
        url = urlsplit(sim.mocap_url)
        server = (str(url.hostname), int(url.port or 0))
        tapping = context.Process(target=tap, args=(sim.port, server, theirs), daemon=True)
        tapping.start()
        port, mocap = ours.recv()
        where = sim.mocap_url.replace(f":{server[1]}/", f":{mocap}/")
        real = RunId(BOOT_ID, CLOCK.realtime_ns() - CLOCK.now_ns(), leased=False)
        plan = make_plan(replace(options, port=port, mocap=where), real=real)
        session = Path(folder) / "drive.mcap"
        processes = start_processes(plan, session)
        try:
            wait_moving(processes)
            core = processes.core.process.pid
            guardian = guardian_of(core)
            granted = set_scheduling([core, *guardian], fifo)
            # A real car needs no CPU: the simulated one must not starve beside the load.
            with contextlib.suppress(OSError):
                os.sched_setscheduler(int(sim.process.pid or 0), os.SCHED_FIFO, os.sched_param(40))
            pids = {"core": core, "recorder": processes.children["recorder"].process.pid,
                    "gateway": processes.children["gateway"].process.pid, "guardian": guardian[0],
                    "simulation": sim.process.pid, "tap": tapping.pid}  # fmt: skip
            with keep_busy(os.cpu_count() or 1 if busy else 0):
                read_records(processes, bytearray(), 1.0)
                before, begin = {n: cpu_s(p) for n, p in pids.items()}, CLOCK.now_ns()
                read_records(processes, bytearray(), seconds)
                end = CLOCK.now_ns()
                share = {n: (cpu_s(p) - before[n]) / (end - begin) * 1e9 for n, p in pids.items()}
            ours.send("stop")
            frames, orders = ours.recv()
        finally:
            processes.core.process.terminate()
            processes.requests.close()
            read_records(processes, bytearray(), 0.5)
            processes.end()
            tapping.join(5)
        found = judge(session, frames, orders, begin, end)
    shares = {name: round(100.0 * value, 1) for name, value in share.items()}
    how = {"rate": rate, "busy": busy, "fifo": granted, "learns": learns}
    return {**how, **found, "cpu_percent": shares}


def measure_with_retries(
    rate: int, seconds: float, busy: bool, fifo: bool, learns: bool = False
) -> dict[str, Any]:
    """One drive, begun again where the machine stalled before the car moved."""
    for _ in range(2):
        with contextlib.suppress(TimeoutError):
            return measure(rate, seconds, busy, fifo, learns)
    return measure(rate, seconds, busy, fifo, learns)


def learner_rows(pairs: int, rate: int, seconds: float) -> Iterator[dict[str, Any]]:
    """Drives without and with a learner, in turn; which comes first alternates."""
    for pair in range(pairs):
        for learns in (False, True) if pair % 2 == 0 else (True, False):
            yield measure_with_retries(rate, seconds, False, True, learns)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=8.0, help="measured in each drive")
    parser.add_argument("--rates", type=int, nargs="*", default=RATES)
    text = "instead: so many drives with `--learn` beside so many without, at 100 Hz"
    parser.add_argument("--learn", type=int, default=0, metavar="PAIRS", help=text)
    args = parser.parse_args()
    for row in learner_rows(args.learn, 100, args.seconds):
        print(json.dumps(row), flush=True)
    for rate in () if args.learn else args.rates:
        for busy in (False, True):
            for fifo in (True, False):
                print(json.dumps(measure_with_retries(rate, args.seconds, busy, fifo)), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
