"""One import name, its members, and no circle among them."""

import subprocess
import sys
from graphlib import TopologicalSorter

import pytest
from grimp import build_graph

from tests.contract.size import GOALS, ROOT

ROOMS = [name for name in GOALS["product"][0] if name != "steerd"]


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


# No import circle anywhere in the product, inside functions and type-checking blocks included.


def test_the_product_has_no_import_circle():
    graph = build_graph("steerd", cache_dir=None)
    imports = {name: graph.find_modules_directly_imported_by(name) for name in graph.modules}
    assert "steerd.car_model.native.windows" in imports
    assert len(imports) > 200
    TopologicalSorter(imports).prepare()
