"""The offline commands as a person types them, on recorded drives."""

import json
from pathlib import Path

import numpy as np
import pytest

from steerd.car_model.effects import EFFECTS, parse_effects
from steerd.steer_bus.messages import MocapPose
from steerd.steer_bus.session_read import open_session

ROOT = Path(__file__).resolve().parents[2]
EXAMPLES = ROOT / "examples"
DATA = ROOT.parent / "shared" / "data"
DART = "rubber_free__09_16_2024_10_27_02.csv"


def data_file(*parts):
    path = DATA.joinpath(*parts)
    if not path.exists():
        pytest.skip(f"the recorded drives are not here: ../shared/data/{'/'.join(parts)}")
    return path


def read_csv(path):
    return np.genfromtxt(path, delimiter=",", names=True)


@pytest.mark.parametrize(
    "path", sorted(DATA.glob("dart/*.csv")) or ["absent"], ids=lambda p: Path(p).stem[-20:]
)
def test_every_dart_drive_raises_no_warning(tmp_path, cli, path):
    source, out = data_file("dart", Path(path).name), tmp_path / "dart.mcap"
    shown = cli("import", "csv", source, "--map", EXAMPLES / "import-dart.toml", "-o", out)
    assert len(shown.out.splitlines()) < 24
    assert shown.err == ""
    table, document = read_csv(source), json.loads(cli("info", out, "--json").out)
    names = ("mocap", "actuation", "throttle", "wheel")
    counts = {topic["name"]: topic["count"] for topic in document["topics"]}
    assert counts == {f"/steerd/dart/{name}": len(table) for name in names}
    assert document["warnings"] == []
    drive = document["drive"]
    assert drive["length_m"] > 50.0
    constant = [line for line in drive["excitation"] if "steering is constant" in line]
    assert bool(constant) == ("free" not in source.name)
    if source.name == DART:  # its page says: up to 9.9 m/s^2; the wheel drives the path's length
        assert drive["lateral_accel"]["high"] == pytest.approx(9.9, abs=0.3)
        wheel = float(np.sum(table["enc_v"][:-1] * np.diff(table["t"])))
        assert drive["length_m"] == pytest.approx(wheel, rel=0.1)
        marker = 0.115 - 0.093
        x = open_session(out).columns(MocapPose)["x"]
        assert x == pytest.approx(table["x"] - marker * np.cos(table["yaw"]), abs=1e-12)


@pytest.mark.parametrize(("name", "top_speed"), [("DS1.csv", 4.9), ("DS3.csv", 1.5)])
def test_the_f1tenth_drives(tmp_path, cli, name, top_speed):
    source, out = data_file("f1tenth_upenn", name), tmp_path / "a.mcap"
    the_map = EXAMPLES / "import-f1tenth-upenn.toml"
    assert cli("import", "csv", source, "--map", the_map, "-o", out).err == ""
    table, document = read_csv(source), json.loads(cli("info", out, "--json").out)
    drive = document["drive"]
    assert drive["speed"]["high"] == pytest.approx(top_speed, abs=0.1)
    wheel = float(np.sum(np.abs(table["vesc_odom_vx"])[:-1] * np.diff(table["t"])))
    assert drive["length_m"] == pytest.approx(wheel, rel=0.05)
    assert 20.0 < document["topics"][0]["rate_hz"] < 45.0
    assert document["warnings"] == []


@pytest.mark.parametrize("name", sorted(EFFECTS))
def test_the_example_of_each_effect_can_be_typed(name, cli):
    example = cli("effects", name).out.rpartition("--effect ")[2].strip()
    ((effect, values),) = parse_effects(example)
    assert effect is EFFECTS[name]
    assert values != effect.nulls


def test_all_effects_in_a_table(cli, monkeypatch):
    lines = cli("effects").out.splitlines()
    assert {line.split()[0] for line in lines if line.startswith("  ")} == set(EFFECTS)
    assert all(any(e.equation in line for line in lines) for e in EFFECTS.values())
    document = json.loads(cli("effects", "--json").out)
    assert {effect["name"] for effect in document["effects"]} == set(EFFECTS)
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    monkeypatch.setenv("COLUMNS", "80")
    assert max(map(len, cli("effects").out.splitlines())) <= 80


def test_the_page_of_effects_is_the_library(cli):
    assert cli("effects", "--page").out == (ROOT / "docs" / "reference" / "effects.md").read_text()
