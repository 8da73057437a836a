"""One import name, its members, and no circle among them."""

import ast
import importlib.metadata
import importlib.util
import subprocess
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path

import pytest

from steerd.version import VERSION
from tests.contract.size import GOALS, ROOT

ROOMS = [name for name in GOALS["product"][0] if name != "steerd"]


@pytest.mark.parametrize("name", ROOMS)
def test_each_room_is_a_member_of_steerd_and_of_this_tree(name):
    spec = importlib.util.find_spec(f"steerd.{name}")
    assert spec.origin is not None
    assert Path(spec.origin).resolve() == ROOT / name / "__init__.py"


def test_steerd_links_to_every_room_and_to_nothing_else():
    links = {path.name: path for path in (ROOT / "steerd").iterdir() if path.is_symlink()}
    assert set(links) == set(ROOMS)
    for name, link in links.items():
        assert str(link.readlink()) == f"../{name}"  # relative: a clone may stand anywhere
    for path in (path for path in (ROOT / "steerd").rglob("*") if path.is_symlink()):
        assert path.exists()
        assert path.resolve().is_relative_to(ROOT)


@pytest.mark.parametrize(
    ("module", "heavy"),
    [
        ("cli.commands.run", {"torch"}),
        ("loop.core", {"torch", "zenoh", "mcap"}),
        ("offline.virtual", {"torch"}),
    ],
)
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
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr


# Layers hold, and the command is there.

SCRIPTS = Path(sys.executable).parent


def test_rooms_import_downwards_only():
    done = subprocess.run(
        [SCRIPTS / "lint-imports", "--no-cache"],
        cwd=ROOT, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout
    assert "0 broken" in done.stdout


def test_the_console_script_is_ours():
    points = importlib.metadata.entry_points(group="console_scripts", name="steerd")
    assert {point.value for point in points} == {"steerd.daemon.cli.main:main"}
    done = subprocess.run(
        [SCRIPTS / "steerd", "--version"], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0
    assert done.stdout == f"steerd {VERSION}\n"


# No import circle anywhere in the product, inside functions and type-checking blocks included.

PACKAGE = "steerd"

Graph = Mapping[str, frozenset[str]]


def module_paths(root: Path = ROOT) -> dict[str, Path]:
    """Every product module by its import name; the package's members are links to folders."""
    found = {PACKAGE: root / PACKAGE / "__init__.py"}
    for member in sorted((root / PACKAGE).iterdir()):
        pattern = "**/*.py" if member.is_dir() else ""
        files = sorted(member.resolve().glob(pattern)) if pattern else [member]
        base = member.resolve() if pattern else member.parent
        for file in files:
            if file.suffix != ".py":
                continue
            parts = file.relative_to(base).with_suffix("").parts
            names = [PACKAGE, *([member.name] if pattern else []), *parts]
            found[".".join(n for n in names if n != "__init__")] = file
    return found


def imported(source: str, known: frozenset[str]) -> Iterator[str]:
    """Product modules that a file imports, at any depth: `from package import module` too."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name in known)
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            for alias in node.names:
                whole = f"{node.module}.{alias.name}"
                if whole in known:
                    yield whole
                elif node.module in known:
                    yield node.module


def import_graph(paths: Mapping[str, Path]) -> Graph:
    """Which module imports which."""
    known = frozenset(paths)
    return {
        name: frozenset(imported(path.read_text(encoding="utf-8"), known)) - {name}
        for name, path in paths.items()
    }


def find_circle(graph: Graph) -> list[str]:
    """Modules of one import circle, the first one again at the end; empty if there is none."""
    done: set[str] = set()
    for first in graph:
        trail: list[str] = []
        todo = [(first, False)]
        while todo:
            name, left = todo.pop()
            if left:
                done.add(trail.pop())
            elif name in trail:
                return [*trail[trail.index(name) :], name]
            elif name not in done:
                trail.append(name)
                todo.append((name, True))
                todo += [(other, False) for other in sorted(graph.get(name, ()))]
    return []


def test_the_product_has_no_import_circle():
    paths = module_paths()
    assert len(paths) > 200
    assert f"{PACKAGE}.car_model.native.windows" in paths
    assert find_circle(import_graph(paths)) == []


def test_a_circle_is_found_in_functions_and_type_checking_blocks():
    known = frozenset({"steerd.a", "steerd.b"})
    inside = "def f():\n    from steerd.b import thing\n"
    typed = "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from steerd import a\n"
    graph = {
        "steerd.a": frozenset(imported(inside, known)),
        "steerd.b": frozenset(imported(typed, known)),
    }
    assert find_circle(graph) == ["steerd.a", "steerd.b", "steerd.a"]
    assert find_circle({**graph, "steerd.b": frozenset()}) == []
