"""A csv file becomes the session that its map says: every cell, every refusal, no leftovers."""

import hashlib
import math
import os
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.daemon.imports.csv_log import LINE_MAX, import_csv
from steerd.daemon.imports.import_map import load_map, parse_map
from steerd.steer_bus import messages as m
from steerd.steer_bus.session_read import open_session

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


def refuse(folder, text, the_map=ALL):
    with pytest.raises(SteerdError) as caught:
        convert(folder, text, the_map)
    assert "\n" not in str(caught.value)
    assert not list(folder.glob("out*")), "something was left behind"
    return caught.value


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
    assert (about["mode"], about["car"], about["source"]) == ("import", "red", "run.csv")
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


@pytest.mark.parametrize(("text", "part"), [
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
])  # fmt: skip
def test_what_is_wrong_is_said_where_it_is(tmp_path, text, part):
    error = refuse(tmp_path, text, WHEEL)
    assert part in error.what
    assert error.code == (ExitCode.UNREADABLE if part in UNREADABLE else ExitCode.INVALID)


@pytest.mark.parametrize(("text", "the_map", "part"), [
    ("t,Wheel_Speed,other\n0,1,1\n", WHEEL.replace('"v"', '"wheel_speed"'), "'Wheel_Speed'"),
    ("t,v\n1726480861250,1\n", WHEEL, "scale = 0.001"),
    ("t,v\n0,1e10\n", '[columns]\nt = "t"\nerpm = "v"\n', "no motor speed"),
    ("t,v\n0,1\n", '[session]\ncar = "a"\n', "[columns]"),
])  # fmt: skip
def test_what_was_perhaps_meant_is_said(tmp_path, text, the_map, part):
    error = refuse(tmp_path, text, the_map)
    assert part in f"{error.what} {error.hint}"


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
