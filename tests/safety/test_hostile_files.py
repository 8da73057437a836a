"""Files and surroundings that somebody else made: one line each, at once, and never a traceback."""

import os
import resource
import socket
import subprocess
import sys
import time
import urllib.request
from contextlib import nullcontext
from pathlib import Path
from urllib.parse import urlparse

import pytest

from steerd.daemon.cli.commands import operate
from steerd.steer_bus import topics
from steerd.steer_bus.codec import encode
from steerd.steer_bus.session_read import open_session
from steerd.steer_bus.topics import make_key
from tests.blank import status_message
from tests.e2e.test_live_page import FakeCar, served
from tests.local_bus import LocalBus, LocalHub
from tests.replays import copy_session

pytestmark = pytest.mark.timeout(120)
GOLDEN = Path(__file__).parents[1] / "golden" / "circle.mcap"
SOON = 20.0
"""Processor time of one command [s]."""
DOTTED = "a" + ".a" * 200_000 + " = 1\n"
QUOTED = '"\\"."' + '."\\"."' * 150_000 + " = 1\n"
HEAD = "[" + "a." * 200_000 + "a]\n"
NESTED = "x = " + "[" * 100_000
CAR = (Path(__file__).parents[2] / "config" / "f1tenth.toml").read_text()
SIM = ("run", "--sim", "--fast", "--duration", "0.5")


def is_one_line(said):
    lines = [line for line in said.splitlines() if not line.startswith(("   try: ", "warning: "))]
    assert "Traceback" not in said
    assert len(lines) == 1, said
    assert lines[0].startswith("steerd: "), said


@pytest.fixture
def refuses(cli):
    def refuse(*words):
        began = time.process_time()
        said = cli(*words, code=4).err
        assert time.process_time() - began < SOON
        is_one_line(said)
        return said

    return refuse


PAGES = [(what, text) for what in ("car", "map", "sweep") for text in (DOTTED, HEAD, QUOTED)]


@pytest.mark.parametrize(("what", "text"), [*PAGES, ("sweep", NESTED)])
def test_a_page_of_settings_that_hangs_or_crashes_a_parser(tmp_path, refuses, what, text):
    page, log = tmp_path / "page.toml", tmp_path / "log.csv"
    page.write_text(CAR + text if what == "car" else text)
    log.write_text("t,x\n0,1\n")
    words = {"car": ("config", "--check"), "map": ("import", "csv", log, "--map")}
    refuses(*words.get(what, (what,)), page)


@pytest.mark.parametrize("text", [DOTTED, NESTED], ids=["dotted", "nested"])
def test_a_car_file_inside_a_session(tmp_path, refuses, cli, text):
    car = {"car.toml": text.encode()}
    path = copy_session(GOLDEN, tmp_path / "x.mcap", attachments=car)
    refuses("replay", path)
    for name in ("info", "plot"):
        cli(name, path)  # neither needs it


def test_a_session_whose_scaling_is_text(tmp_path, refuses, cli):
    scaling = {"steerd.scaling": {"erpm_gain": "fast"}, "steerd.session": {"mode": "import"}}
    path = copy_session(GOLDEN, tmp_path / "x.mcap", metadata=scaling)
    for name in ("info", "plot", "identify"):
        refuses(name, path)
    assert "unreadable" in cli("sessions", "--folder", tmp_path).out


def test_a_session_without_the_path_file_that_it_names(tmp_path, refuses):
    options = open_session(GOLDEN).info().metadata["steerd.session"]["options"]
    assert "circle:radius=2" in options
    about = {"steerd.session": {"options": options.replace("circle:radius=2", "csv:lane.csv")}}
    refuses("replay", copy_session(GOLDEN, tmp_path / "x.mcap", metadata=about))


def test_a_table_with_a_quote_that_is_never_closed(tmp_path, refuses):
    log = tmp_path / "log.csv"
    log.write_text('t,x,y\n0,1,"2\n' + "3,4,5\n" * 30_000)
    refuses("import", "--ask", log)


def command(*words, before=None, **env):
    """A command in a process of its own: its code and what it says; it is killed if it hangs."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
    done = subprocess.run(
        [sys.executable, "-m", "steerd", *map(str, words)], capture_output=True, text=True,
        stdin=subprocess.DEVNULL, preexec_fn=before, timeout=60, env={**os.environ, **env},
    )  # fmt: skip
    assert resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - used < SOON
    return done.returncode, done.stdout, done.stderr


def test_a_control_character_in_a_key(tmp_path):
    page = tmp_path / "car.toml"
    page.write_text(CAR.replace("[car]\n", '[car]\n"\\u001b[2Jmass\\u009b" = 1\n', 1))
    code, _, said = command("config", "--check", page)
    assert (code, "mass" in said) == (4, True)
    assert not {"\x1b", "\x9b"} & set(said)


def close_stdin():
    os.close(0)


def allow_few_files():
    resource.setrlimit(resource.RLIMIT_NOFILE, (20, 20))


RUN = ("run", "--sim", "--auto-arm", "--duration", "0.5")


def test_a_shell_that_allows_few_files():
    code, _, said = command(*RUN, before=allow_few_files)
    assert code == 3
    is_one_line(said)
    assert "ulimit -n" in said


def test_a_closed_standard_input(tmp_path):
    code, _, said = command(*RUN, "--record", tmp_path / "d.mcap", before=close_stdin)
    assert code == 0, said
    assert "Traceback" not in said


def test_a_closed_standard_input_where_a_person_is_asked(tmp_path):
    (tmp_path / "log.csv").write_text("t,x,y,yaw\n0,1,2,0\n1,1,2,0\n")
    code, _, said = command("import", "--ask", tmp_path / "log.csv", before=close_stdin)
    assert code == 2
    is_one_line(said)


def test_a_locale_that_knows_no_superscript():
    code, shown, said = command("info", GOLDEN, PYTHONIOENCODING="ascii")
    assert code == 0, said
    assert "lateral acceleration up to" in shown


def test_a_diagnostics_message_that_would_steer_the_terminal(monkeypatch, cli):
    said = {"state": "READY\x1b[2J", "reason": "\x1b]0;owned\x07", "waiting": "\x9b31m"}
    data = encode(status_message(**said))

    class Foreign(LocalBus):
        """A bus on which somebody answers every subscription."""

        def subscribe(self, key, depth=1):
            found = super().subscribe(key, depth)
            if key == make_key("car1", topics.DIAGNOSTICS):
                self.publish(key, data)
            return found

    monkeypatch.setattr(operate, "connect", lambda *_: nullcontext(Foreign(LocalHub())))
    shown = cli("status").out
    assert "READY" in shown
    assert not {"\x1b", "\x07", "\x9b"} & set(shown)


@pytest.mark.parametrize("twice", ["Host", "Origin"])
def test_a_header_that_is_given_twice(twice, caplog):
    with served(FakeCar()) as url:
        place = urlparse(url)
        address = f"{place.hostname}:{place.port}"
        heads = [f"Host: {address}", f"Origin: http://{address}"]
        heads += [head for head in heads if head.startswith(twice)]
        heads += ["Connection: Upgrade", "Upgrade: websocket", "Sec-WebSocket-Version: 13"]
        heads += ["Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ=="]
        with socket.create_connection((place.hostname, place.port), 5.0) as link:
            text = "\r\n".join([f"GET {place.path}live HTTP/1.1", *heads, "", ""])
            link.sendall(text.encode())
            answer = link.recv(4096).decode()
        assert answer.split()[1] == "403", answer
        assert urllib.request.urlopen(url, timeout=5.0).status == 200
    assert not caplog.records


def test_a_drive_leaves_nothing_in_a_cache_that_a_later_one_would_believe(tmp_path):
    cache = tmp_path / "cache"
    assert command(*SIM, "--record", tmp_path / "a.mcap", XDG_CACHE_HOME=str(cache))[0] == 0
    assert not [f for f in cache.rglob("*") if f.is_file()]
