"""A map proposed from a log, what it would mean, and the conversation about it."""

import io
import shlex
import tomllib

import numpy as np
import pytest

from steerd.daemon.cli.main import run_cli
from steerd.daemon.common.errors import ExitCode
from steerd.daemon.imports.bag import BAG_ROLES, find_best
from steerd.daemon.imports.import_map import parse_map
from steerd.daemon.imports.propose import change, format_map, guess_scale, propose_csv
from steerd.steer_bus.messages import Actuation, MocapPose, VescTelemetry
from steerd.steer_bus.session_read import open_session
from steerd.sysid.data.dataset import read_run
from tests.unit.daemon.imports.test_bag import Bag

NS, START = 10**9, 1_726_480_861_000_000_000
CIRCLE = 0.5  # rad/s on a circle of 2 m at 1 m/s


def circle(t):
    return 2.0 * np.sin(CIRCLE * t), 2.0 - 2.0 * np.cos(CIRCLE * t), CIRCLE * t


def write_csv(path, sign=1.0):
    t = np.arange(0.0, 12.0, 0.02)
    x, y, yaw = circle(t)
    wrapped = np.degrees((yaw + np.pi) % (2 * np.pi) - np.pi)
    steer = np.degrees(sign * (0.16 + 0.02 * np.sin(t)))
    rows = np.column_stack([1e3 * t, 1e3 * x, 1e3 * y, wrapped, steer, np.ones_like(t)])
    text = "time_ms,pos_x,pos_y,heading_deg,steering,cmd_speed\n"
    path.write_text(text + "\n".join(",".join(f"{v:.4f}" for v in row) for row in rows))
    return path


def write_bag(path, kind, gain=-7300.0, **topics):
    named = {"pose": "/vrpn_mocap/car/pose", "command": "/ackermann_cmd", **topics}
    with Bag(path, kind) as bag:
        for i in range(240):
            t_ns, t = START + i * NS // 20, i / 20
            x, y, yaw = circle(t)
            bag.pose(named["pose"], t_ns, x, y, yaw)
            bag.pose("/pf/viz/inferred_pose", t_ns, x + 0.1, y, yaw)
            bag.drive(named["command"], t_ns, 0.16, 1.0)
            bag.drive("/drive", t_ns, 0.3, 2.0)
            bag.vesc("/vesc/sensors/core", t_ns, speed=gain)
    return path


def talk(monkeypatch, *lines):
    monkeypatch.setattr("sys.stdin", io.StringIO("".join(f"{line}\n" for line in lines)))


def test_columns_and_units_are_guessed(tmp_path):
    columns = propose_csv(write_csv(tmp_path / "run.csv"))["columns"]
    assert columns["t"] == {"column": "time_ms", "scale": 0.001}
    assert columns["x"] == {"column": "pos_x", "scale": 0.001}
    assert columns["yaw"]["scale"] == columns["steer_cmd"]["scale"] == pytest.approx(np.pi / 180)
    assert columns["speed_cmd"] == "cmd_speed"


@pytest.mark.parametrize(("quantity", "values", "scale"), [
    ("t", [0.0, 0.01], 1.0), ("t", [0.0, 10.0], 1e-3), ("t", [0.0, 1e4], 1e-6),
    ("t", [0.0, 1e7], 1e-9), ("x", [0.0, 4.0], 1.0), ("y", [0.0, 4000.0], 1e-3),
    ("yaw", [0.0, 12.0], 1.0), ("yaw", [-179.0, 179.0], np.pi / 180),
    ("steer_cmd", [-1.0, 1.0], 1.0), ("steer_cmd", [-20.0, 20.0], np.pi / 180), ("x", [1.0], 1.0),
])  # fmt: skip
def test_a_unit_is_guessed_by_the_size_of_the_numbers(quantity, values, scale):
    assert guess_scale(quantity, np.array(values)) == pytest.approx(scale)


def test_a_proposal_is_changed_line_by_line():
    proposal = {"columns": {"t": "t", "x": "a"}}
    for line in (
        "x = north * 0.001", "steer_cmd = wheel", "erpm_gain = -7300", "car = blue", "steer_cmd ="
    ):  # fmt: skip
        assert change(proposal, line) == ""
    assert "one of" in change(proposal, "steering = wheel")
    assert "not a number" in change(proposal, "erpm_gain = fast")
    assert "for instance" in change(proposal, "what?")
    made = tomllib.loads(format_map(proposal, "run.csv"))
    assert made == {
        "columns": {"t": "t", "x": {"column": "north", "scale": 0.001}},
        "vesc": {"erpm_gain": -7300.0}, "session": {"car": "blue"},
    }  # fmt: skip


def test_a_csv_s_map_is_explained_and_the_steering_turned(tmp_path, monkeypatch, cli):
    source = write_csv(tmp_path / "run.csv", sign=-1.0)
    talk(monkeypatch, "car = blue", "")
    assert "to the left, 0° to the right" in cli("import", "--ask", source).out
    the_map = parse_map((tmp_path / "run.map.toml").read_text())
    assert the_map.columns["steer_cmd"].scale == pytest.approx(-np.pi / 180)
    session = open_session(tmp_path / "run.mcap")
    assert session.info().metadata["steerd.session"]["car"] == "blue"
    assert np.nanmean(session.columns(Actuation)["steer"]) == pytest.approx(0.16, abs=0.01)


@pytest.mark.parametrize("lines", [(), ("q",), ("nonsense", "q"), ("t =", "")])
def test_without_a_yes_nothing_is_written(tmp_path, monkeypatch, lines):
    source = write_csv(tmp_path / "run.csv")
    talk(monkeypatch, *lines)
    assert run_cli(["import", "--ask", str(source)]) == ExitCode.USAGE
    assert sorted(path.name for path in tmp_path.iterdir()) == ["run.csv"]


@pytest.mark.parametrize("kind", ["ros1", "mcap", "db3"])
def test_the_topics_of_a_car_are_known_by_name(tmp_path, kind, cli):
    path = write_bag(tmp_path / ("run.bag" if kind == "ros1" else "run"), kind, gain=4614.0)
    out = tmp_path / "out.mcap"
    said = cli("import", path, "-o", out)
    assert "pose is /vrpn_mocap/car/pose, not /pf/viz/inferred_pose" in said.err
    assert "command is /ackermann_cmd, not /drive" in said.err
    session = open_session(out)
    assert session.columns(MocapPose)["x"][0] == pytest.approx(0.0, abs=1e-9)
    assert set(session.columns(Actuation)["speed"]) == {1.0}
    assert len(session.columns(VescTelemetry)["erpm"]) == 240
    assert "warning" not in said.err


def test_the_sign_and_scale_of_a_foreign_vesc_are_doubted_and_can_be_stated(tmp_path, cli):
    path = write_bag(tmp_path / "run", "mcap")
    doubted = cli("import", path, "-o", tmp_path / "a.mcap")
    assert "-7300 ERPM per m/s" in doubted.err
    again = next(line for line in doubted.out.splitlines() if "again: " in line)
    assert f"next: steerd identify {tmp_path / 'a-erpm.mcap'}" in doubted.out
    stated = cli("import", path, "--erpm-gain", "-7300", "-o", tmp_path / "b.mcap")
    assert "ERPM" not in stated.err
    assert "again: " not in stated.out
    typed = shlex.split(again.partition(": ")[2])
    assert "ERPM" not in cli(*typed[1:]).err, "the line works as it stands"
    scaling = open_session(tmp_path / "b.mcap").info().metadata["steerd.scaling"]
    assert float(scaling["erpm_gain"]) == -7300.0
    run = read_run(open_session(tmp_path / "b.mcap"))
    assert np.median(run.wheel.values) == pytest.approx(1.0)
    assert (run.servo_frame, run.speed_ramp) == (0.0, 0.0), "steerd never drove this VESC"


def test_asked_for_a_bag_the_poses_say_what_the_erpm_mean(tmp_path, monkeypatch, cli):
    path = write_bag(tmp_path / "run", "mcap")
    talk(monkeypatch, "")
    said = cli("import", "--ask", path, "-o", tmp_path / "a.mcap").out
    assert "motor     -7300 ERPM per m/s, by the poses" in said
    assert parse_map((tmp_path / "a.map.toml").read_text()).vesc.erpm_gain == -7300.0


def test_what_a_bag_lacks_is_said(tmp_path, cli):
    with Bag(tmp_path / "run", "mcap") as bag:
        for i in range(30):
            bag.drive("/drive", START + i * NS // 20, 0.1, 1.0)
    printed = cli("import", tmp_path / "run", "-o", tmp_path / "a.mcap")
    assert "no pose: identify and diagnose need the car's track" in printed.err
    assert "no vesc: the wheels' speed is not known" in printed.err
    assert "next: steerd plot" in printed.out, "nothing to identify"
    whole = write_bag(tmp_path / "whole", "mcap")
    assert "next: steerd identify" in cli("import", whole, "-o", tmp_path / "b.mcap").out


@pytest.mark.parametrize(("role", "topics", "best"), [
    ("command", ["/drive", "/ackermann_cmd", "/teleop"], ["/ackermann_cmd"]),
    ("command", ["/drive", "/teleop"], ["/drive"]),
    ("pose", ["/odom", "/vrpn_client_node/car/pose"], ["/vrpn_client_node/car/pose"]),
    ("pose", ["/mocap/a", "/mocap/b", "/odom"], ["/mocap/a", "/mocap/b"]),
    ("vesc", ["/other", "/sensors/core"], ["/sensors/core"]), ("pose", ["/a", "/b"], ["/a", "/b"]),
])  # fmt: skip
def test_names_decide_where_they_can(role, topics, best):
    assert find_best(dict.fromkeys(topics, BAG_ROLES[role].types[0]))[role] == best
