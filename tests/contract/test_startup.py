"""A command looks at its arguments before it loads what it needs for the work.

Loading torch, SciPy, Matplotlib or Numba takes seconds on a cold machine. Nobody
should wait for them to read that a file does not exist.
"""

import os
import subprocess
import sys

import pytest

from steerd.daemon.cli.main import COMMANDS

HEAVY = ("torch", "scipy", "matplotlib", "numba", "filterpy", "joblib", "pyarrow")
HEAVY += ("jinja2", "rich", "distributed", "zenoh")
SIM = "run --sim --fast --duration 1"
MISSING = {
    "run": (f"{SIM} --car none.toml", f"{SIM} --sim-car none.toml", f"{SIM} --path csv:none.csv"),
    "collect": ("collect --sim --car none.toml", "collect --sim --sim-car none.toml",
                "collect --sim --path csv:none.csv"),
    "control": ("control --car none.toml", "control --path csv:none.csv"),
    "sim": ("sim --car none.toml",),
    "service": ("service print --car none.toml", "service print --sim-car none.toml",
                "service print --path csv:none.csv"),
    "probe": ("probe --car none.toml",),
    "effects": ("effects --add none.py",),
    "export": ("export none.toml -o car.xml",),
    "config": ("config --check none.toml", "config --from-vesc-yaml none.yaml"),
    "mocap": ("mocap check none.mcap", "mocap check --car none.toml",
              "mocap calibrate none.mcap", "mocap calibrate {here} --car none.toml"),
    "calibrate": ("calibrate servo none.mcap", "calibrate servo --car none.toml"),
    "identify": ("identify none.mcap", "identify {here} --car none.toml",
                 "identify {here} --held-out none.mcap"),
    "diagnose": ("diagnose none.mcap", "diagnose {here} --base none.toml",
                 "diagnose {here} --held-out {here},none.mcap",
                 "diagnose {here} --healthy none.mcap"),
    "replay": ("replay none.mcap",),
    "sessions": ("sessions tag none.mcap wet", "sessions note none.mcap good"),
    "info": ("info none.mcap",),
    "plot": ("plot {here} none.mcap",),
    "recover": ("recover none.mcap",),
    "learn": ("learn none.mcap", "learn {here} --base none.toml"),
    "sweep": ("sweep none.toml",),
    "batch": ("batch summarise none.mcap", "batch identify {here} --cars none.toml"),
    "import": ("import {here} --map none.toml",),
}  # fmt: skip
"""A line for every argument that names a file, by command; `{here}` is a file that exists."""


def load(line: str, folder: object) -> tuple[int, str, set[str]]:
    """A command's exit code, what it said, and which heavy modules it loaded."""
    code = (
        "import sys\n"
        "from steerd.daemon.cli.main import run_cli\n"
        "try:\n    code = run_cli(sys.argv[1:])\n"
        "except SystemExit as end:\n    code = int(end.code or 0)\n"
        f"print('loaded', *({set(HEAVY)!r} & set(sys.modules)), file=sys.stderr)\n"
        "sys.exit(code)\n"
    )
    argv = [sys.executable, "-c", code, *line.split()]
    here = {**os.environ, "XDG_DATA_HOME": str(folder)}
    done = subprocess.run(argv, capture_output=True, text=True, check=False, cwd=folder, env=here)
    said, _, loaded = done.stderr.rpartition("loaded")
    return done.returncode, said, set(loaded.split())


@pytest.mark.parametrize("line", [line for lines in MISSING.values() for line in lines])
def test_a_file_that_is_not_there_is_reported_before_anything_heavy_is_loaded(line, tmp_path):
    (tmp_path / "here.mcap").write_bytes(b"a file")
    code, said, loaded = load(line.format(here="here.mcap"), tmp_path)
    assert code == (2 if "csv:" in line else 3), said
    assert "none." in said.splitlines()[0]
    assert loaded == set()


@pytest.mark.parametrize("name", COMMANDS)
def test_help_loads_nothing_heavy(name, tmp_path):
    code, said, loaded = load(f"{name} --help", tmp_path)
    assert code == 0, said
    assert loaded <= {"zenoh"}  # arm, stop and the like: nothing of them works without it


def test_words_that_are_no_files_pass(tmp_path):
    """`@last` without a session is the list's to report, `hidden:x` the simulator's."""
    assert "no sessions in" in load("info @last", tmp_path)[1]
    assert "the seed is a whole number" in load(f"{SIM} --sim-car hidden:x", tmp_path)[1]
