"""Whoever drives goes: from that moment to the first slower order on the serial wire.

    python -m tests.safety.hands --trials 5 --log hands.jsonl

Simulated hardware and daemon as processes, in real time; a tap between them reads what the VESC is
sent. A page of `steerd page` (a socket that speaks as the browser's script does) or a gamepad of
`steerd teleop` drives at 1 m/s, and then is killed, frozen, closed or silent. Counted from the
signal to the first order that is 1 % slower, or brakes. Each trial is one line of the log; the same
command again goes on where it ended.
"""

import argparse
import json
import os
import pty
import select
import signal
import statistics
import sys
import tempfile
import threading
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

from steerd.daemon.loop.transitions import SupervisorState
from steerd.vesc_link.commands import SetErpm
from steerd.vesc_link.frames import FrameParser
from steerd.vesc_link.packets import decode_command
from tests.e2e.conftest import Launcher, Program
from tests.e2e.test_live import CIRCLE, Watcher
from tests.e2e.test_live_page import live, until
from tests.e2e.test_teleop import ABS, AXES, BUTTONS, KEY, Hand, press_until_driving

SPEAK_S = 0.05  # how often the page's script says that it is there
DRIVE_S = 1.5
_AT_REST = (SupervisorState.DISARMED, SupervisorState.READY)
_SIGNALS = {"killed": signal.SIGKILL, "frozen": signal.SIGSTOP}


class Tap:
    """A pty between daemon and VESC; what the daemon writes is noted with its time.

    Attributes:
        port: what the daemon opens.
        written: time [ns] and bytes.
    """

    def __init__(self, vesc: str) -> None:
        self._master, self._slave = pty.openpty()
        tty.setraw(self._slave)
        self.port = os.ttyname(self._slave)
        self._vesc = os.open(vesc, os.O_RDWR | os.O_NOCTTY)
        tty.setraw(self._vesc)
        self.written: list[tuple[int, bytes]] = []
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._copy)
        self._thread.start()

    def _copy(self) -> None:
        ends = {self._master: self._vesc, self._vesc: self._master}
        while not self._ended.is_set():
            for source in select.select(list(ends), [], [], 0.1)[0]:
                data = os.read(source, 65536)
                if source == self._master:
                    self.written.append((time.monotonic_ns(), data))
                os.write(ends[source], data)

    def first_slower(self, gone_ns: int) -> float | None:
        """Milliseconds until an order 1 % below the usual one, or a brake; None: not seen."""
        parser, usual = FrameParser(), 0.0
        for t_ns, data in list(self.written):
            for payload in parser.feed(data, t_ns):
                order = decode_command(payload)
                erpm = order.erpm if isinstance(order, SetErpm) else None
                if t_ns < gone_ns:
                    usual = erpm or usual
                elif (erpm is None and "Brake" in type(order).__name__) or (
                    erpm is not None and erpm < 0.99 * usual
                ):
                    return (t_ns - gone_ns) / 1e6
        return None

    def close(self) -> None:
        self._ended.set()
        self._thread.join()
        for fd in (self._master, self._slave, self._vesc):
            os.close(fd)


Go = Callable[[str], int]  # ends the driving in the named way; when that was [ns]


def press_until_driving_there(socket: Any) -> None:
    """Press the page's buttons as a person does: again, if the car fell back."""
    pressed = 0.0

    def driving(seen: dict[str, Any]) -> bool:
        nonlocal pressed
        word = {"READY": "arm", "ARMED": "start"}.get(seen["state"])
        if word and time.monotonic() > pressed + 1.0:
            pressed = time.monotonic()
            socket.send(word)
        return bool(seen["state"] == "RUNNING")

    until(socket, driving)


@contextmanager
def page(steerd: Launcher, run: Program, folder: Path) -> Iterator[Go]:
    """A page that drives the car."""
    server = steerd("page", "--connect", steerd.endpoint)
    address = server.expect(r"page: (\S+)")[1]
    quiet = threading.Event()
    with live(address) as socket:

        def speak() -> None:
            with suppress(Exception):
                while not quiet.wait(SPEAK_S):
                    socket.send("alive")

        speaker = threading.Thread(target=speak)
        speaker.start()

        def go(end: str) -> int:
            gone_ns = time.monotonic_ns()
            if end == "silent":
                quiet.set()
            elif end == "closed":
                socket.close()
            else:
                server.send(_SIGNALS[end])
            return gone_ns

        try:
            press_until_driving_there(socket)
            yield go
        finally:
            server.send(signal.SIGKILL)
            quiet.set()
            speaker.join()


@contextmanager
def gamepad(steerd: Launcher, run: Program, folder: Path) -> Iterator[Go]:
    """A gamepad that drives the car."""
    path = folder / f"pad{time.monotonic_ns()}"
    hand = Hand(path)
    teleop = steerd("teleop", "--connect", steerd.endpoint, "--device", path)

    def go(end: str) -> int:
        if end in ("silent", "unplugged"):
            hand.rest()
        gone_ns = time.monotonic_ns()
        if end == "unplugged":
            hand.unplug()
        if end == "released":
            hand.send(KEY, BUTTONS["tl"], 0)
        if end in _SIGNALS:
            teleop.send(_SIGNALS[end])
        return gone_ns

    hand.take()
    try:
        teleop.expect("hold tl")
        hand.press("tl")
        run.text = ""
        press_until_driving(hand, run)
        hand.send(ABS, AXES["x"], -16000)
        hand.send(ABS, AXES["rz"], 1023)
        yield go
    finally:
        teleop.send(signal.SIGKILL)
        hand.unplug()


HANDS = {
    "page": (page, (), ("silent", "closed", "killed", "frozen")),
    "gamepad": (
        gamepad,
        ("--controller", "zenoh"),
        ("released", "unplugged", "killed", "frozen", "silent"),
    ),
}  # fmt: skip


def run_trials(who: str, trials: int, note: Callable[[dict[str, Any]], int]) -> bool:
    """Drive and end the driving, in all the ways of one kind of hand.

    Args:
        who: of `HANDS`.
        trials: of each way.
        note: takes a row; how many rows of that way there are already, for one without figures.

    Returns:
        Whether all were done: a fault, on a busy machine a late tick, ends these drives.
    """
    hand, options, ends = HANDS[who]
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        steerd = Launcher()
        stack.callback(steerd.close)
        vesc, mocap = steerd.sim(folder)
        tap = Tap(vesc)
        stack.callback(tap.close)
        listen = ("--port", tap.port, "--mocap", mocap, "--listen", steerd.endpoint)
        run = steerd("run", *listen, *CIRCLE, *options, "--record", folder / "drive.mcap")
        run.expect("DISARMED")
        watcher = Watcher(steerd.endpoint)
        stack.callback(watcher.close)
        for _ in range(trials):
            for end in ends:
                row = {"who": who, "end": end}
                if note(row) < trials:
                    watcher.until(lambda s: s.mode in _AT_REST, run)
                    with hand(steerd, run, folder) as go:
                        driven = watcher.driving(run, DRIVE_S)
                        gone_ns = go(end)
                        stop = SupervisorState(driven.mode)
                        if stop is SupervisorState.RUNNING:
                            stop = watcher.stopped(run)
                    if stop is not SupervisorState.STOPPING:
                        return False
                    note({**row, "ms": tap.first_slower(gone_ns)})
    return True


def is_done(who: str, trials: int, note: Callable[[dict[str, Any]], int]) -> bool:
    """Try all trials from a fresh start; a fault meanwhile, or one that nothing clears, ends it."""
    try:
        return run_trials(who, trials, note)
    except AssertionError:  # of the tests' helpers: what they waited for never came
        return False


def summarise(rows: list[dict[str, Any]]) -> Iterator[str]:
    """A line for each way of ending."""
    for who, (_, _, ends) in HANDS.items():
        for end in ends:
            took = [r["ms"] for r in rows if (r["who"], r["end"]) == (who, end)]
            seen = [ms for ms in took if ms is not None]
            if seen:
                middle, worst = statistics.median(seen), max(seen)
                yield f"{who:8}{end:10}{len(seen)} of {len(took)}: {middle:6.0f} {worst:6.0f} ms"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--trials", type=int, default=5, help="of each way")
    parser.add_argument("--log", type=Path, help="append each trial here; go on where it ends")
    parser.add_argument("--starts", type=int, default=3, help="of hardware and daemon")
    parser.add_argument("--only", choices=tuple(HANDS))
    args = parser.parse_args()
    rows: list[dict[str, Any]] = []
    if args.log is not None and args.log.exists():
        rows = [json.loads(line) for line in args.log.read_text(encoding="ascii").splitlines()]

    def note(row: dict[str, Any]) -> int:
        if "ms" in row:
            rows.append(row)
            if args.log is not None:
                with args.log.open("a", encoding="ascii") as file:
                    file.write(json.dumps(row) + "\n")
        return sum((r["who"], r["end"]) == (row["who"], row["end"]) for r in rows)

    for who in HANDS if args.only is None else (args.only,):
        again = 0
        while again < args.starts and not is_done(who, args.trials, note):
            again += 1
        if again:
            sys.stdout.write(f"{who}: {again} of {args.starts} starts ended by another fault\n")
    sys.stdout.write("".join(f"{line}\n" for line in summarise(rows)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
