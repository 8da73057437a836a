"""Soak: hours of real-time driving over the pty, and whether anything grows.

    python -m benchmarks.soak --minutes 20
    python -m benchmarks.soak --minutes 60 --log soak.jsonl
    python -m benchmarks.soak --minutes 120 --fuzz

Simulated hardware at 200 Hz with recorder, gateway and view, as `steerd run --sim --view`. Every
five seconds: descriptors, threads, resident memory of each process, bytes that wait in its pipes
and sockets. Afterwards the session is read: whole or not, late ticks in each quarter. What is
compared is the second quarter with the last. With `--log` each run is one line more: slices of a
long soak, on different days if need be, are summed up. A machine that is busy stops the car (a
simulated one tolerates 250 ms); the slice then ends, with its reason.

`--fuzz` starts two strangers (`soak_strangers.py`): one sends 1000 messages a second of nonsense to
bus, page and viewer, one stops the car for real once a minute and starts it again. A stop counts as
missed when the car's state has not changed 0.2 s after it was sent; whatever else stops the car is
a false stop.
"""

import argparse
import contextlib
import fcntl
import json
import os
import re
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import termios
import time
from collections import defaultdict
from collections.abc import Iterator
from itertools import starmap
from math import inf
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

ROOT = Path(__file__).parents[1]
SAMPLE_S = 5.0
WARM_S = 20.0
"""Processes start and caches fill; not judged."""
RSS_MIB_PER_H = {"recorder": 2.0}
"""Growth of resident memory that counts as flat; the recorder keeps the index of its chunks."""
NAMES = ("core", "guardian", "recorder", "gateway", "view", "hardware", "world")
STOP_S = 0.2
"""A stop that takes longer, from its sending to the tick that brakes, is missed."""
PAGE_KIB = os.sysconf("SC_PAGE_SIZE") // 1024


class Sample(NamedTuple):
    """One process at one moment: `waiting` bytes in its pipes and UDP sockets."""

    t: float
    name: str
    fds: int
    threads: int
    rss_mib: float
    waiting: int


def list_processes(root: int) -> Iterator[tuple[int, str]]:
    """The process and all below it, with names."""
    yield root, name_of(root)
    for task in Path(f"/proc/{root}/task").glob("*/children"):
        for child in task.read_text().split():
            yield from list_processes(int(child))


def name_of(pid: int) -> str:
    """What a process is for, by its command line."""
    words = Path(f"/proc/{pid}/cmdline").read_bytes().replace(b"\0", b" ").decode()
    found = re.search(r"steerd[.](?:daemon[.]process|sim_hw[.]real_time)[.](\w+)", words)
    if found:
        return found.group(1)
    return next((name for name in NAMES if name in words), "run")


def measure(pid: int, name: str, t: float) -> Sample:
    """Descriptors, threads, memory and what waits."""
    status = Path(f"/proc/{pid}/status").read_text()
    threads = int(re.search(r"Threads:\s+(\d+)", status)[1])  # type: ignore[index]
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    links = list(Path(f"/proc/{pid}/fd").iterdir())
    waiting = sum(count_waiting(link) for link in links) + count_datagrams(pid, links)
    return Sample(t, name, len(links), threads, pages * PAGE_KIB / 1024, waiting)


def count_waiting(link: Path) -> int:
    """Bytes in a pipe."""
    try:
        if not str(link.readlink()).startswith("pipe:"):
            return 0
        fd = os.open(link, os.O_RDONLY | os.O_NONBLOCK)
    except OSError:
        return 0
    try:
        return int(struct.unpack("i", fcntl.ioctl(fd, termios.FIONREAD, b"\0" * 4))[0])
    finally:
        os.close(fd)


def count_datagrams(pid: int, links: list[Path]) -> int:
    """Bytes in its UDP sockets."""
    inodes = set()
    for link in links:
        with contextlib.suppress(OSError):
            inodes |= set(re.findall(r"socket:\[(\d+)\]", str(link.readlink())))
    rows = [line.split() for line in Path(f"/proc/{pid}/net/udp").read_text().splitlines()[1:]]
    return sum(int(row[4].split(":")[1], 16) for row in rows if row[9] in inodes)


def free_port() -> int:
    """A TCP port on loopback that nobody uses now."""
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return int(listener.getsockname()[1])


class Driven(NamedTuple):
    """A drive: samples, exit code, what was printed, and what the strangers printed."""

    samples: list[Sample]
    code: int
    said: str
    strangers: list[dict[str, Any]]


class Strangers:
    """The processes of `--fuzz`, from the moment in which the car's page and viewer are there."""

    def __init__(self, endpoint: str, seconds: float, every: float) -> None:
        self._endpoint, self._seconds, self._every = endpoint, f"{seconds:g}", f"{every:g}"
        self._started: list[subprocess.Popen[str]] = []
        self._out = tempfile.TemporaryFile("w+")  # noqa: SIM115

    def start(self, said: str) -> None:
        """Start them once; nothing before both addresses were printed."""
        page, view = (re.search(rf"{what}: (\S+)", said) for what in ("page", "view"))
        if self._started or page is None or view is None or "RUNNING" not in said:
            return
        for what in (
            ("fuzz", self._endpoint, page[1], view[1], self._seconds, "29"),
            ("stops", self._endpoint, page[1], self._seconds, self._every),
        ):
            command = [sys.executable, str(ROOT / "benchmarks" / "soak_strangers.py"), *what]
            self._started.append(
                subprocess.Popen(command, stdin=subprocess.PIPE, stdout=self._out, text=True)
            )

    def end(self) -> list[dict[str, Any]]:
        """End them; what they printed."""
        for process in self._started:
            process.communicate(timeout=30)
        self._out.seek(0)
        return [json.loads(line) for line in self._out]


def drive(minutes: float, session: Path, rate: float, every: float | None) -> Driven:
    """Drive, and look every few seconds; with strangers where there is a time between stops."""
    endpoint, view = (f"127.0.0.1:{free_port()}" for _ in range(2))
    command = [
        sys.executable, "-m", "steerd", "run", "--sim", "--auto-arm", "--path", "figure8",
        "--speed", "1.5", "--rate", f"{rate:g}", "--record", str(session), "--view", view,
        "--listen", f"tcp/{endpoint}", *(() if every is None else ("--page",)),
    ]  # fmt: skip
    samples: list[Sample] = []
    limit = minutes * 60  # no --duration: a drive that ends by itself was stopped
    strangers = Strangers(f"tcp/{endpoint}", limit, every or 0.0)
    with tempfile.TemporaryFile("w+") as said:
        began = time.monotonic()
        run = subprocess.Popen(
            command,
            cwd=ROOT,
            stdout=said,
            stderr=said,
            stdin=subprocess.DEVNULL,
            env={**os.environ, "PYTHONUNBUFFERED": "1"},
        )
        while run.poll() is None:
            with contextlib.suppress(subprocess.TimeoutExpired):
                run.wait(SAMPLE_S)
            t = time.monotonic() - began
            with contextlib.suppress(OSError):  # a process that is just ending
                samples += [measure(pid, name, t) for pid, name in list_processes(run.pid)]
            if every is not None and t < limit:
                strangers.start(os.pread(said.fileno(), 1 << 16, 0).decode())
            if t > limit:
                events = strangers.end()
                run.send_signal(signal.SIGTERM)
                limit = inf
        said.seek(0)
        return Driven(
            samples, run.returncode, said.read(), events if limit == inf else strangers.end()
        )


def judge_stops(session: Path, events: list[dict[str, Any]]) -> dict[str, Any]:
    """How long each stop took, which were missed, and what else stopped the car."""
    from steerd.daemon.loop.transitions import SupervisorState
    from steerd.steer_bus.session_read import open_session

    path = session if session.exists() else session.with_name(session.name + ".partial")
    records = open_session(path).messages("/steerd/car1/transition")
    left = [(r.log_ns, r.decode()) for r in records]
    left = [(t, c) for t, c in left if c.from_state == SupervisorState.RUNNING]
    took: list[float] = []
    for sent in (each for each in events if "kind" in each):
        answers = [t for t, _ in left if 0 <= t - sent["t_ns"] <= STOP_S * 1e9]
        took.append((answers[0] - sent["t_ns"]) * 1e-6 if answers else inf)
        left = [(t, c) for t, c in left if t not in answers]
    end = [c.text for _, c in left]
    return {
        "stops": len(took),
        "missed": sum(ms == inf for ms in took),
        "worst_ms": max((ms for ms in took if ms < inf), default=inf),
        "median_ms": median(took) if took else inf,
        "false": end[:-1] if end and end[-1].startswith("disarm") else end,
        "nonsense": [each for each in events if "kind" not in each],
    }


def read_ticks(session: Path) -> dict[str, Any]:
    """What the session holds of the loop: late ticks in each quarter, and whether it is whole."""
    from steerd.steer_bus.messages import Tick
    from steerd.steer_bus.session_read import open_session

    path = session if session.exists() else session.with_name(session.name + ".partial")
    read = open_session(path)
    ticks = read.columns(Tick)
    late = [
        (woke - due) * 1e-6 for woke, due in zip(ticks["woke_ns"], ticks["due_ns"], strict=True)
    ]
    quarter = max(1, len(late) // 4)
    return {
        "whole": path == session and not read.info().warnings,
        "ticks": len(late),
        "late_5ms": [
            int(sum(ms > 5.0 for ms in late[k * quarter : (k + 1) * quarter])) for k in range(4)
        ],
        "p99_ms": float(sorted(late)[int(0.99 * len(late))]) if late else float("nan"),
        "worst_ms": float(max(late, default=float("nan"))),
    }


def compare(samples: list[Sample]) -> dict[str, dict[str, Any]]:
    """Of each process: second quarter against last, and the largest queue."""
    by_name: dict[str, list[Sample]] = defaultdict(list)
    for sample in samples:
        by_name[sample.name].append(sample)
    end = max((s.t for s in samples), default=0.0)
    found = {}
    for name, all_ in by_name.items():
        warm = [s for s in all_ if WARM_S < s.t < end - SAMPLE_S]
        quarter = len(warm) // 4
        if not quarter:
            continue
        early, late = warm[quarter : 2 * quarter], warm[-quarter:]
        hours = (median(s.t for s in late) - median(s.t for s in early)) / 3600.0
        growth = median(s.rss_mib for s in late) - median(s.rss_mib for s in early)
        found[name] = {
            "fds": [max(s.fds for s in part) for part in (early, late)],
            "threads": [max(s.threads for s in part) for part in (early, late)],
            "rss_mib": [round(median(s.rss_mib for s in part), 2) for part in (early, late)],
            "rss_mib_per_h": round(growth / hours, 2) if hours else 0.0,
            "waiting": [max(s.waiting for s in part) for part in (early, late)],
        }
    return found


def is_flat(name: str, process: dict[str, Any]) -> bool:
    """Whether nothing of a process grew."""
    same = all(process[key][1] <= process[key][0] for key in ("fds", "threads"))
    return same and process["rss_mib_per_h"] <= RSS_MIB_PER_H.get(name, 1.0)


def show(result: dict[str, Any]) -> None:
    """Print one run."""
    print("| process | descriptors | threads | memory MiB | MiB/h | waiting bytes |")
    print("|---|---|---|---|---|---|")
    for name, p in result["processes"].items():
        fds, threads, waiting = (f"{a} to {b}" for a, b in (p["fds"], p["threads"], p["waiting"]))
        rss = "{} to {}".format(*p["rss_mib"])
        print(f"| {name} | {fds} | {threads} | {rss} | {p['rss_mib_per_h']:+} | {waiting} |")
    ticks = result["ticks"]
    print(
        f"{result['driven_s']:.0f} s, exit {result['exit']}; {ticks['ticks']} ticks, later than"
        f" 5 ms by quarters {ticks['late_5ms']}, p99 {ticks['p99_ms']:.2f} ms, worst"
        f" {ticks['worst_ms']:.1f} ms; session {'whole' if ticks['whole'] else 'NOT whole'}"
    )


def main() -> int:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=20.0, help="of this slice")
    parser.add_argument("--rate", type=float, default=200.0, metavar="HZ")
    parser.add_argument("--fuzz", action="store_true", help="strangers, and a real stop a minute")
    parser.add_argument(
        "--stop-every", type=float, default=60.0, metavar="S", help="with --fuzz (default 60)"
    )
    parser.add_argument("--log", type=Path, help="slices so far; this one is added")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        session = Path(folder) / "soak.mcap"
        every = args.stop_every if args.fuzz else None
        samples, code, said, events = drive(args.minutes, session, args.rate, every)
        ticks = read_ticks(session)
        stops = judge_stops(session, events) if args.fuzz else None
    processes = compare(samples)
    driven = max((s.t for s in samples), default=0.0)
    result = {
        "minutes": args.minutes, "driven_s": driven, "exit": code, "ticks": ticks,
        "processes": processes, "said": said.splitlines()[-6:], "stops": stops,
    }  # fmt: skip
    show(result)
    ended = code == 0  # an emergency stop, which strangers call, is a safety stop: 5
    if stops is not None:
        print(
            "{stops} stops, {missed} missed, median {median_ms:.1f} ms, worst {worst_ms:.1f} ms;"
            " false stops: {false}; nonsense: {nonsense}".format(**stops)
        )
        ended = code in (0, 5) and not stops["missed"] and not stops["false"] and stops["stops"] > 0
    good = ended and ticks["whole"] and all(starmap(is_flat, processes.items()))
    if not good:
        print("\n".join(result["said"]))
    if args.log:
        with args.log.open("a", encoding="utf-8") as log:
            log.write(json.dumps(result) + "\n")
        runs = [json.loads(line) for line in args.log.read_text(encoding="utf-8").splitlines()]
        hours = sum(run["driven_s"] for run in runs) / 3600.0
        print(f"{len(runs)} slices, {hours:.2f} h in all")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
