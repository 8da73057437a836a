"""`steerd plot`: what is drawn of one drive, or of several, is what was recorded; nothing else."""

import base64
import json
import re
import zlib
from dataclasses import replace
from math import nan
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from steerd.car_model.path.path_spec import parse_path
from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.daemon.imports.import_session import MessageMaker
from steerd.daemon.loop.transitions import SupervisorState
from steerd.daemon.sessions import compare, plot_data, plot_page
from steerd.daemon.sessions.compare import STEP, check_same_lane, find_shift, overlay
from steerd.daemon.sessions.info import load_recording, load_session, make_session_report
from steerd.daemon.sessions.motion import make_track
from steerd.daemon.sessions.plot_data import LANE_HALF_WIDTH, Curve, make_curve, make_drawing
from steerd.daemon.sessions.plot_page import BREAK, HELD, LEVELS, VALUE, decimate, make_grid, pack
from steerd.daemon.settings.run_options import RunOptions, encode_options
from steerd.steer_bus import messages as m
from steerd.steer_bus import topics
from steerd.steer_bus.codec import encode
from steerd.steer_bus.container import TopicInfo
from steerd.steer_bus.session import SessionWriter
from steerd.sysid.report.drawing import LINES
from steerd.sysid.report.page import render_report
from steerd.sysid.report.report import Report

EPOCH = 1_726_480_861_000_000_000


def unpack(packed, slots):
    """What `pack` packed, as the page's script reads it: values (NaN where none) and kinds."""
    planes = np.frombuffer(zlib.decompress(base64.b64decode(packed["data"])), np.uint8)
    kinds, fine, coarse = planes.reshape(3, slots)
    level = np.cumsum(fine.astype(np.int64) + 256 * coarse.astype(np.int64)) % (LEVELS + 1)
    low, high = packed["low"], packed["high"]
    return np.where(kinds == VALUE, low + level / LEVELS * (high - low), np.nan), kinds


def write(path, sent, *, files=None, reason="end", **about):
    """A session of these (topic, time [ns], message)."""
    sent, about = list(sent), {"car": "car1", **about}
    names = {topic: topics.make_session_topic(about["car"], topic) for topic, *_ in sent}
    classes = {name: topic.message for topic, name in names.items()}
    writer = SessionWriter(path, classes, {"steerd.session": about}, files or {})
    for topic, t_ns, message in sent:
        writer.write(names[topic], encode(message), t_ns)
    return writer.finish({"reason": reason})


def make_noise(seconds, rate):
    rng, maker = np.random.default_rng(3), MessageMaker(EPOCH)
    yield topics.TRANSITION, EPOCH, m.Transition(m.make_header(EPOCH, m.BODY), 4, 5, "c", "go")
    for i in range(int(seconds * rate)):
        t = round(i / rate * 1e9)
        now = t + EPOCH
        x, y, yaw = rng.normal(size=3).tolist()
        r, head = rng.normal(size=24), m.make_header(now, m.WORLD)
        e1 = 0.02 if i % 2 else -0.02
        numbers = np.array([*r[:7], *np.abs(r[7:14]), e1, *r[15:20], abs(r[20])]).tolist()
        state = m.StateMessage(head, t, i, 0, SupervisorState.RUNNING, *numbers)
        yield topics.STATE, now, state
        yield topics.MOCAP, now, maker.planar_pose(t, x, y, yaw)
        yield topics.ACTUATION, now, maker.command(t, *rng.normal(size=2).tolist())
        late, work = rng.integers(0, 1_000_000, 2).tolist()
        yield topics.TICK, now, m.Tick(m.make_header(now, m.BODY), t, t + late, work, i, 0)


def write_noise(path, seconds, rate, **more):
    """White noise on every curve: nothing packs worse."""
    about = {"car": "noisy", "mode": "hw", "epoch_ns": str(EPOCH)}
    return write(path, make_noise(seconds, rate), **about, **more)


def page_of(path):
    session = load_recording(path)
    return plot_page.make_page(make_session_report(session), make_drawing(session))


def data_of(page):
    found = re.search(r'<script type="application/json" id="data">(.*?)</script>', page, re.DOTALL)
    return json.loads(found.group(1))


def test_the_curves_are_the_recorded_numbers(tmp_path):
    path = write_noise(tmp_path / "a.mcap", 10, 50)
    session = load_recording(path)
    data = data_of(page_of(path))
    slots = data["grid"]["slots"]
    first = {panel["title"]: panel["curves"][0] for panel in data["panels"]}
    e1, _ = unpack(first["lateral error e1"], slots)
    assert sorted(set(np.round(e1[np.isfinite(e1)], 3))) == [-20.0, 20.0]
    yaw, _ = unpack(first["yaw rate"], slots)
    recorded = session.session.columns(m.StateMessage)["yaw_rate"]
    assert yaw[np.isfinite(yaw)] == pytest.approx(np.degrees(recorded), abs=1e-2)
    assert first["control tick"]["name"] == "late"
    assert 0.9 < first["control tick"]["high"] <= 1.0
    facts = dict(data["facts"])
    assert facts["lateral error RMS, after 3 s"] == "20.0 mm"
    assert facts["largest"] == "20.0 mm"
    assert data["track"]["top"] == pytest.approx(0.02, abs=1e-4), "the track's colours, in metres"
    assert data["states"] == [[0.0, "ARMED"], [0.0, "RUNNING"]]


def test_ten_minutes_of_the_worst_noise_stay_small(tmp_path):
    session = load_recording(write_noise(tmp_path / "a.mcap", 1, 20))
    report, rng = make_session_report(session), np.random.default_rng(4)
    start_ns = report.info.start_ns
    lasting = TopicInfo(1, start_ns, start_ns + 600_000_000_000)
    info = replace(report.info, counts={**report.info.counts, 99: lasting})
    t = np.arange(60_000) * 0.01
    noise = (Curve(name, "other", t, rng.normal(size=t.size)) for name in "abcdefghijklmnopqrst")
    panels = tuple(plot_data.Panel(c.name, "m", (c,)) for c in noise)
    track = make_track(t, *rng.normal(size=(3, t.size)))
    drawing = plot_data.Drawing(panels, track, rng.normal(size=t.size), None, 0.3, ())
    page = plot_page.make_page(replace(report, info=info), drawing)
    assert 1_000_000 < len(page.encode()) < plot_page.SIZE_MAX


def test_the_page_needs_nothing_else_and_takes_no_orders_from_the_session(tmp_path):
    evil = "</script><script>alert(1)</script><!-- {{ data }} {% endraw %}"
    path = write_noise(tmp_path / "<b>a&b.mcap", 4, 20, reason=evil)
    page = page_of(path)
    assert "<script>alert" not in page
    assert page.count("</script>") == 4
    assert "<title>noisy · &lt;b&gt;a&amp;b.mcap · 2024" in page
    facts = dict(data_of(page)["facts"])
    assert facts["how it ended"] == evil
    assert not re.findall(r'(?:src|href)\s*=\s*["\']?(?!data:,)[^"\'\s>]*[/.]', page)
    assert "default-src 'none'" in page


def test_the_lane_comes_from_the_session(tmp_path):
    rows = "\n".join(f"{2 * np.cos(a):.6f},{2 * np.sin(a):.6f}" for a in np.arange(0, 6.2, 0.1))
    kept = {"path.csv": f"# x_m,y_m\n{rows}\n".encode()}

    def lane_of(name, files=None, **options):
        said = encode_options(RunOptions("", **options))
        path = write_noise(tmp_path / f"{name}.mcap", 2, 20, options=said, files=files)
        return plot_data.load_lane(load_session(path))

    elsewhere = "csv:/somewhere/else.csv,place=as-is"
    lane = lane_of("a", kept, path=elsewhere)
    assert np.hypot(lane.x, lane.y) == pytest.approx(2.0, abs=0.01)
    assert lane_of("b", path=elsewhere) is None
    assert lane_of("c", drill="mixed;open") is None


def test_the_table_holds_the_curves(tmp_path, cli):
    path = write_noise(tmp_path / "a.mcap", 4, 50)
    cli("plot", path, "-o", tmp_path / "a.CSV")
    table = np.genfromtxt(tmp_path / "a.CSV", delimiter=",", names=True, deletechars="")
    yaw = load_recording(path).session.columns(m.StateMessage)["yaw_rate"]
    assert table["t_[s]"][:3] == pytest.approx([0.0, 0.01, 0.02])
    assert table["yaw_rate:_estimate_[°/s]"][::2][:200] == pytest.approx(np.degrees(yaw), abs=1e-3)


# Curves: no peak is lost, no break is bridged, what was packed comes out again.
NUMBERS = st.floats(-1e6, 1e6)


@settings(derandomize=True, deadline=None, max_examples=150)
@given(st.lists(NUMBERS, min_size=1, max_size=300, unique=True), st.integers(1, 40))
def test_every_pair_of_slots_keeps_its_extremes_in_their_order(values, buckets):
    t = np.linspace(0.0, 10.0, len(values))
    value = np.array(values)
    grid = make_grid(0.0, 10.0, buckets)
    out, kinds = decimate(grid, t, value)
    where = np.minimum((t / (2 * grid.step)).astype(int), grid.slots // 2 - 1)
    for bucket in range(grid.slots // 2):
        inside = value[where == bucket]
        pair = slice(2 * bucket, 2 * bucket + 2)
        shown = out[pair][kinds[pair] == VALUE]
        assert shown.size == min(len(inside), 2) or np.ptp(inside) == 0.0
        if len(inside):
            assert {shown.min(), shown.max()} == {inside.min(), inside.max()}
            rising = np.argmax(inside) > np.argmin(inside)
            assert shown.size == 1 or np.ptp(inside) == 0 or (shown[1] > shown[0]) == rising


@settings(derandomize=True, deadline=None, max_examples=150)
@example([(0.0, HELD), (0.0, VALUE), (1.0, HELD), (3e-184, VALUE)])
@given(
    st.lists(st.tuples(NUMBERS, st.sampled_from([HELD, VALUE, BREAK])), min_size=2, max_size=200)
)
def test_packing_keeps_values_to_one_level(items):
    items = items[: len(items) // 2 * 2]
    out = np.array([v for v, _ in items])
    kinds = np.array([k for _, k in items], np.uint8)
    values, again = unpack(pack(out, kinds), len(items))
    assert again.tolist() == kinds.tolist()
    known = kinds == VALUE
    assert np.isnan(values[~known]).all()
    step = np.ptp(out[known]) / 65535 if known.any() else 0.0
    assert np.abs(values[known] - out[known]).max(initial=0.0) <= 0.51 * step + 1e-9


def test_a_break_lasts_until_the_next_value():
    t = np.arange(10) * 0.1 + 0.001
    value = np.array([1.0, 2.0, np.nan, np.nan, 3.0, 4.0, 4.0, 4.0, 4.0, np.nan])
    _, kinds = decimate(make_grid(0.0, 1.0, 100), t, value)
    assert set(kinds[40:80]) == {BREAK}
    assert set(kinds[20:40]) == {VALUE, HELD}
    assert set(kinds[180:]) == {BREAK}


# What is drawn: curves with breaks, settled errors, the lane, what was learnt.
def test_a_curve_is_sorted_and_broken_where_samples_are_missing_and_none_without_a_number():
    t = np.array([0.2, 0.0, 0.1, 2.0])
    (curve,) = make_curve("e1", "estimate", t, np.array([3.0, 1.0, 2.0, 4.0]))
    assert curve.t == pytest.approx([0.0, 0.1, 0.2, 0.2 + plot_data.GAP / 2, 2.0])
    assert curve.value == pytest.approx([1.0, 2.0, 3.0, nan, 4.0], nan_ok=True)
    assert list(make_curve("e1", "estimate", t, np.full(4, nan))) == []


def write_log(path, files=None):
    """Poses and wheel speeds of a log that was imported."""
    maker, sent = MessageMaker(0), []
    for t in range(0, 1_000_000_000, 10_000_000):
        sent.append((topics.MOCAP, t, maker.planar_pose(t, 2e-9 * t, 0.0, 0.0)))
        sent.append((topics.WHEEL, t, maker.wheel(t, 1.9)))
    return load_recording(write(path, sent, files=files, reason="imported"))


def test_a_log_without_an_estimate_shows_the_speed_of_its_poses_beside_the_wheels(tmp_path):
    drawing = make_drawing(write_log(tmp_path / "a.mcap"))
    (speed,) = [panel for panel in drawing.panels if panel.title == "speed"]
    speeds = {curve.name: round(float(np.median(curve.value)), 3) for curve in speed.curves}
    assert speeds == {"wheels": 1.9, "from poses": 2.0}
    assert np.isnan(drawing.e1).all()
    assert dict(drawing.facts)["driven"] == "2.0 m"


@pytest.mark.parametrize(("name", "head"), [
    ("a.svg", b"<?xml"), ("a.png", b"\x89PNG"), ("a.pdf", b"%PDF"),
])  # fmt: skip
def test_figures_are_the_same_each_time(tmp_path, cli, name, head):
    write_log(tmp_path / "a.mcap")
    made = []
    for _ in range(2):
        cli("plot", tmp_path / "a.mcap", "-o", tmp_path / name)
        made.append((tmp_path / name).read_bytes())
    assert made[0] == made[1]
    assert made[0].startswith(head)


@pytest.mark.parametrize(("text", "width"), [
    ("[safety]\nlateral = 0.2\n", 0.2), ("[safety]\n", LANE_HALF_WIDTH), ("x", LANE_HALF_WIDTH),
])  # fmt: skip
def test_the_lane_is_as_wide_as_the_watchdog_of_the_recorded_car_file_allows(tmp_path, text, width):
    car = {"car.toml": text.encode()}
    assert make_drawing(write_log(tmp_path / "a.mcap", car)).half_width == width


# The learner's panels of the plot page.
NS = 1_000_000_000
NUMBERS_OF_NOTHING = (0, -1, -1, 0, 0, nan, *(nan,) * 34, "learning", *("",) * 4)


def make_reports():
    """Ten reports: nothing at first, then a bias; from the seventh on a change at 5.5 s."""
    change = {"since_ns": round(105.5 * NS), "effect": "steer_bias", "verdict": "named"}
    for second in range(10):
        now = EPOCH + second * NS
        said = change if second >= 7 else {"verdict": "none"}
        bias = {"steer_bias": nan if second < 3 else 0.01, "steer_bias_sd": 1e-3}
        nothing = m.Model(m.make_header(now, m.BODY), *NUMBERS_OF_NOTHING)
        yield topics.MODEL, now, replace(nothing, mono_ns=(100 + second) * NS, **bias, **said)


def test_a_parameter_that_was_learnt_has_a_band_and_a_change_a_line(tmp_path):
    panels = make_drawing(load_recording(write(tmp_path / "a.mcap", make_reports()))).panels
    (panel,) = [p for p in panels if p.title == "learnt: steering bias"]
    value, above, below, change = panel.curves
    np.testing.assert_allclose(value.t, np.arange(3, 10))
    np.testing.assert_allclose(value.value, np.degrees(0.01), rtol=1e-5)
    np.testing.assert_allclose(above.value - below.value, np.degrees(4e-3), rtol=1e-4)
    assert (change.name, change.t[0]) == ("change: steer_bias", pytest.approx(5.5))
    titles = [panel.title for panel in panels]
    assert titles == [title for title, _, fields, _ in plot_data.PANELS if "steer_bias" in fields]


# Drives side by side: at the same place of one lane, and over the same time.
CIRCLE = parse_path("circle:radius=2")


def drive(name="a.mcap", offset=0.0, lane=CIRCLE):
    along = np.linspace(0.0, 2.0 * lane.length, 5000)
    wave = 0.02 * np.sin(2.0 * np.pi * along / lane.length)
    values = {"e1": wave + offset, "e2": 0.1 * wave, "speed": 1.0 + wave, "steer_ref": wave}
    return compare.LaneSession(name, lane, None, along % lane.length, values, 2.0)


def test_places_of_different_lanes_are_not_compared():
    check_same_lane([drive(), drive("b.mcap")])
    other = drive("b.mcap", lane=parse_path("circle:radius=2.2"))
    with pytest.raises(SteerdError, match=r"b\.mcap"):
        check_same_lane([drive(), other])
    with pytest.raises(SteerdError, match="at most"):
        check_same_lane([drive()] * (len(LINES) + 1))


def test_the_page_names_the_drives_and_their_errors():
    sections = compare.compare_on_lane([drive("before.mcap", 0.03), drive("<b>.mcap", 0.001)])
    page = render_report(Report("", sections, ""))
    assert "before.mcap" in page
    assert "<b>" not in page
    assert "+30.0" in page
    assert page.count("<svg") == 5


def laps(rng, start, seconds, noise=0.02):
    """Yaw rate and speed of laps of 8 s that begin `start` seconds before the recording."""
    t = np.arange(0.0, seconds, STEP) + start
    phase = 2.0 * np.pi * t / 8.0
    ramp = np.clip(t / 2.0, 0.0, 1.0)
    clean = (ramp * (np.sin(phase) + 0.4 * np.sin(3.0 * phase)), ramp * (1.5 + 0.1 * np.cos(phase)))
    return [values + noise * rng.normal(size=t.size) for values in clean]


@pytest.mark.parametrize("hole", [0, 500])
@pytest.mark.parametrize("shift", [-1.3, 0.0, 0.05, 2.71])
def test_the_shift_is_found_to_a_step_for_laps_of_unequal_length_with_a_hole(shift, hole):
    rng = np.random.default_rng(5)
    first, second = laps(rng, -3.0, 40.0), laps(rng, -3.0 + shift, 31.0)
    first[0][900 : 900 + hole] = np.nan
    assert find_shift(first, second) == pytest.approx(shift, abs=1.01 * STEP)


def test_a_drive_is_itself_at_no_shift_and_another_at_a_given_one():
    read = load_recording(Path(__file__).parents[3] / "golden" / "slalom.mcap")
    same = overlay(read, read)
    assert (same.found, same.shift) == (True, 0.0)
    assert all(np.nanmax(np.abs(difference)) == 0.0 for *_, difference in same.pairs.values())
    moved = overlay(read, read, 0.5)
    known, later = same.pairs["speed [m/s]"][0], moved.pairs["speed [m/s]"][1]
    np.testing.assert_allclose(later, known[: len(later)], atol=1e-9)
    assert moved.t[0] == 0.5
    with pytest.raises(SteerdError, match="no time in common"):
        overlay(read, read, 1e3)


def test_drives_without_a_lane_are_compared_over_time_alone(tmp_path, cli):
    paths = [write_noise(tmp_path / f"{name}.mcap", 1, 20) for name in "ab"]
    page = tmp_path / "ab.html"
    cli("plot", *paths, "-o", page)
    text = page.read_text(encoding="utf-8")
    assert "Not compared along a lane: a.mcap" in text
    assert "Over the same time" in text
    assert "The difference is b.mcap minus a.mcap." in text
    cli("plot", *paths, paths[0], "-o", page, code=ExitCode.INVALID)
    said = cli("plot", *paths, paths[0], "--shift", "1", code=ExitCode.USAGE).err
    assert "--shift is for two drives" in said
