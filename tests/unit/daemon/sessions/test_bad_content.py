"""Bad sessions, class by class, through `steerd info`, `steerd recover` and `steerd identify`.

Numbers are those of `docs/reference/safety-requirements.md#s9`: containers 1 to 24 (record by
record in `tests/unit/steer_bus/test_session_damage.py`), content 25 to 64; of these two are options
and no content: 58 is legal, 62 stands in `tests/e2e/test_mistakes.py`. Each is answered in bounded
time and memory, with a known code, and without a traceback; what a person has to know is said.
"""

import contextlib
import io
import json
import os
import resource
import struct
from dataclasses import replace
from functools import partial
from itertools import count
from math import inf, nan
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import Writer  # noqa: TID251

from steerd.daemon.cli.main import run_cli
from steerd.steer_bus import messages as m
from steerd.steer_bus.codec import encode
from steerd.steer_bus.fields import schema_text, type_name
from steerd.steer_bus.session import SessionWriter
from steerd.steer_bus.session_read import open_session

pytestmark = pytest.mark.slow

SECOND = 1_000_000_000
FREE = ("--free", "steer_lag")  # what is searched before so short a drive is refused
KEPT = ("/mocap", "/actuation", "/state", "/tick", "/transition", "/vesc")


def steerd(*argv):
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = run_cli([str(arg) for arg in argv])
    assert "Traceback" not in err.getvalue()
    assert len(err.getvalue().splitlines()) < 20
    return int(code), out.getvalue(), err.getvalue()


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """A short simulated drive, as the recorder writes it."""
    path = tmp_path_factory.mktemp("drive") / "drive.mcap"
    assert steerd("run", "--sim", "--fast", "--duration", "1.5", "--record", path)[0] == 0
    return path


@pytest.fixture(scope="module")
def drive(recorded):
    """Records (topic, log_ns, message) of it."""
    records = open_session(recorded).messages()
    return [(r.topic, r.log_ns, r.decode()) for r in records if r.topic.endswith(KEPT)]


def write(path, records, *, encoding="cdr", rename=None, schema=schema_text, encoder=encode):
    """A session of these records; the schema text of a class may lie."""
    writer, channels = Writer(str(path), chunk_size=8192), {}
    writer.start("ros2", "test")
    for topic, log_ns, message in records:
        cls = type(message)
        if topic not in channels:
            key = writer.register_schema(type_name(cls), "ros2msg", schema(cls).encode())
            name = (rename or {}).get(topic, topic)
            channels[topic] = writer.register_channel(name, encoding, key)
        stamp = int(log_ns) % (1 << 64)
        writer.add_message(channels[topic], stamp, encoder(message), stamp)
    writer.finish()
    return path


def of(cls, change):
    """Change every message of a class with (message, index, rng)."""

    def spoil(records, rng):
        numbers = count()
        return [
            (*r[:2], change(r[2], next(numbers), rng)) if isinstance(r[2], cls) else r
            for r in records
        ]

    return spoil


def times(change):
    def spoil(records, rng):
        return [(r[0], change(i, r[1], rng), r[2]) for i, r in enumerate(records)]

    return spoil


def without(cls):
    return lambda records, rng: [r for r in records if not isinstance(r[2], cls)]


def shuffled(records, rng):
    """Neighbours change places, as two threads might write them."""
    order = np.argsort(np.arange(len(records)) + rng.uniform(0, 20, len(records)))
    return [records[i] for i in order]


def standing(records, rng):
    still = {"x": 0.0, "y": 0.0, "yaw": 0.0}
    records = poses(lambda p, i, _: replace(p, **still))(records, rng)
    return of(m.StateMessage, lambda s, i, _: replace(s, **still, speed=0.0))(records, rng)


def replacing(old, new):
    """A schema whose text lies."""
    return {"schema": lambda cls: schema_text(cls).replace(old, new)}


poses = partial(of, m.MocapPose)
commands = partial(of, m.Actuation)
BAD = {
    "25 topic missing": without(m.MocapPose), "25b commands missing": without(m.Actuation),
    "33 times not rising": shuffled, "34 all times zero": times(lambda i, ns, rng: 0),
    "35 clock steps by an hour": times(lambda i, ns, rng: ns + 3600 * SECOND * (i > 500)),
    "35b clock steps back": times(lambda i, ns, rng: ns - 3600 * SECOND * (i > 500)),
    "36 duplicates": lambda records, rng: [r for r in records for _ in range(2)],
    "37 times beyond 63 bits": times(lambda i, ns, rng: (1 << 63) + i),
    "38 times fall": times(lambda i, ns, rng: 10**15 - i * 1000),
    "39 two clocks": poses(lambda p, i, rng: replace(p, t_valid_ns=p.t_valid_ns + 3600 * SECOND)),
    "40 half is missing": lambda records, rng: [r for r in records if rng.random() < 0.5],
    "41 ten times as fast": times(lambda i, ns, rng: ns // 10),
    "42 a gap of 5 s": times(lambda i, ns, rng: ns + 5 * SECOND * (i > 300)),
    "43 nothing but a start": lambda records, rng: records[:1],
    "44 one sample of each": lambda records, rng: list({r[0]: r for r in records}.values()),
    "45 never moved": standing,
    "46 steering is one constant": commands(lambda a, i, rng: replace(a, steer=0.1)),
    "47 speed is one constant": commands(lambda a, i, rng: replace(a, speed=1.0)),
    "48 millimetres": poses(lambda p, i, rng: replace(p, x=1e3 * p.x, y=1e3 * p.y)),
    "49 degrees": poses(lambda p, i, rng: replace(p, yaw=np.degrees(p.yaw))),
    "50 yaw unwrapped": poses(lambda p, i, rng: replace(p, yaw=p.yaw + 2 * np.pi * (i // 50))),
    "51 yaw flips": poses(lambda p, i, rng: replace(p, yaw=p.yaw + np.pi * (i > 100))),
    "52 frozen pose": poses(lambda p, i, rng: replace(p, x=1.0, y=2.0, yaw=0.5)),
    "53 NaN in bursts": poses(
        lambda p, i, rng: replace(p, x=nan, y=inf, yaw=nan) if rng.random() < 0.2 else p),
    "54 steering has the other sign": commands(lambda a, i, rng: replace(a, steer=-a.steer)),
    "55 servo saturated": commands(lambda a, i, rng: replace(a, steer=-0.4)),
    "56 wrong pole pairs": of(m.VescTelemetry, lambda v, i, rng: replace(v, erpm=v.erpm * 7 // 2)),
    "57 left-handed axes": poses(lambda p, i, rng: replace(p, x=p.y, y=p.x)),
    "59 two cars": lambda records, rng: [
        (r[0].replace("car1", car), *r[1:]) for r in records for car in ("car1", "car2")],
    "60 wheels spin": of(m.VescTelemetry, lambda v, i, rng: replace(v, erpm=20 * v.erpm)),
    "61 battery sags": of(m.VescTelemetry, lambda v, i, rng: replace(v, v_in=v.v_in - 0.01 * i)),
    "61b voltage is no number": of(m.VescTelemetry, lambda v, i, rng: replace(v, v_in=nan)),
    "63 huge": poses(lambda p, i, rng: replace(p, x=1e30 * rng.normal(), y=-1e300)),
    "64 subnormal": poses(lambda p, i, rng: replace(p, x=5e-324, y=p.y * 1e-310)),
    "64b unknown states": of(m.Transition, lambda t, i, rng: replace(t, to_state=200 + i)),
    "64c torn clock": poses(lambda p, i, rng: replace(p, t_valid_ns=-1, t_arrival_ns=2**63 - 1)),
}  # fmt: skip
CHANNELS = {
    "26 a renamed topic": {"rename": {"/steerd/car1/mocap": "/tf"}},
    "27 another version": replacing("float64 yaw\n", "float32 yaw\n"),
    "28 field missing": replacing("float64 yaw\n", ""),
    "29 extra field": {"schema": lambda cls: "float64 extra\n" + schema_text(cls)},
    "30 text for a number": replacing("float64 x\n", "string x\n"),
    "31 an array for a number": replacing("float64 x\n", "float64[3] x\n"),
    "31b no schema at all": {"schema": lambda cls: ""},
    "31c a schema that is noise": {"schema": lambda cls: "\u2603 [[[ ---\n====\nMSG: \n"},
    "32 another encoding": {"encoding": "json", "encoder": lambda message: b'{"x": NaN}'},
}


def check_info(path):
    """`steerd info` on it: a known code, nothing endless, JSON that strict readers take."""
    Path("/proc/self/clear_refs").write_text("5")  # forget the largest memory of other tests
    before = resource.getrusage(resource.RUSAGE_SELF)
    code, out, err = steerd("info", path)
    assert code in (0, 3, 4)
    assert out or err.startswith("steerd: ")
    assert len(out.splitlines()) < 60
    code, out, err = steerd("info", path, "--json")
    if code == 0:
        json.loads(out, parse_constant=pytest.fail)
    after = resource.getrusage(resource.RUSAGE_SELF)
    assert after.ru_utime - before.ru_utime < 20.0
    assert after.ru_maxrss - before.ru_maxrss < 2 << 20, "2 GiB"
    return code, out, err


@pytest.mark.parametrize("kind", BAD)
def test_bad_signals_and_times(drive, tmp_path, kind):
    records = BAD[kind](list(drive), np.random.default_rng(1))
    path = write(tmp_path / "a.mcap", records)
    assert check_info(path)[0] == 0
    assert steerd("identify", path, *FREE)[0] in (3, 4), "so short a drive teaches nothing"
    assert [p.name for p in tmp_path.iterdir()] == ["a.mcap"]


@pytest.mark.parametrize("kind", CHANNELS)
def test_bad_topics_schemas_and_encodings(drive, tmp_path, kind):
    path = write(tmp_path / "a.mcap", drive, **CHANNELS[kind])
    code, _, _ = check_info(path)
    found, _, err = steerd("identify", path, *FREE)
    assert found in (3, 4)
    assert "renamed" not in kind or (code == 0 and ("mocap" in err or "pose" in err))


def test_20_a_file_that_grows_while_it_is_read(drive, tmp_path):
    path = write(tmp_path / "a.mcap", drive)
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    session = open_session(path)
    with path.open("ab") as file:
        file.write(whole[len(whole) // 2 :])
    assert sum(1 for _ in session.messages()) > 0
    assert check_info(path)[0] == 0


# Containers, 1 to 24.
MAGIC = b"\x89MCAP0\r\n"


@pytest.mark.parametrize(("content", "code", "words"), [
    (b"", 3, "is empty"),  # 1
    (MAGIC, 4, "holds no session"),  # 2
    (b"\x89MCAP1\r\n" + bytes(50), 3, "not an MCAP file"),  # 3
    (b"t,x\n0,1\n", 3, "not an MCAP file"),  # 4
    (b"SQLite format 3\x00" + bytes(50), 3, "not an MCAP file"),
    (MAGIC + struct.pack("<BQ", 6, 1 << 63), 4, "holds no session"),  # 12
], ids=["empty", "magic", "other_magic", "text", "sqlite", "endless"])  # fmt: skip
@pytest.mark.parametrize("command", ["info", "recover"])
def test_what_is_no_session(tmp_path, command, content, code, words):
    path = tmp_path / "a.mcap"
    path.write_bytes(content)
    found, out, err = steerd(command, path)
    assert (found, out) == (code, "")
    assert words in err
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("command", ["info", "recover"])
def test_what_is_no_file(tmp_path, command):
    os.mkfifo(tmp_path / "fifo")
    for name in ("", "fifo", "none"):  # 22, 23
        code, out, err = steerd(command, tmp_path / name)
        assert (code, out) == (3, "")
        assert err.startswith("steerd: ")


def test_thousands_of_channels_and_messages_that_are_not_their_schema(tmp_path):  # 19
    names = [f"/steerd/blue/{name}" for name in ("mocap", *map(str, range(4000)))]
    about = {"steerd.session": {"car": "blue"}}
    writer = SessionWriter(tmp_path / "a.mcap", dict.fromkeys(names, m.MocapPose), about)
    for name in names:
        writer.write(name, b"\x00\x01\x00\x00junk", 1)
    code, out, err = steerd("info", writer.finish({}))
    assert code == 0
    assert len(out.splitlines()) < 40
    assert "not what its schema says" in err


def test_recovery_names_its_file(recorded, tmp_path):
    code, out, _ = steerd("recover", recorded)
    assert code == 0
    assert "nothing to recover" in out
    whole, path = recorded.read_bytes(), tmp_path / "a.mcap.partial"
    path.write_bytes(whole[: len(whole) // 2])
    assert "warning: " in steerd("info", path)[2]
    code, out, err = steerd("recover", path)
    assert (code, "saved" in out, "warning: " in err) == (0, True, True)
    assert (tmp_path / "a.recovered.mcap").exists()
    code, _, err = steerd("recover", path)
    assert code == 2
    assert "never overwritten" in err
    assert steerd("recover", path, "-o", tmp_path / "b.mcap")[0] == 0
    assert steerd("recover", path, "-o", tmp_path / "b.txt")[0] == 2
    assert steerd("recover", path, "-o", tmp_path / "no" / "b.mcap")[0] == 3
    _, out, _ = steerd("info", tmp_path / "b.mcap")
    assert "recovered from a.mcap.partial" in out


def test_15_chunk_indexes_that_overlap_and_go_round(drive, tmp_path):
    """The summary is not believed: what it points to changes nothing that is read."""
    whole = write(tmp_path / "a.mcap", drive).read_bytes()
    count = json.loads(check_info(tmp_path / "a.mcap")[1])["messages"]
    # Where the summary's chunk indexes keep the place of their chunk.
    at, places = struct.unpack_from("<Q", whole, len(whole) - 28)[0], []
    while whole[at] != 2:
        if whole[at] == 8:
            places.append(at + 9 + 16)
        at += 9 + struct.unpack_from("<Q", whole, at + 1)[0]
    assert len(places) > 2
    for offset in (8, places[0], len(whole) - 100, 1 << 62):
        bad = bytearray(whole)
        for at in places:
            bad[at : at + 8] = struct.pack("<Q", offset)
        (tmp_path / "a.mcap").write_bytes(bytes(bad))
        code, out, _ = check_info(tmp_path / "a.mcap")
        assert (code, json.loads(out)["messages"]) == (0, count)
