"""A user's effect, one file in a scratch car model, is listed, simulated, fitted and diagnosed."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parents[2]
PULL = 0.012  # wheel angle per speed that the simulated car has [rad s/m]
PAGE = (ROOT / "docs" / "how-to" / "your-own-effect.md").read_text()
NEW_EFFECT = PAGE.partition("```python\n")[2].partition("```")[0]


@pytest.fixture(scope="module")
def scratch(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the package `steerd` in it, whose car model has one file more."""
    folder = tmp_path_factory.mktemp("scratch")
    package = folder / "steerd"
    package.mkdir()
    for entry in (ROOT / "steerd").iterdir():
        if entry.name != "car_model":
            (package / entry.name).symlink_to(entry.resolve())
    unwanted = shutil.ignore_patterns("__pycache__")
    shutil.copytree(ROOT / "car_model", package / "car_model", ignore=unwanted)
    (folder / "speed_pull.py").write_text(NEW_EFFECT)
    assert "added: speed_pull" in steerd(folder, "effects", "--add", "speed_pull.py")
    return folder


def steerd(scratch: Path, *argv: object) -> str:
    """What the command prints; it must succeed."""
    done = subprocess.run(
        [sys.executable, "-m", "steerd", *map(str, argv)],
        cwd=scratch, capture_output=True, text=True, check=False, timeout=600,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def session(scratch: Path) -> Path:
    path = scratch / "pull.mcap"
    steerd(scratch, "run", "--sim", "--fast", "--path", "figure8", "--speed", 1.8, "--duration", 24,
           "--effect", f"speed_pull={PULL}", "--record", path)  # fmt: skip
    return path


def test_it_is_listed(scratch):
    assert "pull" in steerd(scratch, "effects", "speed_pull")
    listed = json.loads(steerd(scratch, "effects", "--json"))["effects"]
    assert "speed_pull" in {effect["name"] for effect in listed}


def test_diagnose_names_it_fits_it_and_keeps_it_in_a_car_file(scratch, session):
    report, car = scratch / "gap.json", scratch / "car.toml"
    steerd(scratch, "diagnose", session, "--no-pairs", "--json", report, "-o", car)
    verdict = json.loads(report.read_text())
    (cause,) = verdict["causes"]
    found = cause["parameters"]["pull"]
    assert cause["effect"] == "speed_pull"
    assert abs(found["value"] - PULL) < max(0.2 * PULL, 3.0 * found["sd"])
    assert "[effects.speed_pull]" in car.read_text()
