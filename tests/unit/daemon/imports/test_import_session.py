"""The session that an import writes: its messages, its metadata, and nothing after a failure."""

import hashlib
from math import radians

import pytest

from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.daemon.imports.import_map import ImportMap
from steerd.daemon.imports.import_session import (
    ImportNotes,
    MessageMaker,
    Sample,
    check_output,
    hash_file,
    write_import,
)
from steerd.mocap_link.frame import FrameConfig
from steerd.steer_bus.topics import WHEEL


def samples(count, maker):
    for i in range(count):
        yield Sample(
            WHEEL, i * 10_000_000, i * 10_000_000 + 5, maker.wheel(i * 10_000_000, 0.1 * i)
        )


def test_a_failure_while_writing_leaves_nothing(tmp_path):
    source, out = tmp_path / "log.csv", tmp_path / "a.mcap"
    source.write_text("x")

    def failing():
        yield from samples(2, MessageMaker(0))
        raise SteerdError("row 4: no number")

    with pytest.raises(SteerdError, match="row 4"):
        write_import(out, source, ImportMap(), [WHEEL], failing())
    with pytest.raises(SteerdError, match="holds no sample"):
        write_import(out, source, ImportMap(), [WHEEL], [])
    assert list(tmp_path.iterdir()) == [source]


def test_the_output_s_name_is_checked(tmp_path):
    with pytest.raises(SteerdError) as caught:
        check_output(tmp_path / "a.bag")
    assert caught.value.hint == f"-o {tmp_path / 'a.mcap'}"
    (tmp_path / "a.mcap").touch()
    with pytest.raises(SteerdError, match="never overwritten") as caught:
        check_output(tmp_path / "a.mcap")
    assert caught.value.code == ExitCode.USAGE


def test_a_bag_folder_s_hash_covers_all_its_files_in_order(tmp_path):
    (tmp_path / "b.db3").write_bytes(b"two")
    (tmp_path / "a.yaml").write_bytes(b"one")
    assert hash_file(tmp_path) == hashlib.sha256(b"onetwo").hexdigest()


def test_a_frame_moves_the_pose_from_the_body_to_the_centre_of_gravity():
    frame = FrameConfig(mount_yaw=radians(90.0), marker_rear_x=0.0, cog_ahead_of_rear=0.15)
    pose = MessageMaker(0, frame).planar_pose(0, 0.0, 0.0, radians(90.0))
    assert pose.yaw == pytest.approx(0.0, abs=1e-12)
    assert (pose.x, pose.y) == pytest.approx((0.15, 0.0))


def test_oddities_are_counted_by_kind():
    notes = ImportNotes()
    for _ in range(3):
        notes.add("rows repeat a time")
    notes.add("frames without the body")
    assert notes.lines() == ("3 rows repeat a time", "1 frames without the body")
