"""The steps of `steerd setup` in a browser: what to do, what each measured, buttons to go on.

The page chooses steps; keys that move a car stay in the terminal, whose output it shows. On this
machine's loopback only.
"""

import asyncio
import fcntl
import json
import os
import pty
import re
import select
import struct
import sys
import termios
import threading
from collections.abc import Sequence
from concurrent.futures import Future
from pathlib import Path
from typing import Any, TextIO

from steerd.daemon.process.secret_server import HOST, SecretServer, ServerConnection, converse
from steerd.sysid.report.page import render_page

ANSWERS = {"do": "", "skip": "s", "back": "b", "quit": "q"}  # what a button types
SHOWN = 20_000  # characters of a step's output that are kept
_SIZE = 30, 80  # rows and columns of a step's terminal
_LOOK_S = 0.1  # time between two looks at what changed [s]
_WORD_MAX = 64
_TEMPLATE = Path(__file__).parent / "live_page" / "setup.html"
_CONTROL = re.compile(r"\x1b\[(\d*)([A-Za-z])|\x1b\[[0-9;?]*[A-Za-z]|\r\n|[\r\n\b\x07]")


def plain_text(output: str) -> str:
    """What a terminal shows of an output: lines that are written over are gone, colours too."""
    lines, at = [""], 0
    for found in _CONTROL.finditer(output):
        lines[-1] += output[at : found.start()]
        at = found.end()
        if found[2] == "A":  # up, to write these lines again
            del lines[max(len(lines) - int(found[1] or 1), 1) :]
            lines[-1] = ""
        elif found[0] in ("\n", "\r\n"):
            lines.append("")
        elif found[0] == "\r":
            lines[-1] = ""
    lines[-1] += output[at:]
    return "\n".join(lines)


class GuidePage:
    """A page of steps at `url`; a thread of its own serves it.

    It shows `title`, `before` and `command` of each step. Lines are typed in the terminal too.
    """

    def __init__(self, steps: Sequence[dict[str, str]], terminal: TextIO = sys.stdin) -> None:
        self.url = ""
        self._steps: list[dict[str, Any]] = [{**s, "state": "", "output": ""} for s in steps]
        self._at, self._asked, self._changes = 0, False, 0
        self._terminal = terminal
        self._pressed, self._press = os.pipe()

    def open(self, port: int) -> str:
        """Serve, and give the address; OSError if the port is taken."""
        address: Future[str] = Future()
        served = self._serve(port, address)
        threading.Thread(target=asyncio.run, args=(served,), daemon=True).start()
        self.url = address.result()
        return self.url

    def stand(self, at: int, state: str) -> None:
        """A step is the present one, and how it stands: `asked`, `runs`, `done` or `failed`."""
        self._at, self._asked = at, state == "asked"
        if state == "runs":
            self._steps[at]["output"] = ""
        if state != "asked":
            self._steps[at]["state"] = state
        self._changes += 1

    def ask(self, question: str) -> str:
        """The line that is typed, or what the button that is pressed types."""
        print(question, end="", flush=True)
        keyboard = self._terminal.fileno()
        if keyboard in select.select([keyboard, self._pressed], [], [])[0]:
            return self._terminal.readline() or "q"
        answer = os.read(self._pressed, _WORD_MAX).decode().splitlines()[0]
        print(answer)
        return answer

    def run(self, command: Sequence[str]) -> int:
        """Run a command in the terminal, which the page shows; its exit code."""
        sized = False

        def read(terminal: int) -> bytes:
            nonlocal sized
            if not sized:
                sized = True
                fcntl.ioctl(terminal, termios.TIOCSWINSZ, struct.pack("HHHH", *_SIZE, 0, 0))
            data = os.read(terminal, 4096)
            step = self._steps[self._at]
            step["output"] = (step["output"] + data.decode(errors="replace"))[-SHOWN:]
            self._changes += 1
            return data

        return os.waitstatus_to_exitcode(pty.spawn([*command], read))

    def press(self, word: str) -> None:
        """A button of the page: `3 do` is of the fourth step, and nothing unless that is asked."""
        at, _, name = word.partition(" ")
        if self._asked and at == str(self._at) and name in ANSWERS:
            self._asked = False
            os.write(self._press, f"{ANSWERS[name]}\n".encode())

    def shown(self) -> dict[str, Any]:
        """What the page shows."""
        steps = [{**step, "output": plain_text(step["output"])} for step in self._steps]
        return {"at": self._at, "asked": self._asked, "steps": steps}

    async def _serve(self, port: int, address: Future[str]) -> None:
        server = SecretServer(HOST, self._talk, render_page(_TEMPLATE))
        try:
            await server.open(port, _WORD_MAX)
        except OSError as error:
            address.set_exception(error)
            return
        address.set_result(server.url)
        await asyncio.Event().wait()

    async def _talk(self, connection: ServerConnection) -> None:
        await converse(connection, self._show(connection), self.press)

    async def _show(self, connection: ServerConnection) -> None:
        seen = -1
        while True:
            if seen != self._changes:
                seen = self._changes
                await connection.send(json.dumps(self.shown()))
            await asyncio.sleep(_LOOK_S)
