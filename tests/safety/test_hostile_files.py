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
from steerd.daemon.cli.main import run_cli
from steerd.steer_bus import topics
from steerd.steer_bus.codec import encode
from steerd.steer_bus.session_read import open_session
from steerd.steer_bus.topics import make_key
from tests.blank import status_message
from tests.e2e.test_live_page import FakeCar, served
from tests.local_bus import LocalBus, LocalHub
from tests.replays import copy_session

GOLDEN = Path(__file__).parents[1] / "golden" / "circle.mcap"
SOON = 20.0
"""Processor time of one command [s]: what the imports cost on a loaded machine, and no more."""
DOTTED = "a" + ".a" * 200_000 + " = 1\n"
QUOTED = '"\\"."' + '."\\"."' * 150_000 + " = 1\n"
HEAD = "[" + "a." * 200_000 + "a]\n"
NESTED = "x = " + "[" * 100_000
CAR = (Path(__file__).parents[2] / "config" / "f1tenth.toml").read_text()
SIM = ("run", "--sim", "--fast", "--duration", "0.5")


def alter(out, **changed):
    """The golden session with other metadata and attachments."""
    return copy_session(GOLDEN, out, **changed)


def command(*words, before=None, env=None, stdin=subprocess.DEVNULL, cwd=None):
    """A command in a process of its own; it is killed if it hangs."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
    done = subprocess.run(
        [sys.executable, "-m", "steerd", *map(str, words)],
        capture_output=True, stdin=stdin, preexec_fn=before, timeout=60, check=False,
        cwd=cwd, env={**os.environ, **(env or {})},
    )  # fmt: skip
    assert resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - used < SOON
    return done.returncode, done.stdout.decode(), done.stderr.decode()


def is_one_line(said):
    lines = [line for line in said.splitlines() if not line.startswith(("   try: ", "warning: "))]
    assert "Traceback" not in said
    assert len(lines) == 1, said
    assert lines[0].startswith("steerd: "), said


def refuses(capsys, *words, code=4):
    began = time.process_time()
    assert run_cli([str(word) for word in words]) == code
    assert time.process_time() - began < SOON
    is_one_line(capsys.readouterr().err)


PAGES = [(what, text) for what in ("car", "map", "sweep") for text in (DOTTED, HEAD, QUOTED)]


@pytest.mark.parametrize(("what", "text"), [*PAGES, ("sweep", NESTED)])
def test_a_page_of_settings_that_hangs_or_crashes_a_parser(tmp_path, what, text):
    page = tmp_path / "page.toml"
    page.write_text(CAR + text if what == "car" else text)
    (tmp_path / "log.csv").write_text("t,x\n0,1\n")
    words = {
        "car": ("config", "--check", page),
        "map": ("import", "csv", tmp_path / "log.csv", "--map", page),
        "sweep": ("sweep", page),
    }[what]
    code, _, said = command(*words)
    assert code == 4
    is_one_line(said)


@pytest.mark.parametrize("text", [DOTTED, NESTED], ids=["dotted", "nested"])
def test_a_car_file_inside_a_session(tmp_path, text):
    path = alter(tmp_path / "x.mcap", attachments={"car.toml": text.encode()})
    code, _, said = command("replay", path)
    assert code == 4
    is_one_line(said)
    for name in ("info", "plot"):
        assert command(name, path)[0] == 0, "neither needs it"


def test_a_session_whose_scaling_is_text(tmp_path, capsys):
    scaling = {"steerd.scaling": {"erpm_gain": "fast"}, "steerd.session": {"mode": "import"}}
    path = alter(tmp_path / "x.mcap", metadata=scaling)
    refuses(capsys, "info", path)
    refuses(capsys, "plot", path)
    refuses(capsys, "identify", path)
    assert run_cli(["sessions", "--folder", str(tmp_path)]) == 0
    assert "unreadable" in capsys.readouterr().out


def test_a_session_without_the_path_file_that_it_names(tmp_path, capsys):
    options = open_session(GOLDEN).info().metadata["steerd.session"]["options"]
    assert "circle:radius=2" in options
    options = options.replace("circle:radius=2", "csv:lane.csv")
    path = alter(tmp_path / "x.mcap", metadata={"steerd.session": {"options": options}})
    refuses(capsys, "replay", path)


def test_a_table_with_a_quote_that_is_never_closed(tmp_path, capsys):
    log = tmp_path / "log.csv"
    log.write_text('t,x,y\n0,1,"2\n' + "3,4,5\n" * 30_000)
    refuses(capsys, "import", "--ask", log)


def test_a_control_character_in_a_key(tmp_path):
    page = tmp_path / "car.toml"
    page.write_text(CAR.replace("[car]\n", '[car]\n"\\u001b[2Jmass\\u009b" = 1\n', 1))
    code, _, said = command("config", "--check", page)
    assert code == 4
    assert "mass" in said
    assert not {"\x1b", "\x9b"} & set(said)


def close_stdin():
    os.close(0)


def few_files(count):
    return lambda: resource.setrlimit(resource.RLIMIT_NOFILE, (count, count))


def test_a_shell_that_allows_few_files():
    code, _, said = command(
        "run", "--sim", "--auto-arm", "--duration", "0.5", before=few_files(20)
    )  # fmt: skip
    assert code == 3
    is_one_line(said)
    assert "ulimit -n" in said


def test_a_closed_standard_input(tmp_path):
    words = ("run", "--sim", "--auto-arm", "--duration", "0.5", "--record", tmp_path / "d.mcap")
    code, _, said = command(*words, before=close_stdin)
    assert code == 0, said
    assert "Traceback" not in said


def test_a_closed_standard_input_where_a_person_is_asked(tmp_path):
    (tmp_path / "log.csv").write_text("t,x,y,yaw\n0,1,2,0\n1,1,2,0\n")
    code, _, said = command("import", "--ask", tmp_path / "log.csv", before=close_stdin)
    assert code == 2
    is_one_line(said)


def test_a_locale_that_knows_no_superscript():
    code, shown, said = command("info", GOLDEN, env={"PYTHONIOENCODING": "ascii"})
    assert code == 0, said
    assert "lateral acceleration up to" in shown


def test_a_diagnostics_message_that_would_steer_the_terminal(monkeypatch, capsys):
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
    assert run_cli(["status"]) == 0
    shown = capsys.readouterr().out
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


# What lies in a cache is not run and not driven with unless it is what steerd left there.


def test_no_code_lies_in_a_cache(tmp_path):
    """A drive leaves nothing there that a later one would execute."""
    record = ("--record", tmp_path / "drive.mcap")
    assert command(*SIM, *record, env={"XDG_CACHE_HOME": str(tmp_path / "cache")})[0] == 0
    left = [f for f in (tmp_path / "cache").rglob("*") if f.is_file()]
    assert left, "gains are remembered"
    assert {f.suffix for f in left} == {".json"}
    assert not [f for f in left if f.stat().st_mode & 0o111]
