"""ROS bags, written by rosbags itself, become what they hold; a map proposed from a log."""

import importlib.util
import io
import math
import shlex
import sys
import tomllib
from dataclasses import replace

import numpy as np
import pytest
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from steerd.daemon.cli.main import run_cli
from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.daemon.imports.bag import BAG_ROLES, RIGIDS, RIGIDS_TEXT, find_best, import_bag
from steerd.daemon.imports.import_map import ColumnSpec, parse_map
from steerd.daemon.imports.propose import change, format_map, guess_scale
from steerd.steer_bus.messages import Actuation, MocapPose, VescTelemetry, WheelSpeed
from steerd.steer_bus.session_read import open_session
from steerd.sysid.data.dataset import read_run

START = 1_726_480_861_000_000_000


def stamped(package, name, field, **fields):
    """The definition of a stamped message of another package; its fields by their types."""
    lines = [f"{kind} {each}" for kind, names in fields.items() for each in names.split()]
    return "\n".join([f"Header header\n{package}/{name} {field}", 80 * "=",
                      f"MSG: {package}/{name}", *lines, ""])  # fmt: skip


ACKERMANN = stamped(
    "ackermann_msgs", "AckermannDrive", "drive",
    float32="steering_angle steering_angle_velocity speed acceleration jerk",
)  # fmt: skip
VESC_1 = stamped(
    "vesc_msgs", "VescState", "state",
    float64="voltage_input temperature_pcb current_motor current_input speed duty_cycle"
    " charge_drawn charge_regen energy_drawn energy_regen displacement distance_traveled",
    int32="fault_code",
)  # fmt: skip
VESC_2 = stamped(
    "vesc_msgs", "VescState", "state",
    float64="temp_fet temp_motor current_motor current_input avg_id avg_iq duty_cycle speed"
    " voltage_input charge_drawn charge_regen energy_drawn energy_regen pid_pos_now"
    " ntc_temp_mos1 ntc_temp_mos2 ntc_temp_mos3 avg_vd avg_vq",
    int32="displacement distance_traveled fault_code controller_id",
)  # fmt: skip


class Bag:
    """Makes one bag, ROS 1 or ROS 2."""

    def __init__(self, path, kind):
        self.path, self.ros1 = path, kind == "ros1"
        self.store = get_typestore(Stores.ROS1_NOETIC if self.ros1 else Stores.ROS2_HUMBLE)
        for name, text in {
            "ackermann_msgs/msg/AckermannDriveStamped": ACKERMANN,
            "vesc_msgs/msg/VescStateStamped": VESC_1 if self.ros1 else VESC_2,
            RIGIDS: RIGIDS_TEXT.replace("float64 heading_y\n", "") if self.ros1 else RIGIDS_TEXT,
        }.items():
            text = text if self.ros1 else text.replace("Header header", "std_msgs/Header header", 1)
            types = get_types_from_msg(text.replace("std_msgs/std_msgs", "std_msgs"), name)
            known = self.store.fielddefs
            self.store.register({k: v for k, v in types.items() if k not in known})
        self.of = {name.rpartition("/")[2]: made for name, made in self.store.types.items()}
        plugin = {"storage_plugin": StoragePlugin.SQLITE3 if kind == "db3" else StoragePlugin.MCAP}
        self.writer = Writer1(path) if self.ros1 else Writer2(path, version=8, **plugin)
        self.connections = {}

    def add(self, topic, kind, t_ns, *values, stamp_ns=None):
        if topic not in self.connections:
            self.connections[topic] = self.writer.add_connection(topic, kind, typestore=self.store)
        stamp = divmod(t_ns if stamp_ns is None else stamp_ns, 10**9)
        time = self.store.types["builtin_interfaces/msg/Time"](*stamp)
        header = self.of["Header"](*((0,) if self.ros1 else ()), time, "map")
        message = self.store.types[kind](header, *values)
        serialize = self.store.serialize_ros1 if self.ros1 else self.store.serialize_cdr
        self.writer.write(self.connections[topic], t_ns, serialize(message, kind))

    def raw_pose(self, x, y, yaw):
        turn = self.of["Quaternion"](0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2))
        return self.of["Pose"](self.of["Point"](x, y, 0.1), turn)

    def pose(self, topic, t_ns, x, y, yaw, **more):
        self.add(topic, "geometry_msgs/msg/PoseStamped", t_ns, self.raw_pose(x, y, yaw), **more)

    def odometry(self, topic, t_ns, x, y, yaw, speed):
        pose = self.of["PoseWithCovariance"](self.raw_pose(x, y, yaw), np.zeros(36))
        rates = (self.of["Vector3"](forward, 0.0, 0.0) for forward in (speed, 0.0))
        twist = self.of["TwistWithCovariance"](self.of["Twist"](*rates), np.zeros(36))
        self.add(topic, "nav_msgs/msg/Odometry", t_ns, "base_link", pose, twist)

    def drive(self, topic, t_ns, steer, speed):
        drive = self.of["AckermannDrive"](steer, 0.0, speed, 0.0, 0.0)
        self.add(topic, "ackermann_msgs/msg/AckermannDriveStamped", t_ns, drive)

    def vesc(self, topic, t_ns, **values):
        cls = self.of["VescState"]
        names = (n for n in cls.__dataclass_fields__ if n.islower() and not n.startswith("_"))
        state = cls(*[values.get(name, 0) for name in names])
        self.add(topic, "vesc_msgs/msg/VescStateStamped", t_ns, state)

    def rigids(self, topic, t_ns, bodies, **more):
        turn = (1.0, 0.0, 0.0, 0.0) if self.ros1 else (1.0, 0.0, 0.0, 0.0, 0.0)
        made = [self.of["Rigid"](key, 0, 0, x, y, z, *turn, cond) for key, x, y, z, cond in bodies]
        self.add(topic, RIGIDS, t_ns, made, **more)


def make_bag(folder, kind, fill):
    bag = Bag(folder / ("run.bag" if kind == "ros1" else "run"), kind)
    with bag.writer:
        fill(bag)
    return bag.path


def convert(folder, bag, *, topics=(), rigid=None, the_map=None):
    out, made = folder / "out.mcap", replace(parse_map(the_map or ""), rigid=rigid)
    report = import_bag(bag, made, out, lambda done: None, topics)
    return report, open_session(out)


def refuse(folder, bag, **more):
    with pytest.raises(SteerdError) as caught:
        convert(folder, bag, **more)
    assert "\n" not in str(caught.value)
    assert not list(folder.glob("out*"))
    return caught.value


def drive(bag):
    for i in range(20):
        t_ns = START + i * 10_000_000
        bag.pose("/vrpn/car/pose", t_ns, 0.1 * i, 1.0, 0.5, stamp_ns=t_ns - 5_000_000)
        bag.drive("/drive", t_ns + 1, 0.25, 1.5)
        told = {"speed": 4614.0, "voltage_input": 11.5, "temperature_pcb": 31.0, "temp_fet": 31.0}
        bag.vesc("/core", t_ns + 2, **told)


@pytest.mark.parametrize("kind", ["ros1", "mcap", "db3"])
def test_a_drive_comes_over_whole(tmp_path, kind):
    report, session = convert(tmp_path, make_bag(tmp_path, kind, drive))
    assert report.counts == {"mocap": 20, "actuation": 20, "vesc": 20}
    pose = session.columns(MocapPose)
    assert pose["x"] == pytest.approx(0.1 * np.arange(20))
    assert pose["yaw"] == pytest.approx(np.full(20, 0.5))
    assert pose["stamp_ns"].tolist() == [START + i * 10_000_000 - 5_000_000 for i in range(20)]
    assert (pose["t_arrival_ns"] - pose["t_valid_ns"]).tolist() == [5_000_000] * 20
    command, vesc = session.columns(Actuation), session.columns(VescTelemetry)
    assert [set(command[name]) for name in ("steer", "speed")] == [{0.25}, {1.5}]
    assert [set(vesc[name]) for name in ("erpm", "v_in", "temp_fet")] == [{4614}, {11.5}, {31.0}]
    about = session.info().metadata["steerd.session"]
    assert (about["mode"], len(about["source_sha256"])) == ("import", 64)
    assert int(about["epoch_ns"]) == START


@pytest.mark.parametrize("kind", ["ros1", "mcap"])
def test_odometry_gives_pose_and_wheel_speed(tmp_path, kind):
    def fill(bag):
        for i in range(5):
            bag.odometry("/odom", START + i, 1.0 * i, 0.0, 0.1, 2.5)

    bag, topics = make_bag(tmp_path, kind, fill), ["pose=/odom", "wheel=/odom"]
    _, session = convert(tmp_path, bag, topics=topics)
    assert session.columns(MocapPose)["x"].tolist() == [0.0, 1.0, 2.0, 3.0, 4.0]
    assert session.columns(WheelSpeed)["speed"].tolist() == [2.5] * 5


@pytest.mark.parametrize("kind", ["ros1", "mcap", "db3"])
def test_phasespace_rigids(tmp_path, kind):
    def fill(bag):
        for i in range(4):
            bodies = [(1, 1000.0, 2.0, 3.0, 5.0), (2, 0.0, 0.0, 0.0, 5.0)]
            bag.rigids("/phasespace/rigids", START + i, bodies)
        bag.rigids("/phasespace/rigids", START + 9, [(1, 0.0, 0.0, 0.0, -1.0)])

    bag = make_bag(tmp_path, kind, fill)
    error = refuse(tmp_path, bag)
    assert "1, 2" in error.what
    assert "--rigid" in error.hint
    the_map = '[frame]\nunits = "mm"\nup = "y"\nbody_forward = "+x"\n'
    report, session = convert(tmp_path, bag, rigid=1, the_map=the_map)
    pose = session.columns(MocapPose)
    for name, value in {"x": 1.0, "y": -0.003, "height": 0.002}.items():
        assert pose[name] == pytest.approx([value] * 4)
    assert report.notes == ("1 frames without the rigid body were left out",)


def test_several_topics_must_be_chosen_and_the_choice_must_fit(tmp_path):
    def fill(bag):
        bag.pose("/a", START, 1.0, 0.0, 0.0)
        bag.pose("/b", START + 1, 2.0, 0.0, 0.0)
        bag.drive("/drive", START + 2, 0.1, 1.0)

    bag = make_bag(tmp_path, "mcap", fill)
    error = refuse(tmp_path, bag)
    assert "/a (PoseStamped), /b (PoseStamped)" in error.what
    assert (error.hint, error.code) == ("choose each with --topic TOPIC", ExitCode.USAGE)
    for topic, part in (
        ("/none", "no messages on /none"), ("pose=/drive", "cannot use"),
        ("body=/a", "none of pose"), ("=/a", "none of pose"),
    ):  # fmt: skip
        assert part in refuse(tmp_path, bag, topics=[topic]).what
    report, session = convert(tmp_path, bag, topics=["/b"])
    assert session.columns(MocapPose)["x"].tolist() == [2.0]
    assert report.counts["actuation"] == 1


def test_a_bag_of_other_things(tmp_path):
    def fill(bag):
        bag.add("/point", "geometry_msgs/msg/PointStamped", START, bag.of["Point"](0.0, 0.0, 0.0))

    error = refuse(tmp_path, make_bag(tmp_path, "mcap", fill))
    assert "/point (geometry_msgs/msg/PointStamped)" in error.hint
    assert error.hint.startswith("steerd reads PoseStamped, Odometry, "), "and what it would need"
    assert "no topic" in refuse(tmp_path, make_bag(tmp_path, "ros1", lambda bag: None)).what


def test_stamps_of_another_clock_are_not_used_and_poses_that_are_none_are_counted(tmp_path):
    def fill(bag):
        for i, x in enumerate((1.0, 2.0, math.nan, 4.0)):
            bag.pose("/a", START + i * 10**9, x, 0.0, 0.0, stamp_ns=77 * 10**9)

    report, session = convert(tmp_path, make_bag(tmp_path, "mcap", fill))
    assert session.columns(MocapPose)["t_valid_ns"].tolist() == [0, 10**9, 3 * 10**9]
    assert session.columns(MocapPose)["x"].tolist() == [1.0, 2.0, 4.0]
    first, second = report.notes
    assert "another clock" in first
    assert second == "1 pose messages hold no finite values and were left out"


@pytest.mark.parametrize("kind", ["ros1", "mcap"])
def test_damaged_bags_are_one_line(tmp_path, kind):
    path = make_bag(tmp_path, kind, drive)
    file = path if kind == "ros1" else next(path.glob("*.mcap"))
    data = file.read_bytes()
    rng = np.random.default_rng(5)
    refused = 0
    for percent in range(0, 100, 5):
        bad = bytearray(data[: len(data) * percent // 100] if percent % 10 else data)
        for _ in range(8):
            if bad:
                bad[int(rng.integers(len(bad)))] ^= 1 << int(rng.integers(8))
        file.write_bytes(bytes(bad))
        try:
            convert(tmp_path, path)
        except SteerdError as error:
            refused += "\n" not in str(error)
        else:
            refused += 1
            (tmp_path / "out.mcap").unlink()
        assert not list(tmp_path.glob("out*"))
    assert refused == 20


def test_what_is_no_bag(tmp_path):
    (tmp_path / "a.bag").write_text("hello")
    (tmp_path / "folder").mkdir()
    for name in ("a.bag", "folder", "none.bag", "none"):
        assert refuse(tmp_path, tmp_path / name).code == ExitCode.UNREADABLE


def test_without_rosbags_it_says_what_to_install(tmp_path, monkeypatch):
    assert importlib.util.find_spec("rosbags") is not None
    for name in [name for name in sys.modules if name.split(".")[0] == "rosbags"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "rosbags", None)
    (tmp_path / "a.bag").write_bytes(b"#ROSBAG V2.0")
    error = refuse(tmp_path, tmp_path / "a.bag")
    assert "rosbags" in error.what
    assert "pip install rosbags" in error.hint


# A map proposed from a log, what it would mean, and the conversation about it.
NS = 10**9
CIRCLE = 0.5  # rad/s on a circle of 2 m at 1 m/s


def circle(t):
    return 2.0 * np.sin(CIRCLE * t), 2.0 - 2.0 * np.cos(CIRCLE * t), CIRCLE * t


def write_csv(path):
    t = np.arange(0.0, 12.0, 0.02)
    x, y, yaw = circle(t)
    wrapped = np.degrees((yaw + np.pi) % (2 * np.pi) - np.pi)
    steer = np.degrees(-0.16 - 0.02 * np.sin(t))
    rows = np.column_stack([1e3 * t, 1e3 * x, 1e3 * y, wrapped, steer, np.ones_like(t)])
    text = "time_ms,pos_x,pos_y,heading_deg,steering,cmd_speed\n"
    path.write_text(text + "\n".join(",".join(f"{v:.4f}" for v in row) for row in rows))
    return path


def write_bag(path, gain=-7300.0):
    bag = Bag(path, "mcap")
    with bag.writer:
        for i in range(240):
            t_ns, t = START + i * NS // 20, i / 20
            x, y, yaw = circle(t)
            bag.pose("/vrpn_mocap/car/pose", t_ns, x, y, yaw)
            bag.pose("/pf/viz/inferred_pose", t_ns, x + 0.1, y, yaw)
            bag.drive("/ackermann_cmd", t_ns, 0.16, 1.0)
            bag.drive("/drive", t_ns, 0.3, 2.0)
            bag.vesc("/vesc/sensors/core", t_ns, speed=gain)
    return path


def talk(monkeypatch, *lines):
    monkeypatch.setattr("sys.stdin", io.StringIO("".join(f"{line}\n" for line in lines)))


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


def test_a_csv_s_map_is_guessed_and_explained_and_the_steering_turned(tmp_path, monkeypatch, cli):
    source = write_csv(tmp_path / "run.csv")
    talk(monkeypatch, "car = blue", "")
    assert "to the left, 0° to the right" in cli("import", "--ask", source).out
    columns = parse_map((tmp_path / "run.map.toml").read_text()).columns
    assert columns["t"] == ColumnSpec("time_ms", 0.001)
    assert columns["x"] == ColumnSpec("pos_x", 0.001)
    assert columns["yaw"].scale == -columns["steer_cmd"].scale == pytest.approx(np.pi / 180)
    assert columns["speed_cmd"] == ColumnSpec("cmd_speed")
    assert "wheel_speed" not in columns, "one column is one quantity"
    session = open_session(tmp_path / "run.mcap")
    assert session.info().metadata["steerd.session"]["car"] == "blue"
    assert np.nanmean(session.columns(Actuation)["steer"]) == pytest.approx(0.16, abs=0.01)


@pytest.mark.parametrize("lines", [(), ("q",), ("nonsense", "q"), ("t =", "")])
def test_without_a_yes_nothing_is_written(tmp_path, monkeypatch, lines):
    source = write_csv(tmp_path / "run.csv")
    talk(monkeypatch, *lines)
    assert run_cli(["import", "--ask", str(source)]) == ExitCode.USAGE
    assert sorted(path.name for path in tmp_path.iterdir()) == ["run.csv"]


def test_a_cars_topics_are_known_and_its_vescs_sign_and_scale_doubted_until_stated(tmp_path, cli):
    path = write_bag(tmp_path / "run")
    doubted = cli("import", path, "-o", tmp_path / "a.mcap")
    assert "-7300 ERPM per m/s" in doubted.err
    assert "pose is /vrpn_mocap/car/pose, not /pf/viz/inferred_pose" in doubted.err
    assert "command is /ackermann_cmd, not /drive" in doubted.err
    taken = open_session(tmp_path / "a.mcap")
    assert taken.columns(MocapPose)["x"][0] == pytest.approx(0.0, abs=1e-9)
    assert set(taken.columns(Actuation)["speed"]) == {1.0}
    assert len(taken.columns(VescTelemetry)["erpm"]) == 240
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
    path = write_bag(tmp_path / "run")
    talk(monkeypatch, "")
    said = cli("import", "--ask", path, "-o", tmp_path / "a.mcap").out
    assert "motor     -7300 ERPM per m/s, by the poses" in said
    assert parse_map((tmp_path / "a.map.toml").read_text()).vesc.erpm_gain == -7300.0


def test_what_a_bag_lacks_is_said(tmp_path, cli):
    def fill(bag):
        for i in range(30):
            bag.drive("/drive", START + i * NS // 20, 0.1, 1.0)

    printed = cli("import", make_bag(tmp_path, "mcap", fill), "-o", tmp_path / "a.mcap")
    assert "no pose: identify and diagnose need the car's track" in printed.err
    assert "no vesc: the wheels' speed is not known" in printed.err
    assert "next: steerd plot" in printed.out, "nothing to identify"
    whole = write_bag(tmp_path / "whole", gain=4614.0)
    printed = cli("import", whole, "-o", tmp_path / "b.mcap")
    assert "next: steerd identify" in printed.out
    assert "warning" not in printed.err


@pytest.mark.parametrize(("role", "topics", "best"), [
    ("command", ["/drive", "/ackermann_cmd", "/teleop"], ["/ackermann_cmd"]),
    ("command", ["/drive", "/teleop"], ["/drive"]),
    ("pose", ["/odom", "/vrpn_client_node/car/pose"], ["/vrpn_client_node/car/pose"]),
    ("pose", ["/mocap/a", "/mocap/b", "/odom"], ["/mocap/a", "/mocap/b"]),
    ("vesc", ["/other", "/sensors/core"], ["/sensors/core"]), ("pose", ["/a", "/b"], ["/a", "/b"]),
])  # fmt: skip
def test_names_decide_where_they_can(role, topics, best):
    assert find_best(dict.fromkeys(topics, BAG_ROLES[role].types[0]))[role] == best
