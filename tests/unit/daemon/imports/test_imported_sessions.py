"""What commands of driven sessions say of an imported one, and of one that breaks off."""

import pytest

from steerd.daemon.cli.main import run_cli

MAP = '[columns]\nt = "t"\nx = "x"\ny = "y"\nyaw = "yaw"\nsteer_cmd = "steer"\n'


@pytest.fixture
def imported(tmp_path, capsys):
    rows = [f"{0.02 * i:.2f},{0.01 * i:.3f},0,0,{0.1 * (i % 9)}" for i in range(2000)]
    (tmp_path / "log.csv").write_text("t,x,y,yaw,steer\n" + "\n".join(rows) + "\n")
    (tmp_path / "map.toml").write_text(MAP)
    out = tmp_path / "log.mcap"
    arguments = [str(tmp_path / "log.csv"), "--map", str(tmp_path / "map.toml"), "-o", str(out)]
    assert run_cli(["import", "csv", *arguments]) == 0
    capsys.readouterr()
    return out


def test_the_body_of_an_imported_log_is_not_calibrated(imported, capsys):
    assert run_cli(["mocap", "calibrate", str(imported)]) == 4
    assert "the car's poses only" in capsys.readouterr().err


def test_an_imported_log_has_nothing_to_replay(imported, capsys):
    assert run_cli(["replay", str(imported)]) == 4
    assert "it lacks options" in capsys.readouterr().err


@pytest.mark.parametrize("argv", [("plot",), ("identify",), ("diagnose",)], ids=" ".join)
def test_a_session_that_breaks_off_is_warned_of(argv, imported, tmp_path, capsys):
    broken = tmp_path / "broken.mcap"
    broken.write_bytes(imported.read_bytes()[:-200])
    run_cli([*argv, str(broken)])
    assert "warning: " in capsys.readouterr().err.replace("broken.mcap: ", "")


@pytest.mark.parametrize("argv", [("replay",), ("identify",), ("diagnose",)], ids=" ".join)
def test_a_folder_is_reported_once(argv, tmp_path, capsys):
    assert run_cli([*argv, str(tmp_path)]) == 3
    assert capsys.readouterr().err.count("name a session .mcap file") == 1
