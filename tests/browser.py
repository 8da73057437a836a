"""A headless Chromium that is asked over its DevTools socket: console, screenshots, the layout.

Nothing is fetched: pages are files, and the browser's own services are off.
"""

import base64
import contextlib
import json
import os
import re
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from math import inf
from pathlib import Path
from typing import Any

from websockets.sync.client import ClientConnection, connect  # noqa: TID251

CHROMIUM = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome", "chrome"))), ""
)
NO_BROWSER = "no Chromium on this machine (apt-get install chromium)"
DEADLINE_S = 90.0  # a hung browser fails its test after this
FLAGS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--hide-scrollbars", "--disable-background-networking", "--disable-component-update",
    "--disable-sync", "--disable-dev-shm-usage", "--remote-debugging-port=0",
)  # fmt: skip
POSIX = "en-US@posix"  # what some browsers call the language of LANG=C.UTF-8; `Intl` throws at it
LAYOUT = (Path(__file__).parent / "browser_layout.js").read_text(encoding="utf-8")


class Browser:
    """One open tab; `console` is what the page said: warnings, errors, uncaught exceptions."""

    def __init__(self, socket: ClientConnection) -> None:
        self._socket, self._number = socket, 0
        self.console: list[str] = []
        self._events: set[str] = set()
        for domain in ("Page", "Runtime", "Log"):
            self.call(f"{domain}.enable")

    def _read(self) -> dict[str, Any]:
        message: dict[str, Any] = json.loads(self._socket.recv(DEADLINE_S))
        told, method = message.get("params", {}), message.get("method", "")
        self._events.add(method)
        if method == "Runtime.exceptionThrown":
            said = told["exceptionDetails"]
            self.console.append(str(said.get("exception", {}).get("description", said["text"])))
        if method == "Log.entryAdded" and told["entry"]["level"] in ("error", "warning"):
            self.console.append(told["entry"]["text"])
        if method == "Runtime.consoleAPICalled" and told["type"] in ("error", "warning", "assert"):
            self.console.append(str([each.get("value") for each in told["args"]]))
        return message

    def call(self, method: str, **params: Any) -> dict[str, Any]:
        """One DevTools command and its answer."""
        self._number += 1
        self._socket.send(json.dumps({"id": self._number, "method": method, "params": params}))
        while (message := self._read()).get("id") != self._number:
            pass
        assert "error" not in message, f"{method}: {message['error']}"
        result: dict[str, Any] = message["result"]
        return result

    def open(
        self, address: str, width: int = 1280, *, dark: bool = False, language: str = POSIX
    ) -> None:
        """Load an address in a window of that width, in the light or the dark theme."""
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self.call("Emulation.setEmulatedMedia", features=[scheme])
        said = {"userAgent": "steerd tests", "acceptLanguage": language}
        self.call("Emulation.setUserAgentOverride", **said)
        size = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": width < 600}
        self.call("Emulation.setDeviceMetricsOverride", **size)
        self.console.clear()
        self._events.clear()
        self.call("Page.navigate", url=address)
        while "Page.loadEventFired" not in self._events:
            self._read()

    def ask(self, script: str) -> Any:
        """The value of a JavaScript expression; a promise is waited for."""
        asked = {"expression": script, "awaitPromise": True, "returnByValue": True}
        answer = self.call("Runtime.evaluate", **asked)
        assert "exceptionDetails" not in answer, answer["exceptionDetails"]
        return answer["result"].get("value")

    def wait(self, condition: str) -> None:
        """Wait until a JavaScript expression is true."""
        turn = f"""new Promise((yes, no) => {{
          const end = performance.now() + {1000 * DEADLINE_S / 2};
          const look = () => ({condition}) ? yes(true) : performance.now() > end ? yes(false)
            : setTimeout(look, 50);
          look(); }})"""
        assert self.ask(turn), f"never true: {condition}; console: {self.console}"

    def faults_of_layout(self) -> list[str]:
        """What a reader would see as broken: text over text, cut off, beyond the edge, too pale."""
        found: list[str] = self.ask(LAYOUT)
        return found

    def screenshot(self, picture: Path, most: float = inf) -> None:
        """The page as a PNG file, of `most` lines from its top."""
        size = self.call("Page.getLayoutMetrics")["cssContentSize"]
        size["height"] = min(size["height"], most)
        shot = self.call(
            "Page.captureScreenshot", captureBeyondViewport=True, clip={**size, "scale": 1}
        )
        picture.write_bytes(base64.b64decode(shot["data"]))


@contextlib.contextmanager
def browsing() -> Iterator[Browser]:
    """A browser with a profile of its own, in the locale that containers have."""
    profile = tempfile.mkdtemp(prefix="steerd-browser-")
    environment = {k: v for k, v in os.environ.items() if not k.startswith(("LC_", "LANGUAGE"))}
    process = subprocess.Popen(
        [CHROMIUM, *FLAGS, f"--user-data-dir={profile}", "about:blank"], text=True,
        stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, env={**environment, "LANG": "C.UTF-8"},
    )  # fmt: skip
    try:
        assert process.stderr is not None
        said = iter(process.stderr)
        port = next(found[1] for line in said if (found := re.search(r"127.0.0.1:(\d+)/", line)))
        yield from _attach(int(port))
    finally:
        process.terminate()
        process.communicate(timeout=DEADLINE_S)
        shutil.rmtree(profile, ignore_errors=True)


def _attach(port: int) -> Iterator[Browser]:
    import urllib.request

    with urllib.request.urlopen(f"http://127.0.0.1:{port}/json/list", timeout=DEADLINE_S) as page:
        tabs = json.loads(page.read())
    address = next(tab["webSocketDebuggerUrl"] for tab in tabs if tab["type"] == "page")
    with connect(address, max_size=None, open_timeout=DEADLINE_S) as socket:
        yield Browser(socket)
