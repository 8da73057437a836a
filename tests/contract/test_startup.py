"""A command looks at its arguments before it loads what takes seconds on a cold machine."""

import contextlib
import io
import multiprocessing
import os
import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator
from functools import cache
from graphlib import TopologicalSorter
from typing import Any

import pytest
from grimp import build_graph

from steerd.daemon.cli.main import COMMANDS, run_cli
from tests.contract.size import ROOMS, ROOT

HEAVY = ("torch", "scipy", "matplotlib", "numba", "filterpy", "joblib", "pyarrow")
HEAVY += ("jinja2", "rich", "distributed", "zenoh")
SIM = "run --sim --fast --duration 1"
MISSING = (
    f"{SIM} --car none.toml", f"{SIM} --sim-car none.toml", f"{SIM} --path csv:none.csv",
    "collect --sim --car none.toml", "collect --sim --sim-car none.toml",
    "collect --sim --path csv:none.csv", "control --car none.toml", "control --path csv:none.csv",
    "sim --car none.toml", "service print --car none.toml", "service print --sim-car none.toml",
    "service print --path csv:none.csv", "probe --car none.toml", "effects --add none.py",
    "export none.toml -o car.xml", "config --check none.toml", "config --from-vesc-yaml none.yaml",
    "mocap check none.mcap", "mocap check --car none.toml", "mocap calibrate none.mcap",
    "mocap calibrate drive --car none.toml", "calibrate servo none.mcap",
    "calibrate servo --car none.toml", "identify none.mcap", "identify drive --car none.toml",
    "identify drive --held-out none.mcap", "diagnose none.mcap",
    "diagnose drive --base none.toml", "diagnose drive --held-out drive,none.mcap",
    "diagnose drive --healthy none.mcap", "replay none.mcap", "sessions tag none.mcap wet",
    "sessions note none.mcap good", "info none.mcap", "plot drive none.mcap", "recover none.mcap",
    "learn none.mcap", "learn drive --base none.toml", "sweep none.toml",
    "batch summarise none.mcap", "batch identify drive --cars none.toml",
    "import drive --map none.toml",
)  # fmt: skip
"""A line for every argument that names a file; `drive` is a file that exists, and no session."""


def run_here(lines: Iterable[str], folder: str) -> dict[str, tuple[int, str, set[str]]]:
    """In a process of its own: each command's exit code, what it said, and what heavy is loaded."""
    os.chdir(folder)
    os.environ["XDG_DATA_HOME"] = folder
    return {line: run_line(line) for line in lines}


def run_line(line: str) -> tuple[int, str, set[str]]:
    said = io.StringIO()
    with contextlib.redirect_stderr(said), contextlib.redirect_stdout(io.StringIO()):
        try:
            code = int(run_cli(line.split()))
        except SystemExit as end:
            code = int(end.code or 0)
    return code, said.getvalue(), set(HEAVY) & set(sys.modules)


@pytest.fixture(scope="module")
def load(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Callable[..., Any]]:
    """`run_here` in a fresh fork of a process that has loaded the command line and no more."""
    context, folder = multiprocessing.get_context("forkserver"), tmp_path_factory.mktemp("here")
    (folder / "drive").write_bytes(b"a file")
    context.set_forkserver_preload(["steerd.daemon.cli.main"])
    with context.Pool(1, maxtasksperchild=1) as pool:
        yield cache(lambda lines: pool.apply(run_here, (lines, str(folder))))


@pytest.mark.parametrize("line", MISSING)
def test_a_file_that_is_not_there_is_reported_before_anything_heavy_is_loaded(line, load):
    code, said, loaded = load(MISSING)[line]
    assert code == (2 if "csv:" in line else 3), said
    assert "none." in said.splitlines()[0]
    assert loaded == set()


@pytest.mark.parametrize("name", COMMANDS)
def test_help_loads_nothing_heavy(name, load):
    code, said, loaded = load(tuple(f"{each} --help" for each in COMMANDS))[f"{name} --help"]
    assert code == 0, said
    assert loaded <= {"zenoh"}  # arm, stop and the like: nothing of them works without it


def test_words_that_are_no_files_pass(load):
    """`@last` without a session is the list's to report, `hidden:x` the simulator's."""
    last, hidden = load(("info @last", f"{SIM} --sim-car hidden:x")).values()
    assert "no sessions in" in last[1]
    assert "the seed is a whole number" in hidden[1]


# One import name, its members, and no circle among them.
def test_steerd_links_to_every_room_and_to_nothing_else():
    links = {path.name: path for path in (ROOT / "steerd").iterdir() if path.is_symlink()}
    assert set(links) == set(ROOMS)
    for name, link in links.items():
        assert str(link.readlink()) == f"../{name}"  # relative: a clone may stand anywhere
    for path in (path for path in (ROOT / "steerd").rglob("*") if path.is_symlink()):
        assert path.exists()
        assert path.resolve().is_relative_to(ROOT)


@pytest.mark.parametrize(("module", "heavy"), [
    ("cli.commands.run", {"torch"}), ("loop.core", {"torch", "zenoh", "mcap"}),
    ("offline.virtual", {"torch"}),
])  # fmt: skip
def test_driving_imports_no_torch_and_the_core_neither_zenoh_nor_mcap(module, heavy):
    code = f"import sys, steerd.daemon.{module}; sys.exit(bool({heavy!r} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=False)
    assert done.returncode == 0


def test_importing_steerd_loads_nothing_of_it_and_shows_its_names():
    code = (
        "import sys, steerd\n"
        "heavy = {'numpy', 'scipy', 'torch', 'numba', 'matplotlib', 'zenoh', 'mcap', 'pandas'}\n"
        "assert not heavy & set(sys.modules), heavy & set(sys.modules)\n"
        "assert not [m for m in sys.modules if m.startswith('steerd.')]\n"
        "assert set(steerd.__all__) <= set(dir(steerd))\n"
        "assert all(getattr(steerd, name).__doc__ for name in steerd.__all__)\n"
        "assert not hasattr(steerd, 'lod')"
    )
    argv = [sys.executable, "-c", code]
    done = subprocess.run(argv, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


# No import circle anywhere in the product, inside functions and type-checking blocks included.
def test_the_product_has_no_import_circle():
    graph = build_graph("steerd", cache_dir=None)
    imports = {name: graph.find_modules_directly_imported_by(name) for name in graph.modules}
    assert "steerd.car_model.native.windows" in imports
    assert len(imports) > 200
    TopologicalSorter(imports).prepare()
