"""The session that an import writes: its name, its poses, and what breaks off."""

import hashlib
from math import nan, radians

import pytest

from steerd.daemon.cli.main import run_cli
from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.daemon.imports import import_session
from steerd.mocap_link.frame import FrameConfig
from tests.csv_logs import import_log


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


@pytest.mark.parametrize("command", ["plot", "identify", "diagnose"])
def test_a_session_that_breaks_off_is_warned_of(command, tmp_path, capsys):
    rows = [(0.02 * i, 0.01 * i, 0.0, 0.0, 0.1 * (i % 9), nan) for i in range(200)]
    session = import_log(tmp_path, rows)
    session.write_bytes(session.read_bytes()[:-200])
    capsys.readouterr()
    run_cli([command, str(session)])
    assert "warning: " in capsys.readouterr().err.replace(f"{session.name}: ", "")
