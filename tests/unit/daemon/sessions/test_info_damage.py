"""Bad containers through `steerd info` and `recover`: one line, the right exit code, no traceback.

The numbers are those of `docs/reference/safety-requirements.md#s9.1`; others of them are in
`tests/unit/steer_bus/test_session_damage.py`.
"""

import os
import struct
from pathlib import Path

import pytest

from tests.unit.daemon.sessions.test_bad_content import steerd

pytestmark = pytest.mark.slow

MAGIC = b"\x89MCAP0\r\n"


@pytest.fixture
def whole():
    return (Path(__file__).parents[3] / "golden" / "circle.mcap").read_bytes()


def put(path, *parts):
    path.write_bytes(b"".join(parts))
    return path


@pytest.mark.parametrize(
    ("content", "code", "words"),
    [
        (b"", 3, "is empty"),  # 1
        (MAGIC, 4, "holds no session"),  # 2
        (b"\x89MCAP1\r\n" + bytes(50), 3, "not an MCAP file"),  # 3
        (b"t,x\n0,1\n", 3, "not an MCAP file"),  # 4
        (b"PK\x03\x04" + bytes(50), 3, "not an MCAP file"),
        (b"SQLite format 3\x00" + bytes(50), 3, "not an MCAP file"),
        (MAGIC + struct.pack("<BQ", 6, 1 << 63), 4, "holds no session"),  # 12
    ],
    ids=["empty", "magic", "other_magic", "text", "zip", "sqlite", "endless"],
)
@pytest.mark.parametrize("command", ["info", "recover"])
def test_what_is_no_session(tmp_path, command, content, code, words):
    found, out, err = steerd(command, put(tmp_path / "a.mcap", content))
    assert (found, out) == (code, "")
    assert words in err
    assert list(tmp_path.iterdir()) == [tmp_path / "a.mcap"]


@pytest.mark.parametrize("command", ["info", "recover"])
def test_what_is_no_file(tmp_path, command):
    os.mkfifo(tmp_path / "fifo")
    for name in ("", "fifo", "none"):  # 22, 23
        code, out, err = steerd(command, tmp_path / name)
        assert (code, out) == (3, "")
        assert err.startswith("steerd: ")


def test_a_whole_file_needs_no_recovery(whole, tmp_path):
    code, out, _ = steerd("recover", put(tmp_path / "a.mcap", whole))
    assert code == 0
    assert "nothing to recover" in out
    assert len(list(tmp_path.iterdir())) == 1


def test_recovery_names_its_file(whole, tmp_path):
    path = put(tmp_path / "a.mcap.partial", whole[:-100])
    assert steerd("recover", path)[0] == 0
    assert (tmp_path / "a.recovered.mcap").exists()
    code, _, err = steerd("recover", path)
    assert code == 2
    assert "never overwritten" in err
    assert steerd("recover", path, "-o", tmp_path / "b.mcap")[0] == 0
    assert steerd("recover", path, "-o", tmp_path / "b.txt")[0] == 2
    assert steerd("recover", path, "-o", tmp_path / "no" / "b.mcap")[0] == 3
    _, out, _ = steerd("info", tmp_path / "b.mcap")
    assert "recovered from a.mcap.partial" in out
