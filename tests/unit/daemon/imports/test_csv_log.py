"""A csv file becomes the session that its map says: every cell, every refusal, no leftovers."""

import hashlib
import math
import os
from fractions import Fraction
from math import nan, radians

import numpy as np
import pytest
import tomlkit
from hypothesis import given, settings
from hypothesis import strategies as st

from steerd.daemon.cli.main import run_cli
from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.daemon.imports import import_session
from steerd.daemon.imports.csv_log import LINE_MAX, import_csv
from steerd.daemon.imports.import_map import STREAM_COLUMNS, load_map, parse_map
from steerd.steer_bus import messages as m
from steerd.steer_bus.session_read import open_session
from tests.csv_logs import import_log

COLUMNS = {
    "t": "t", "x": "x", "y": "y", "yaw": "yaw", "steer_cmd": "steer", "speed_cmd": "speed",
    "throttle": "gas", "wheel_speed": "wheel", "erpm": "erpm", "yaw_rate": "wz",
}  # fmt: skip
ALL = "\n".join(["[columns]", *(f'{name} = "{cell}"' for name, cell in COLUMNS.items()), ""])
HEADER = ",".join(COLUMNS.values()) + "\n"
WHEEL = '[columns]\nt = "t"\nwheel_speed = "v"\n'


def convert(folder, text, the_map=ALL, name="run.csv"):
    source, map_path, out = folder / name, folder / "map.toml", folder / "out.mcap"
    source.write_bytes(text if isinstance(text, bytes) else text.encode())
    map_path.write_text(the_map)
    report = import_csv(source, load_map(map_path), out, lambda done: None)
    return report, open_session(out)


def rows(session, cls, *names):
    """The messages of a kind, each as a tuple of these columns."""
    columns = session.columns(cls)
    return list(zip(*(columns[name].tolist() for name in names), strict=True))


def test_every_stream_becomes_its_message(tmp_path):
    text = HEADER + "0.5,1,2,0.25,0.1,1.5,0.3,1.4,6000,0.7\n1.0,1.5,2,4,,,,,,\n"
    report, session = convert(tmp_path, text)
    assert report.counts == {
        "mocap": 2, "actuation": 1, "vesc": 1, "wheel": 1, "throttle": 1, "imu": 1,
    }  # fmt: skip
    assert rows(session, m.MocapPose, "x", "y", "t_valid_ns", "reject", "tracking_valid") == [
        (1.0, 2.0, 500_000_000, "", 1), (1.5, 2.0, 1_000_000_000, "", 1)
    ]  # fmt: skip
    assert session.columns(m.MocapPose)["yaw"] == pytest.approx([0.25, 4 - 2 * math.pi])
    speed_mode = m.ActuationMode.SPEED
    assert rows(session, m.Actuation, "mode", "steer", "speed") == [(speed_mode, 0.1, 1.5)]
    assert rows(session, m.VescTelemetry, "erpm", "tachometer") == [(6000, -1)]
    assert math.isnan(session.columns(m.VescTelemetry)["v_in"][0])
    assert rows(session, m.WheelSpeed, "speed", "t_ns") == [(1.4, 500_000_000)]
    assert rows(session, m.Throttle, "throttle") == [(0.3,)]
    assert rows(session, m.VescImu, "gyro_z") == [(0.7,)]
    assert math.isnan(session.columns(m.VescImu)["accel_x"][0])


def test_metadata_says_where_it_comes_from(tmp_path):
    the_map = ALL + '[session]\ncar = "red"\nepoch = 1726480861\ncomment = "dry"\n'
    text = HEADER + "2,1,2,0,,,,,,\n"
    _, session = convert(tmp_path, text, the_map)
    about = session.info().metadata["steerd.session"]
    assert (about["mode"], about["car"], about["comment"]) == ("import", "red", "dry")
    assert about["source"] == "run.csv"
    assert about["source_sha256"] == hashlib.sha256(text.encode()).hexdigest()
    assert session.attachment("map.toml").decode() == the_map
    assert session.info().clean
    assert [topic.name for topic in session.info().topics if topic.count] == ["/steerd/red/mocap"]
    assert session.info().start_ns == 1_726_480_863_000_000_000
    assert session.columns(m.MocapPose)["stamp_ns"].tolist() == [1_726_480_863_000_000_000]


def test_a_channel_without_a_value_is_nan_and_a_stream_without_one_is_silent(tmp_path):
    rows = "0,,,,0.1,,,,,\n1,,,,,2,,,,\n2,nan,NaN,NA,,,,1,,null\n3,1,2,,,,,,,\n"
    report, session = convert(tmp_path, HEADER + rows)
    command = session.columns(m.Actuation)
    np.testing.assert_equal(command["steer"], [0.1, math.nan])
    np.testing.assert_equal(command["speed"], [math.nan, 2.0])
    assert (report.counts["mocap"], report.counts["wheel"]) == (0, 1)
    assert report.notes == ("1 rows hold a part of a pose and were left out of it",)


def test_scale_offset_and_gate(tmp_path):
    the_map = (
        '[columns]\nt = { column = "ms", scale = 1e-3 }\n'
        'wheel_speed = { column = "rpm", scale = 0.01, offset = -1.0 }\n'
        'throttle = { column = "gas", scale = 2.0, offset = 0.5, gate = "safe" }\n'
    )
    _, session = convert(tmp_path, "ms,rpm,gas,safe\n1500,300,0.2,1\n1600,100,0.2,0\n", the_map)
    wheel = rows(session, m.WheelSpeed, "t_ns", "speed")
    assert wheel == [(1_500_000_000, 2.0), (1_600_000_000, 0.0)]
    assert session.columns(m.Throttle)["throttle"].tolist() == [0.9, 0.0]


@pytest.mark.parametrize("delimiter", [",", ";", "\t", "|", " ", ", "])
@pytest.mark.parametrize("newline", ["\n", "\r\n"])
@pytest.mark.parametrize("start", ["", "\ufeff", "# ", "\n\n"])
def test_delimiters_and_headers_that_labs_write(tmp_path, delimiter, newline, start):
    rows = [["t", "v", "note"], ["0.5", "1.25", "7"], ["0.75", "-3e-1", "8"]]
    text = start + newline.join(delimiter.join(row) for row in rows)
    _, session = convert(tmp_path, text.encode(), WHEEL)
    assert session.columns(m.WheelSpeed)["speed"].tolist() == [1.25, -0.3]


def test_quoted_names_and_decimal_commas(tmp_path):
    the_map = '[columns]\nt = "time, s"\nwheel_speed = "v"\n'
    _, session = convert(tmp_path, '"time, s";"v"\n0,5;1,25\n', the_map)
    assert rows(session, m.WheelSpeed, "t_ns", "speed") == [(500_000_000, 1.25)]


def test_times_before_zero_raise_the_epoch_and_equal_ones_are_kept_and_counted(tmp_path):
    report, session = convert(tmp_path, "t,v\n-2.5,1\n-1.5,2\n-1.5,3\n", WHEEL)
    assert session.info().start_ns == 0
    wheel = rows(session, m.WheelSpeed, "t_ns", "speed")
    assert wheel == [(-2_500_000_000, 1.0), (-1_500_000_000, 2.0), (-1_500_000_000, 3.0)]
    assert report.notes == ("1 rows repeat the time of the row before",)


UNREADABLE = ("is empty", "blank", "no UTF-8")
WRONG = [
    ("", "is empty"), ("\n \n", "blank"), (b"t,v\n0,\xff\xfe\n", "no UTF-8"),
    ("t,v\n", "holds no sample"), ("t,v\n0,\n1,nan\n", "holds no sample"),
    ("t,w\n0,1\n", "no column 'v'"), ("t,v,v\n0,1,2\n", "2 columns named 'v'"),
    ("t,v\n0,1\n1,abc\n", "row 3, column 'v': 'abc' is not a number"),
    ("\n# t,v\n0,1\n\n1,\n2,abc\n", "row 6, column 'v'"),
    ("t,v\n0,inf\n", "row 2, column 'v': 'inf'"), ("t,v\n0,1_0\n", "row 2, column 'v'"),
    ("t,v\n0,1e999\n", "row 2, column 'v'"), ("t,v\n0,1\n,1\n", "row 3, column 't': no time"),
    ("t,v\n0,1\n2,1\n1,1\n", "row 4, column 't': time goes back by 1 s after row 3"),
    ("t,v\n0,1,2\n", "row 2: 3 cells under 2 column names"),
    ("t,v\n1e10,1\n", "row 2, column 't': 1e+10 s is no time"),
    ("t,v\n" + "1" * LINE_MAX, "row 2: more than"),
    ('t,v\n0,"1' + "1" * 140_000 + '"\n', "row 2: field larger"),
]  # fmt: skip


@pytest.mark.parametrize(("the_map", "text", "part"), [
    *((WHEEL, *row) for row in WRONG), (WHEEL, "t,v\n1726480861250,1\n", "scale = 0.001"),
    (WHEEL.replace('"v"', '"wheel_speed"'), "t,Wheel_Speed,other\n0,1,1\n", "'Wheel_Speed'"),
    ('[columns]\nt = "t"\nerpm = "v"\n', "t,v\n0,1e10\n", "no motor speed"),
    ('[session]\ncar = "a"\n', "t,v\n0,1\n", "[columns]"),
])  # fmt: skip
def test_what_is_wrong_is_said_where_it_is_with_what_was_meant(tmp_path, the_map, text, part):
    with pytest.raises(SteerdError) as caught:
        convert(tmp_path, text, the_map)
    error = caught.value
    assert "\n" not in str(error)
    assert not list(tmp_path.glob("out*")), "something was left behind"
    assert part in (error.what if (text, part) in WRONG else f"{error.what} {error.hint}")
    assert error.code == (ExitCode.UNREADABLE if part in UNREADABLE else ExitCode.INVALID)


def test_what_is_no_file_and_where_none_can_be_made(tmp_path):
    os.mkfifo(tmp_path / "fifo")
    (tmp_path / "a.csv").write_text("t,v\n0,1\n")
    for name, out in (("", "o"), ("fifo", "o"), ("none", "o"), ("a.csv", "no/o")):
        with pytest.raises(SteerdError) as caught:
            import_csv(tmp_path / name, parse_map(WHEEL), tmp_path / f"{out}.mcap", print)
        assert caught.value.code == ExitCode.UNREADABLE


cells = st.one_of(
    st.floats(-1e6, 1e6).map(repr),
    st.sampled_from(["", "nan", "NaN", "inf", "-", "1,5", "1e400", "0x10", '"', "abc", "٣", "1 "]),
    st.text(max_size=4),
)


@pytest.mark.slow
@settings(derandomize=True, deadline=None, max_examples=60)
@given(rows=st.lists(st.lists(cells, max_size=4), max_size=6), times=st.booleans())
def test_any_cells_are_taken_or_refused_in_one_line(tmp_path_factory, rows, times):
    folder = tmp_path_factory.mktemp("cells")
    lines = [",".join([str(i), *row] if times else row) for i, row in enumerate(rows)]
    text = "\n".join(["t,v,x,y", *lines]).encode("utf-8", "replace")
    refusal = ""
    try:
        report, session = convert(folder, text, WHEEL)
    except SteerdError as error:
        refusal = str(error)
    assert "\n" not in refusal
    assert bool(refusal) != bool(list(folder.glob("out*")))
    if not refusal:
        values = session.columns(m.WheelSpeed)["speed"]
        assert len(values) == report.counts["wheel"] > 0
        assert np.isfinite(values).all()


@settings(derandomize=True, deadline=None, max_examples=50)
@given(
    values=st.lists(st.none() | st.floats(-1e9, 1e9), min_size=1, max_size=30).filter(
        lambda v: any(x is not None for x in v)
    ),
    step_ns=st.integers(1, 10**12),
)
def test_numbers_come_back_as_written(tmp_path_factory, values, step_ns):
    folder = tmp_path_factory.mktemp("numbers")
    rows = [f"{i * step_ns / 1e9!r},{'' if v is None else repr(v)}" for i, v in enumerate(values)]
    _, session = convert(folder, "t,v\n" + "\n".join(rows), WHEEL)
    columns = session.columns(m.WheelSpeed)
    kept = [i for i, value in enumerate(values) if value is not None]
    times = [round(Fraction(i * step_ns / 1e9) * 10**9) for i in kept]
    assert columns["t_ns"].tolist() == times
    assert columns["speed"].tolist() == [values[i] for i in kept]


# Maps: what they may say, and that anything else is one clear line.
POSE = '[columns]\nt = "t"\nx = "x"\ny = "y"\nyaw = "yaw"\n'


def test_an_epoch_without_zone_is_utc_and_may_be_seconds():
    same = ("2024-09-16T10:01:01", "2024-09-16T10:01:01Z", "2024-09-16T12:01:01+02:00")
    for epoch in (*same, "1726480861", "1726480861.0"):
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
    frame = parse_map("[frame]\nmount_yaw_deg = 90.0\ncog_ahead_of_rear = 0.15\n").frame
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
