"""Our import names belong to this tree: another project owns `steerd` on PyPI, another `daemon`."""

import importlib.metadata
import importlib.util
import subprocess
import sys
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
def test_each_import_name_resolves_to_this_tree(name: str) -> None:
    spec = importlib.util.find_spec(name)
    assert spec is not None
    assert spec.origin is not None
    assert Path(spec.origin).resolve() == ROOT / name / "__init__.py"


@pytest.mark.parametrize("name", ROOMS)
def test_no_other_distribution_brings_one_of_our_names(name: str) -> None:
    owners = importlib.metadata.packages_distributions().get(name, [])
    assert set(owners) <= {"steerd"}


@pytest.mark.parametrize(
    "module",
    [
        "steerd.daemon.cli.commands.driving.run",
        "steerd.daemon.loop.core",
        "steerd.daemon.offline.virtual",
    ],
)
def test_run_imports_no_torch(module: str) -> None:
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


def test_the_wheel_lists_every_room() -> None:
    import tomllib

    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    assert project["tool"]["hatch"]["build"]["targets"]["wheel"]["packages"] == list(ROOMS)
    assert "Private :: Do Not Upload" in project["project"]["classifiers"]
