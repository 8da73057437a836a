"""No import circle anywhere in the product, inside functions and type-checking blocks included."""

import ast
from collections.abc import Iterator, Mapping
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
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
