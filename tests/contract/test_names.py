"""One import name, `steerd`; its members are the rooms at the top level of this tree.

PyPI has other projects named `steerd` and `python-daemon` (which installs `daemon`): nothing of
ours may stand in site-packages under any other name.
"""

import importlib.metadata
import importlib.util
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
ROOMS = (
    "steer_bus",
    "car_model",
    "vesc_link",
    "mocap_link",
    "estimator",
    "controller",
    "sysid",
    "sim_hw",
    "sim_gap",
    "daemon",
)


@pytest.mark.parametrize("name", ROOMS)
def test_each_room_is_a_member_of_steerd_and_of_this_tree(name: str) -> None:
    spec = importlib.util.find_spec(f"steerd.{name}")
    assert spec is not None
    assert spec.origin is not None
    assert Path(spec.origin).resolve() == ROOT / name / "__init__.py"


def test_steerd_links_to_every_room_and_to_nothing_else() -> None:
    links = {path.name: path for path in (ROOT / "steerd").iterdir() if path.is_symlink()}
    assert set(links) == set(ROOMS)
    for name, link in links.items():
        assert str(link.readlink()) == f"../{name}"  # relative: a clone may stand anywhere


def test_every_link_in_the_package_ends_inside_this_tree() -> None:
    links = [path for path in (ROOT / "steerd").rglob("*") if path.is_symlink()]
    assert all(path.exists() for path in links)
    assert all(path.resolve().is_relative_to(ROOT) for path in links)


def test_no_other_distribution_brings_our_name() -> None:
    owners = importlib.metadata.packages_distributions().get("steerd", [])
    assert set(owners) <= {"steerd"}


@pytest.mark.parametrize(
    "module",
    [
        "steerd",
        "steerd.daemon.cli.commands.driving.run",
        "steerd.daemon.loop.core",
        "steerd.daemon.offline.virtual",
    ],
)
def test_driving_imports_no_torch(module: str) -> None:
    code = f"import sys, {module}; sys.exit(any(m.split('.')[0] == 'torch' for m in sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=False)
    assert done.returncode == 0


def test_the_core_imports_neither_zenoh_nor_mcap() -> None:
    code = (
        "import sys, steerd.daemon.loop.core;"
        "sys.exit(any(m.split('.')[0] in {'torch', 'zenoh', 'mcap'} for m in sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=False)
    assert done.returncode == 0


def test_the_wheel_holds_one_package() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    assert project["tool"]["hatch"]["build"]["targets"]["wheel"]["packages"] == ["steerd"]
    assert "Private :: Do Not Upload" in project["project"]["classifiers"]
