"""Maps: what they may say, and that anything else is one clear line; the session of an import."""

import hashlib
from math import nan, radians

import pytest
import tomlkit
from hypothesis import given, settings
from hypothesis import strategies as st

from steerd.daemon.cli.main import run_cli
from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.daemon.imports import import_session
from steerd.daemon.imports.import_map import STREAM_COLUMNS, load_map, parse_map
from steerd.mocap_link.frame import FrameConfig
from tests.csv_logs import import_log

POSE = '[columns]\nt = "t"\nx = "x"\ny = "y"\nyaw = "yaw"\n'


def test_a_whole_map():
    the_map = parse_map(
        '[columns]\nt = "time"\nsteer_cmd = { column = "steer", scale = 0.5, offset = -0.1 }\n'
        'throttle = { column = "gas", gate = "safety" }\n'
        "[frame]\nmount_yaw_deg = 90.0\nmarker_rear_x = 0.2\n"
        '[session]\ncar = "blue_1"\nepoch = 2024-09-16T10:01:01Z\ncomment = "wet"\n'
    )
    assert the_map.columns["t"].column == "time"
    assert (the_map.columns["steer_cmd"].scale, the_map.columns["steer_cmd"].offset) == (0.5, -0.1)
    assert the_map.columns["throttle"].gate == "safety"
    assert the_map.frame.mount_yaw == radians(90.0)
    assert (the_map.car, the_map.comment) == ("blue_1", "wet")
    assert the_map.epoch_ns == 1_726_480_861_000_000_000


def test_an_epoch_without_zone_is_utc_and_may_be_seconds():
    for epoch in ("2024-09-16T10:01:01", "1726480861", "1726480861.0", "2024-09-16T12:01:01+02:00"):
        the_map = parse_map(f"{POSE}[session]\nepoch = {epoch}\n")
        assert the_map.epoch_ns == 1_726_480_861_000_000_000


@pytest.mark.parametrize(("text", "part"), [
    ("[columns", "Expected"), ('[columns]\nx = "x"\ny = "y"\nyaw = "yaw"', "lacks 't'"),
    ('[columns]\nt = "t"', "no column but the time"),
    ('[columns]\nt = "t"\nx = "x"', "y, yaw missing"),
    ('[columns]\nt = "t"\nspeed = "v"', "'speed' is none of"),
    ('[columns]\nt = "t"\nerpm = 3', "[columns]"),
    ('[columns]\nt = "t"\nerpm = { column = "e", skale = 2.0 }', "skale"),
    ('[columns]\nt = "t"\nerpm = { column = "e", scale = 0.0 }', "scale not 0"),
    ('[columns]\nt = "t"\nerpm = { column = "e", scale = nan }', "finite"),
    ('[column]\nt = "t"', "'column'"), (POSE + '[session]\ncar = "My Car"', "car name"),
    (POSE + "[session]\nepoch = -1.0", "epoch"), (POSE + "[session]\nepoch = inf", "epoch"),
    (POSE + '[frame]\nunits = "ft"', "expected m or mm"), (POSE + '[frame]\nup = "x"', "up axis"),
    ('[topics]\nposes = "/a"', "'poses' is none of"), ("[vesc]\nerpm_gain = 0", "ERPM of 1 m/s"),
    ("a = " + "[" * 5000 + "]" * 5000, ""),
])  # fmt: skip
def test_what_a_map_cannot_say(tmp_path, text, part):
    path = tmp_path / "map.toml"
    path.write_text(text)
    with pytest.raises(SteerdError) as caught:
        load_map(path)
    assert part in caught.value.what
    assert "\n" not in str(caught.value)
    assert "$" not in caught.value.what
    assert caught.value.code == ExitCode.INVALID


@pytest.mark.parametrize("content", [None, b"\xff\xfe", b"#" * 1_000_001])
def test_a_map_that_is_missing_or_no_text_page(tmp_path, content):
    path = tmp_path / "map.toml"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(SteerdError, match="map") as caught:
        load_map(path)
    assert content is not None or caught.value.code == ExitCode.UNREADABLE


texts = st.text(st.characters(exclude_categories=["Cs"]), max_size=8)
leaves = st.booleans() | st.integers(-(2**63), 2**63 - 1) | st.floats() | texts
spec = {"column": texts, "scale": st.floats(), "other": leaves}
specs = texts | st.fixed_dictionaries({}, optional=spec)


@settings(derandomize=True, deadline=None, max_examples=80)
@given(
    st.dictionaries(st.sampled_from(("t", *STREAM_COLUMNS, "z")), specs),
    st.dictionaries(st.sampled_from(("car", "epoch", "comment", "x")), leaves),
)
def test_any_map_is_taken_or_refused_in_one_line(columns, session):
    refusal, the_map = "", None
    try:
        the_map = parse_map(tomlkit.dumps({"columns": columns, "session": session}))
    except ValueError as error:
        refusal = str(error)
    assert "\n" not in refusal
    assert refusal or the_map is None or not the_map.columns or "t" in the_map.columns


# The session that an import writes: its name, its poses, and what breaks off.
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
