"""What the recorded drives show whoever looks: clocks that drift apart, speeds that poses give."""

from pathlib import Path

import pytest

from steerd.daemon.analysis.drives import load_drive
from steerd.daemon.cli.main import run_cli

ROOT = Path(__file__).resolve().parents[2]
DART = ROOT.parent / "shared" / "data" / "dart"
FREE = ("10_01_01", "10_02_28", "10_12_05", "10_27_02")


def imported(tmp_path, name):
    source = DART / f"rubber_free__09_16_2024_{name}.csv"
    if not source.exists():
        pytest.skip(f"the recorded drives are not here: ../shared/data/dart/{source.name}")
    out = tmp_path / f"{name}.mcap"
    the_map = ROOT / "examples" / "import-dart.toml"
    assert run_cli(["import", "csv", str(source), "--map", str(the_map), "-o", str(out)]) == 0
    return load_drive(out, "command", lambda texts: None)[1]


def test_four_drives_of_a_morning_were_logged_late_by_the_same_two_timers(tmp_path, capsys):
    jitters = [imported(tmp_path, name).log_jitter for name in FREE]
    capsys.readouterr()
    assert all(jitter is not None for jitter in jitters)
    drifts = [jitter.drift * jitter.period for jitter in jitters]
    assert all(-2.2e-3 < drift < -1.2e-3 for drift in drifts)


def test_a_spinning_encoder_is_not_the_speed_where_poses_are_sharp(tmp_path, capsys):
    run = imported(tmp_path, FREE[0])
    capsys.readouterr()
    assert run.speed_source == "pose"
    assert len(run.wheel.t) > 1000
