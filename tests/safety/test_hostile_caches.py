"""What lies in a cache is not run and not driven with unless it is what steerd left there."""

import json
import os
import re
import subprocess
import sys

import pytest


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


@pytest.mark.parametrize("factor", [0.3, 3.0])
def test_gains_that_somebody_changed_are_not_driven(cache, factor):
    whole = drive(cache)[0]
    for file in cache.rglob("designs/*.json"):
        text = file.read_text()
        table, end = json.JSONDecoder().raw_decode(text)
        table[2] = [[factor * gain for gain in row[:4]] + row[4:] for row in table[2]]
        file.write_text(json.dumps(table) + text[end:])
    assert drive(cache)[0] == whole
