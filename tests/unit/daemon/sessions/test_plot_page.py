"""`steerd plot`: what is drawn is what was recorded, in a page that needs nothing else."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest

from steerd.daemon.cli.main import run_cli
from steerd.daemon.imports.import_session import MessageMaker
from steerd.daemon.loop.transitions import SupervisorState
from steerd.daemon.sessions.info import load_recording, load_session, make_session_report
from steerd.daemon.sessions.motion import make_track
from steerd.daemon.sessions.plot_data import Curve, Drawing, Panel, load_lane, make_drawing
from steerd.daemon.sessions.plot_page import SIZE_MAX, make_page
from steerd.daemon.settings.run_options import RunOptions, encode_options
from steerd.steer_bus import messages as m
from steerd.steer_bus import topics
from steerd.steer_bus.codec import encode
from steerd.steer_bus.container import ChannelCount
from steerd.steer_bus.session import SessionWriter
from tests.unit.daemon.sessions.page_script import unpack

EPOCH = 1_726_480_861_000_000_000


def state(t_ns, i, mode, e1, rng):
    r = rng.normal(size=24)
    fields = [*r[:7], *np.abs(r[7:14]), e1, *r[15:20], abs(r[20])]
    return m.StateMessage(
        m.make_header(t_ns + EPOCH, m.WORLD), t_ns, i, 0, mode, *map(float, fields)
    )


def write_noise(path, seconds, rate, *, options=None, files=None, reason="end", car_name="noisy"):
    """White noise on every curve: nothing packs worse."""
    rng = np.random.default_rng(3)
    table = (topics.STATE, topics.MOCAP, topics.ACTUATION, topics.TICK, topics.TRANSITION)
    names = {topics.make_session_topic(car_name, t): t.message for t in table}
    about = {"car": car_name, "mode": "hw", "epoch_ns": str(EPOCH)}
    about |= {"options": encode_options(options)} if options else {}
    writer = SessionWriter(path, names, {"steerd.session": about}, files or {})
    maker = MessageMaker(EPOCH)

    def put(topic, message, t_ns):
        writer.write(topics.make_session_topic(car_name, topic), encode(message), t_ns + EPOCH)

    put(topics.TRANSITION, m.Transition(m.make_header(EPOCH, m.BODY), 4, 5, "c", "go"), 0)
    for i in range(int(seconds * rate)):
        t = round(i / rate * 1e9)
        x, y, yaw = rng.normal(size=3).tolist()
        put(topics.STATE, state(t, i, SupervisorState.RUNNING, 0.02 * (1 if i % 2 else -1), rng), t)
        put(topics.MOCAP, maker.planar_pose(t, x, y, yaw), t)
        put(topics.ACTUATION, maker.command(t, *rng.normal(size=2).tolist()), t)
        late, work = rng.integers(0, 1_000_000, 2).tolist()
        tick = m.Tick(m.make_header(t + EPOCH, m.BODY), t, t + late, work, i, 0)
        put(topics.TICK, tick, t)
    return writer.finish({"reason": reason})


def page_of(path):
    session = load_recording(path)
    return make_page(make_session_report(session), make_drawing(session))


def data_of(page):
    found = re.search(r'<script type="application/json" id="data">(.*?)</script>', page, re.DOTALL)
    return json.loads(found.group(1))


def test_the_curves_are_the_recorded_numbers(tmp_path):
    path = write_noise(tmp_path / "a.mcap", 10, 50)
    session = load_recording(path)
    data = data_of(page_of(path))
    slots = data["grid"]["slots"]
    panels = {panel["title"]: panel for panel in data["panels"]}
    e1, _ = unpack(panels["lateral error e1"]["curves"][0], slots)
    assert sorted(set(np.round(e1[np.isfinite(e1)], 3))) == [-20.0, 20.0]
    yaw, _ = unpack(panels["yaw rate"]["curves"][0], slots)
    recorded = session.session.columns(m.StateMessage)["yaw_rate"]
    assert yaw[np.isfinite(yaw)] == pytest.approx(np.degrees(recorded), abs=1e-2)
    late = panels["control tick"]["curves"][0]
    assert late["name"] == "late"
    assert 0.9 < late["high"] <= 1.0
    facts = dict(data["facts"])
    assert facts["lateral error RMS, after 3 s"] == "20.0 mm"
    assert facts["largest"] == "20.0 mm"
    assert data["track"]["top"] == pytest.approx(0.02, abs=1e-4), "the track's colours, in metres"
    assert data["states"] == [[0.0, "ARMED"], [0.0, "RUNNING"]]


def test_ten_minutes_of_the_worst_noise_stay_small(tmp_path):
    session = load_recording(write_noise(tmp_path / "a.mcap", 1, 20))
    report, rng = make_session_report(session), np.random.default_rng(4)
    start_ns = report.info.start_ns
    lasting = ChannelCount(1, start_ns, start_ns + 600_000_000_000)
    info = replace(report.info, counts={**report.info.counts, 99: lasting})
    t = np.arange(60_000) * 0.01
    noise = (Curve(name, "other", t, rng.normal(size=t.size)) for name in "abcdefghijklmnopqrst")
    panels = tuple(Panel(c.name, "m", (c,)) for c in noise)
    track = make_track(t, *rng.normal(size=(3, t.size)))
    drawing = Drawing(panels, track, rng.normal(size=t.size), None, 0.3, ())
    page = make_page(replace(report, info=info), drawing)
    assert 1_000_000 < len(page.encode()) < SIZE_MAX


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
    spec = "csv:/somewhere/else.csv,place=as-is"
    options = RunOptions("", path=spec)
    kept = {"path.csv": f"# x_m,y_m\n{rows}\n".encode()}
    lane = load_lane(load_session(write_noise(tmp_path / "a.mcap", 2, 20, options=options,
                                              files=kept)))  # fmt: skip
    assert np.hypot(lane.x, lane.y) == pytest.approx(2.0, abs=0.01)
    absent = load_session(write_noise(tmp_path / "b.mcap", 2, 20, options=options))
    assert load_lane(absent) is None
    drill = RunOptions("", drill="mixed;open")
    assert load_lane(load_session(write_noise(tmp_path / "c.mcap", 2, 20, options=drill))) is None


def test_the_table_holds_the_curves_and_figures_are_the_same_each_time(tmp_path, capsys):
    path = write_noise(tmp_path / "a.mcap", 4, 50)
    assert run_cli(["plot", str(path), "-o", str(tmp_path / "a.CSV")]) == 0
    table = np.genfromtxt(tmp_path / "a.CSV", delimiter=",", names=True, deletechars="")
    yaw = load_recording(path).session.columns(m.StateMessage)["yaw_rate"]
    assert table["t_[s]"][:3] == pytest.approx([0.0, 0.01, 0.02])
    assert table["yaw_rate:_estimate_[°/s]"][::2][:200] == pytest.approx(np.degrees(yaw), abs=1e-3)
    for name, head in (("a.svg", b"<?xml"), ("a.png", b"\x89PNG"), ("a.pdf", b"%PDF")):
        assert run_cli(["plot", str(path), "-o", str(tmp_path / name)]) == 0
        first = (tmp_path / name).read_bytes()
        assert first.startswith(head)
        assert run_cli(["plot", str(path), "-o", str(tmp_path / name)]) == 0
        assert (tmp_path / name).read_bytes() == first
    assert run_cli(["plot", str(path), str(path), "-o", str(tmp_path / "b.svg")]) == 2
    assert "compared on a page" in capsys.readouterr().err
