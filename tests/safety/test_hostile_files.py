"""Files and surroundings that somebody else made: one line each, at once, and never a traceback."""

import os
import re
import resource
import subprocess
import sys
import time
import urllib.request
from contextlib import nullcontext
from pathlib import Path

import pytest
from mcap.writer import Writer  # noqa: TID251

from steerd.daemon.cli.main import run_cli
from steerd.steer_bus.session_read import open_session

GOLDEN = Path(__file__).parents[1] / "golden" / "circle.mcap"
SOON = 20.0
"""Processor time of one command [s]: what the imports cost on a loaded machine, and no more."""
DOTTED = "a" + ".a" * 200_000 + " = 1\n"
QUOTED = '"\\"."' + '."\\"."' * 150_000 + " = 1\n"
HEAD = "[" + "a." * 200_000 + "a]\n"
NESTED = "x = " + "[" * 100_000
CAR = (Path(__file__).parents[2] / "config" / "f1tenth.toml").read_text()
SIM = ("run", "--sim", "--fast", "--duration", "0.5")


def alter(out, metadata=None, attachments=None, options=None):
    """The golden session with other metadata and attachments; an attachment of None is left out."""
    session = open_session(GOLDEN)
    about = {name: dict(values) for name, values in session.info().metadata.items()}
    for name, values in (metadata or {}).items():
        about.setdefault(name, {}).update(values)
    if options is not None:
        old = about["steerd.session"]["options"]
        about["steerd.session"]["options"] = old.replace(*options)
        assert about["steerd.session"]["options"] != old
    files = {a.name: a.data for a in session.attachments()}
    files |= attachments or {}
    writer = Writer(str(out))
    writer.start("ros2", "test")
    for name, values in about.items():
        writer.add_metadata(name, values)
    for name, data in files.items():
        if data is not None:
            writer.add_attachment(0, 0, name, "text/plain", data)
    contents = session.info()
    schemas = {
        key: writer.register_schema(s.name, s.encoding, s.data)
        for key, s in contents.schemas.items()
    }
    channels = {
        key: writer.register_channel(c.topic, c.message_encoding, schemas[c.schema_id])
        for key, c in contents.channels.items()
    }
    for r in session.messages():
        writer.add_message(channels[r.channel], r.log_ns, r.data, r.publish_ns, r.sequence)
    writer.finish()
    return out


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
    path = alter(tmp_path / "x.mcap", scaling)
    refuses(capsys, "info", path)
    refuses(capsys, "plot", path)
    refuses(capsys, "identify", path)
    assert run_cli(["sessions", "--folder", str(tmp_path)]) == 0
    assert "unreadable" in capsys.readouterr().out


def test_a_session_without_the_path_file_that_it_names(tmp_path, capsys):
    path = alter(tmp_path / "x.mcap", options=("circle:radius=2", "csv:lane.csv"))
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
    from steerd.daemon.cli.commands import operate
    from steerd.steer_bus import topics
    from steerd.steer_bus.codec import encode
    from steerd.steer_bus.messages import BODY, make_header
    from steerd.steer_bus.standard import DiagnosticArray, DiagnosticStatus, KeyValue
    from steerd.steer_bus.topics import make_key
    from tests.local_bus import LocalBus, LocalHub

    said = {"state": "READY\x1b[2J", "reason": "\x1b]0;owned\x07", "waiting": "\x9b31m"}
    pairs = tuple(KeyValue(*pair) for pair in said.items())
    data = encode(
        DiagnosticArray(
            make_header(0, BODY), (DiagnosticStatus(0, "steerd: supervisor", "", "", pairs),)
        )
    )

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
    import socket
    from urllib.parse import urlparse

    from tests.e2e.test_live_page import FakeCar, served

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


@pytest.fixture
def cache(tmp_path):
    return tmp_path / "cache"


def drive(cache, *more):
    """A second of simulated drive with that cache: digest of the bytes on the wire, and errors."""
    argv = [sys.executable, "-m", "steerd", "run", "--sim", "--fast", "--duration", "1", *more]
    argv += ["--record", str(cache.with_name(f"{len(list(cache.parent.glob('*.mcap')))}.mcap"))]
    done = subprocess.run(
        argv, capture_output=True, text=True, check=False, timeout=120,
        env={**os.environ, "XDG_CACHE_HOME": str(cache)},
    )  # fmt: skip
    assert done.returncode == 0, (done.returncode, done.stderr)
    return re.search(r"sha256 (\w+)", done.stdout)[1], done.stderr.splitlines()


def test_no_code_lies_in_a_cache(cache):
    """A drive leaves nothing there that a later one would execute."""
    drive(cache)
    left = [f for f in cache.rglob("*") if f.is_file()]
    assert left, "gains are remembered"
    assert {f.suffix for f in left} == {".json"}
    assert not [f for f in left if f.stat().st_mode & 0o111]
