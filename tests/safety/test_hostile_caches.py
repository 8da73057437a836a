"""What lies in a cache is not run and not driven with unless it is what steerd left there."""

import json
import os
import re
import subprocess
import sys

import pytest

from steerd.car_model.machine_code import find_compiler

needs_compiler = pytest.mark.skipif(not find_compiler(), reason="no C compiler")


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


@needs_compiler
@pytest.mark.parametrize("name", ["filter", "plant"])
@pytest.mark.parametrize("keep", [0.02, 0.5, 0.9])
def test_a_library_whose_end_a_power_cut_took(cache, name, keep):
    """Loaded as it is, it ends every start with SIGBUS or SIGSEGV and no message."""
    whole = drive(cache)[0]
    (library,) = cache.rglob(f"{name}*.so")
    content = library.read_bytes()
    left = int(keep * len(content))
    library.write_bytes(content[:left] + bytes(len(content) - left))
    found, said = drive(cache)
    assert found == whole
    assert [line for line in said if "it is made anew" in line]
    assert library.read_bytes() == content
    assert drive(cache)[1] == []


@needs_compiler
def test_another_library_is_never_loaded(cache, tmp_path):
    drive(cache)
    mark, source = tmp_path / "mark", tmp_path / "other.c"
    source.write_text(
        "#include <stdio.h>\n__attribute__((constructor)) static void come(void)\n"
        f'{{ FILE *f = fopen("{mark}", "w"); if (f) fclose(f); }}\n'
    )
    for library in cache.rglob("*.so"):
        subprocess.run([*find_compiler(), "-shared", "-fPIC", "-o", library, source], check=True)
    drive(cache)
    assert not mark.exists()


@pytest.mark.parametrize("factor", [0.3, 3.0])
def test_gains_that_somebody_changed_are_not_driven(cache, factor):
    whole = drive(cache)[0]
    for file in cache.rglob("designs/*.json"):
        text = file.read_text()
        table, end = json.JSONDecoder().raw_decode(text)
        table[2] = [[factor * gain for gain in row[:4]] + row[4:] for row in table[2]]
        file.write_text(json.dumps(table) + text[end:])
    assert drive(cache)[0] == whole
