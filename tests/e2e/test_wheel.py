"""The wheel in an environment of its own: one import name, all its files, a user's effect added.

It is built from a source distribution, that from a copy of the checkout, and installed beside
python-daemon, whose `daemon` package once wrote over ours. Dependencies are those of the tests.
"""

import importlib.metadata
import json
import os
import re
import shutil
import subprocess
import sys
import tarfile
import zipfile
from functools import partial
from pathlib import Path, PurePosixPath

import pytest

from steerd.version import VERSION
from tests.contract.size import ROOMS, ROOT
from tests.unit.car_model.native.test_windows import OWN

pytestmark = pytest.mark.slow

LANE = "run --sim --fast --path figure8 --speed 1.8"
PULL = 0.012  # wheel angle per speed that the simulated car has [rad s/m]
PAGE = (ROOT / "docs" / "how-to" / "your-own-effect.md").read_text()
NEW_EFFECT = PAGE.partition("```python\n")[2].partition("```")[0]


def build(kind: str, source: Path, folder: Path) -> Path:
    command = [sys.executable, "-m", "hatchling", "build", "-t", kind, "-d", str(folder)]
    done = subprocess.run(command, cwd=source, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    (made,) = folder.glob("*.whl" if kind == "wheel" else "*.tar.gz")
    return made


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Checkout to source distribution to wheel."""
    folder = tmp_path_factory.mktemp("wheel")
    unwanted = shutil.ignore_patterns(".[!g]*", ".git", "__pycache__", "*.mcap", "docs", "tests")
    shutil.copytree(ROOT, folder / "checkout", symlinks=True, ignore=unwanted)
    # For this processor alone: that every level is there is looked at in the checkout's library.
    loader = folder / "checkout" / "car_model" / "native" / "library.py"
    loader.write_text(re.sub(rf'"v\d": "(?!{OWN}")[^"]+",? ?', "", loader.read_text()))
    archive = build("sdist", folder / "checkout", folder / "sdist")
    with tarfile.open(archive) as packed:
        packed.extractall(folder / "unpacked", filter="data")
    (source,) = (folder / "unpacked").iterdir()
    return build("wheel", source, folder / "wheel")


@pytest.fixture(scope="module")
def home(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A virtual environment with python-daemon and then the wheel; sessions are made in it."""
    home = tmp_path_factory.mktemp("home")
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", home], check=True)
    (site,) = (home / "lib").glob("python*/site-packages")
    for file in importlib.metadata.files("python-daemon") or ():
        if ".." not in file.parts:
            target = site / file
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(file.locate(), target)
    pip = [sys.executable, "-m", "pip", "--python", str(home / "bin" / "python")]
    options = ["--quiet", "--no-deps", "--no-index", "--disable-pip-version-check"]
    subprocess.run([*pip, "install", *options, str(wheel)], check=True)
    # After the environment's own folder, so that its steerd and its daemon come first; the links
    # of editable installs (.pth files) do not count in a folder that a .pth file names.
    theirs = sorted({str(Path(p)) for p in sys.path if p.endswith("site-packages")})
    site.joinpath("dependencies.pth").write_text("\n".join(theirs))
    return home


def run(home: Path, program: str, *words: str, codes: tuple[int, ...] = (0,)) -> str:
    """Run a program of the environment outside the checkout; give what it printed."""
    environment = {k: v for k, v in os.environ.items() if not k.startswith("PYTHON")}
    done = subprocess.run(
        [home / "bin" / program, *words], cwd=home, env=environment,
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode in codes, done.stderr
    return done.stdout


def test_the_wheel_has_one_top_level_name_and_every_file(wheel):
    names = {PurePosixPath(name) for name in zipfile.ZipFile(wheel).namelist()}
    tops = {name.parts[0] for name in names}
    assert tops == {"steerd", f"steer_daemon-{VERSION}.dist-info"}
    for room in ROOMS:
        kept = {
            PurePosixPath("steerd") / path.relative_to(ROOT).as_posix()
            for path in (ROOT / room).rglob("*")
            if path.is_file() and "__pycache__" not in path.parts
        }
        assert kept <= names, room
    assert PurePosixPath("steerd/data/f1tenth.toml") in names
    assert PurePosixPath("steerd/data/examples/import-dart.toml") in names
    assert PurePosixPath("steerd/py.typed") in names
    assert not [name for name in names if "test_" in name.name or "tests" in name.parts]


def test_python_daemon_and_steerd_leave_each_other_alone(home):
    code = (
        "import daemon, steerd.daemon; print(daemon.DaemonContext.__name__); "
        "print(daemon.__file__); print(steerd.daemon.__file__)"
    )
    context, theirs, ours = run(home, "python", "-c", code).splitlines()
    assert context == "DaemonContext"
    assert Path(theirs).is_relative_to(home)
    assert Path(ours).is_relative_to(home)


def test_the_wheel_drives_plots_and_identifies(home):
    steerd = partial(run, home, "steerd")
    steerd(*LANE.split(), "--duration", "20", "--record", "lane.mcap")
    steerd("plot", "lane.mcap")
    assert "<script" in (home / "lane.html").read_text()
    written = ("-o", "car.toml", "--report", "fit.html", "--free", "c_sf,c_sr")
    steerd("identify", "lane.mcap", *written, codes=(0, 5))
    assert "noise" in json.loads((home / "car.posterior.json").read_text())
    assert (home / "fit.html").stat().st_size > 10_000


def test_an_effect_that_a_user_adds_is_listed_simulated_named_and_kept_in_a_car_file(home):
    """Last, for the library is compiled anew: the tests before have used that of the wheel."""
    steerd = partial(run, home, "steerd")
    (home / "speed_pull.py").write_text(NEW_EFFECT)
    assert "added: speed_pull" in steerd("effects", "--add", "speed_pull.py")
    assert "pull" in steerd("effects", "speed_pull")
    listed = json.loads(steerd("effects", "--json"))["effects"]
    assert "speed_pull" in {effect["name"] for effect in listed}
    pull = f"speed_pull={PULL}"
    steerd(*LANE.split(), "--duration", "24", "--effect", pull, "--record", "pull.mcap")
    written = ("--json", "gap.json", "--report", "gap.html", "-o", "pull.toml")
    among = ("--only", "speed_pull", "--only", "steer_bias", "--no-closed-loop")
    steerd("diagnose", "pull.mcap", "--no-pairs", *among, *written)
    (cause,) = json.loads((home / "gap.json").read_text())["causes"]
    found = cause["parameters"]["pull"]
    assert cause["effect"] == "speed_pull"
    assert abs(found["value"] - PULL) < max(0.2 * PULL, 3.0 * found["sd"])
    assert "[effects.speed_pull]" in (home / "pull.toml").read_text()
    assert (home / "gap.html").stat().st_size > 10_000
