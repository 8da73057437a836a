"""The session that an import writes: its name, its poses, and what commands say of it."""

import hashlib
from math import radians

import pytest

from steerd.daemon.cli.main import run_cli
from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.daemon.imports import import_session
from steerd.mocap_link.frame import FrameConfig


def test_the_output_s_name_is_checked(tmp_path):
    with pytest.raises(SteerdError) as caught:
        import_session.check_output(tmp_path / "a.bag")
    assert caught.value.hint == f"-o {tmp_path / 'a.mcap'}"
    (tmp_path / "a.mcap").touch()
    with pytest.raises(SteerdError, match="never overwritten") as caught:
        import_session.check_output(tmp_path / "a.mcap")
    assert caught.value.code == ExitCode.USAGE


def test_a_bag_folder_s_hash_covers_all_its_files_in_order(tmp_path):
    (tmp_path / "b.db3").write_bytes(b"two")
    (tmp_path / "a.yaml").write_bytes(b"one")
    assert import_session.hash_file(tmp_path) == hashlib.sha256(b"onetwo").hexdigest()


def test_a_frame_moves_the_pose_from_the_body_to_the_centre_of_gravity():
    frame = FrameConfig(mount_yaw=radians(90.0), marker_rear_x=0.0, cog_ahead_of_rear=0.15)
    pose = import_session.MessageMaker(0, frame).planar_pose(0, 0.0, 0.0, radians(90.0))
    assert pose.yaw == pytest.approx(0.0, abs=1e-12)
    assert (pose.x, pose.y) == pytest.approx((0.15, 0.0))


# What commands of driven sessions say of an imported one, and of one that breaks off.

MAP = '[columns]\nt = "t"\nx = "x"\ny = "y"\nyaw = "yaw"\nsteer_cmd = "steer"\n'


@pytest.fixture
def imported(tmp_path, capsys):
    rows = [f"{0.02 * i:.2f},{0.01 * i:.3f},0,0,{0.1 * (i % 9)}" for i in range(200)]
    (tmp_path / "log.csv").write_text("t,x,y,yaw,steer\n" + "\n".join(rows) + "\n")
    (tmp_path / "map.toml").write_text(MAP)
    out = tmp_path / "log.mcap"
    arguments = [str(tmp_path / "log.csv"), "--map", str(tmp_path / "map.toml"), "-o", str(out)]
    assert run_cli(["import", "csv", *arguments]) == 0
    capsys.readouterr()
    return out


@pytest.mark.parametrize("argv", [("plot",), ("identify",), ("diagnose",)], ids=" ".join)
def test_a_session_that_breaks_off_is_warned_of(argv, imported, tmp_path, capsys):
    broken = tmp_path / "broken.mcap"
    broken.write_bytes(imported.read_bytes()[:-200])
    run_cli([*argv, str(broken)])
    assert "warning: " in capsys.readouterr().err.replace("broken.mcap: ", "")
