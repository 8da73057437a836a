"""Poses: axes, units and offsets; addresses; the source's states; the gates one by one."""

from dataclasses import replace
from math import cos, inf, nan, pi, radians, sin

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from steerd.mocap_link import frame
from steerd.mocap_link.gates import GateConfig, GateState, step_gates
from steerd.mocap_link.mocap_url import MocapUrl, parse_mocap_url
from steerd.mocap_link.source import MonitorState, Pose, SourceState, step_monitor

RELABEL = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])


def matrix(q):
    w, x, y, z = q
    return Rotation.from_quat((x, y, z, w)).as_matrix()


def test_y_up_is_a_relabelling_on_1000_random_rotations():
    rng = np.random.default_rng(11)
    for _ in range(1000):
        whole, p = rng.normal(size=4), rng.normal(size=3)
        q = tuple((whole / np.linalg.norm(whole)).tolist())
        np.testing.assert_allclose(frame.relabel_vector(tuple(p), "y"), RELABEL @ p)
        # world and body axes are renamed alike: R' = P R P^T
        renamed = RELABEL @ matrix(q) @ RELABEL.T
        relabelled = matrix(frame.relabel_quaternion(q, "y"))
        np.testing.assert_allclose(relabelled, renamed, atol=1e-12)
        np.testing.assert_allclose(frame.rotate(q, tuple(p)), matrix(q) @ p, atol=1e-12)
        pose = frame.make_planar_pose(frame.FrameConfig(up="y"), tuple(p), q)
        assert abs(frame.wrap_angle(pose.yaw - np.arctan2(renamed[1, 0], renamed[0, 0]))) < 1e-9
        assert pose.tilt == pytest.approx(np.arccos(renamed[2, 2]), abs=1e-6)
        assert pose.height == pytest.approx(p[1])


@pytest.mark.parametrize(("config", "q", "yaw"), [
    ({"up": "y", "body_forward": "+x"}, (cos(0.35), 0.0, sin(0.35), 0.0), 0.70),
    ({"up": "y", "body_forward": "+z"}, (cos(0.35), 0.0, sin(0.35), 0.0), 0.70 - pi / 2),
    ({"mount_yaw": radians(3.0)}, (cos(0.5), 0.0, 0.0, sin(0.5)), 1.0 - radians(3.0)),
    ({}, (cos(0.5), 0.0, 0.0, sin(0.5)), 1.0), ({}, (-cos(0.5), 0.0, 0.0, -sin(0.5)), 1.0),
], ids=["forward along x", "forward along z", "mounted askew", "q", "-q is the same"])  # fmt: skip
def test_yaw_by_axis_mount_and_sign(config, q, yaw):
    pose = frame.make_planar_pose(frame.FrameConfig(**config), (1.0, 2.0, 3.0), q)
    assert pose.yaw == pytest.approx(yaw)


def test_offsets_by_hand_and_angles_wrap_into_the_half_open_turn():
    assert (frame.wrap_angle(-pi), frame.wrap_angle(pi)) == (pi, pi)
    assert frame.wrap_angle(3 * pi + 0.1) == pytest.approx(-pi + 0.1)
    config = frame.FrameConfig(marker_rear_x=0.21, marker_rear_y=-0.015, cog_ahead_of_rear=0.17)
    q = (cos(pi / 4), 0.0, 0.0, sin(pi / 4))
    pose = frame.make_planar_pose(config, (1.0, 2.0, 0.1), q)
    assert (pose.x, pose.y) == pytest.approx((1.0 - 0.015, 2.0 - 0.04))


@pytest.mark.parametrize("up", ["y", "z"])
@pytest.mark.parametrize("units", ["m", "mm"])
def test_body_pose_and_back(up, units):
    rng = np.random.default_rng(12)
    axes = {"y": ["+x", "-x", "+z", "-z"], "z": ["+x", "-x", "+y", "-y"]}[up]
    for _ in range(200):
        r = rng.uniform(-1, 1, 6)
        config = frame.FrameConfig(
            units, up, str(rng.choice(axes)), pi * r[0], (r[1], r[2]), 0.2 * r[3], r[4], r[5], 0.17
        )
        x, y, yaw, height = (float(v) for v in rng.uniform(-3, 3, 4))
        position, q = frame.make_body_pose(config, x, y, yaw, height)
        pose = frame.make_planar_pose(config, position, q)
        assert pose[:4] == pytest.approx((x, y, yaw, height))
        assert pose.tilt == pytest.approx(0.0, abs=1e-7)


@pytest.mark.parametrize(
    "bad", [{"units": "cm"}, {"up": "x"}, {"body_forward": "x"}, {"body_forward": "+y", "up": "y"}]
)
def test_meaningless_configurations_are_refused(bad):
    with pytest.raises(ValueError, match=r"mocap|body_forward"):
        frame.FrameConfig(**bad)  # type: ignore[arg-type]


# Addresses and the source state machine.
MS = 1_000_000

GOOD = {
    "natnet://10.0.0.5/car": MocapUrl("natnet", "10.0.0.5", 1510, "car"),
    "natnet://h:99/id:42?up=y&unicast=1&interface=1.2.3.4": MocapUrl(
        "natnet", "h", 99, "id:42", up="y", unicast=True, interface="1.2.3.4"
    ),
    "natnet://h/My%20Car?unicast=0": MocapUrl("natnet", "h", 1510, "My Car", unicast=False),
    "vrpn://tracker.lab/car?up=z": MocapUrl("vrpn", "tracker.lab", 3883, "car", up="z"),
    "zenoh:lab/pose/car": MocapUrl("zenoh", key="lab/pose/car"),
    "ros2:///pf/pose/odom": MocapUrl("ros2", key="pf/pose/odom", up="z"),
}
BAD = {
    "": "expected natnet", "car": "expected natnet", "tcp://h/car": "expected natnet",
    "natnet:h/car": "expected natnet", "natnet:///car": "no host", "natnet://h": "no body",
    "natnet://h:port/car": "port must be", "natnet://h:99999/car": "port must be",
    "natnet://h/id:x": "not an id", "vrpn://h/id:4": "only NatNet",
    "vrpn://h/car?unicast=1": "unknown option", "natnet://h/car?up=x": "up must be y or z",
    "natnet://h/car?interface=": "no value",
    "natnet://h/car?speed=3": "known: interface, unicast, up", "zenoh:": "zenoh key",
    "zenoh:/a": "zenoh key",
    **dict.fromkeys(
        ("ros2:/pf", "ros2://host/pf", "ros2:///", "ros2:///a//b", "ros2:///a/*", "ros2:///a/"),
        "ros2:///pf/pose/odom",
    ),
}  # fmt: skip


@pytest.mark.parametrize("text", GOOD)
def test_addresses(text):
    assert parse_mocap_url(text) == GOOD[text]


@pytest.mark.parametrize("text", BAD)
def test_bad_addresses_say_what_is_wrong(text):
    with pytest.raises(ValueError, match=BAD[text]):
        parse_mocap_url(text)


def feed(s: MonitorState, t_ms: float, good: bool | None = None) -> MonitorState:
    return step_monitor(s, round(t_ms * MS), connected=True, clock_ready=True, good=good)


def test_start_up():
    s = step_monitor(MonitorState(), 0, connected=False, clock_ready=False)
    assert s.state is SourceState.CONNECTING
    s = step_monitor(s, 0, connected=True, clock_ready=False)
    assert s.state is SourceState.SYNCING
    for i in range(30):
        s = step_monitor(s, i * 10 * MS, connected=True, clock_ready=False, good=True)
    assert s.state is SourceState.SYNCING  # plenty of frames, no clock
    assert feed(s, 300, True).state is SourceState.OK
    s = step_monitor(replace(s, good_run=0), 0, connected=False, clock_ready=False)
    assert s.state is SourceState.CONNECTING


@pytest.mark.parametrize(("frames", "state"), [
    ("G" * 9, "syncing"), ("G" * 10, "ok"), ("G" * 9 + "B" + "G" * 9, "syncing"),
    ("G" * 9 + "B" + "G" * 10, "ok"), ("G" * 10 + "B" * 20, "lost"),
    ("G" * 10 + "." * 41 + "G" * 9, "lost"), ("G" * 10 + "." * 41 + "G" * 10, "ok"),
])  # fmt: skip
def test_ten_good_frames_in_a_row_are_life_and_bad_ones_are_none(frames, state):
    """Good, bad and missing frames every 10 ms."""
    s = MonitorState()
    for i, each in enumerate(frames):
        s = feed(s, 10 * i, {"G": True, "B": False, ".": None}[each])
    assert s.state == state


def test_timing_of_stale_and_lost_is_exact():
    s = MonitorState()
    for i in range(10):
        s = feed(s, 10 * i, True)
    assert s.state is SourceState.OK
    for ms, state in {120: "ok", 120.001: "stale", 240: "stale", 240.001: "lost"}.items():
        assert feed(s, ms).state == state  # the last good frame was at 90 ms
    assert feed(feed(s, 130), 131, True).state is SourceState.OK


# The gates one by one, on poses made by hand.
GATES = GateConfig()


def make_pose(x: float, yaw: float = 0.0, height: float = 0.1) -> Pose:
    """A level pose with y 0; `at` gives it number and time."""
    seen = {"x": x, "y": 0.0, "yaw": yaw, "height": height, "tilt": 0.0}
    return Pose("car", None, None, None, 0, (x, 0.0, height), (1.0, 0.0, 0.0, 0.0), **seen)


def at(pose: Pose, frame: int | None, t_ns: int) -> Pose:
    return replace(pose, frame=frame, t_valid_ns=t_ns)


def run(place, n, state=None, *, first=0, **car):
    """Feed frames `first` .. `first + n - 1` at 100 Hz to a car that drives, or as given."""
    state, reasons, car = state or GateState(), [], {"wheel_speed": 1.0, **car}
    for i in range(first, first + n):
        state, reason = step_gates(GATES, state, at(place(i), i, i * 10 * MS), **car)
        reasons.append(reason)
    return state, reasons


def drive(i: int) -> Pose:
    return make_pose(0.5 + 0.01 * i)


def shifted(dx: float, dyaw: float = 0.0):
    return lambda i: make_pose(drive(i).x + dx, dyaw)


@pytest.mark.parametrize("speed", [0.2, 1.0, 3.0, 5.0])
@pytest.mark.parametrize("beyond", [0.001, 0.01, 0.05, 0.5, -0.15, -0.5])
@pytest.mark.parametrize("count", [1, 2, 3, 14])
def test_a_few_false_poses_leave_the_true_ones_in(speed, beyond, count):
    """Wherever they lie: just beyond what the car can have driven, or far from it."""
    reach = (GATES.speed_max - speed) * 0.01 + GATES.jump_slack

    def place(i: int) -> Pose:
        false = 20 <= i < 20 + count
        aside = (reach + beyond if beyond > 0.0 else beyond) if false else 0.0
        return make_pose(0.5 + 0.01 * speed * i + aside)

    _, reasons = run(place, 60)
    assert (reasons[20], reasons[20 + count :]) == ("jump", [None] * (40 - count))


@pytest.mark.parametrize(("aside", "reason"), [
    *(((dx, 0.0), "jump") for dx in (0.1, 0.3, 0.5, 1.5, 20.0)),
    *(((0.0, dyaw), "yaw_jump") for dyaw in (radians(30), pi / 2, pi)),
])  # fmt: skip
def test_a_swapped_or_flipped_body_stays_out_however_long(aside, reason):
    state, _ = run(drive, 20)
    state, reasons = run(shifted(*aside), 300, state, first=20)
    assert reasons[0] == reason
    assert set(reasons[14:]) <= {"relocated", reason}
    assert (state.last.x, state.last.yaw) == pytest.approx((drive(19).x, 0.0))


@pytest.mark.parametrize(("place", "reasons"), [
    (shifted(2.0), ["jump"] * 14 + [None] * 6),
    (lambda i: shifted(2.0 + i % 3)(i), ["jump"] * 20),
    (lambda i: make_pose(drive(i).x, height=0.2 + 0.05 * (i % 2)), ["height"] * 20),
    (lambda i: make_pose(drive(i).x, height=0.2), ["height"] * 14 + [None] * 6),
], ids=["elsewhere", "places that disagree", "heights that disagree",
        "another height"])  # fmt: skip
def test_a_stopped_car_is_taken_in_where_fifteen_poses_agree(place, reasons):
    state, _ = run(drive, 20)
    assert run(place, 20, state, first=20, stationary=True)[1] == reasons


@pytest.mark.parametrize(("wheel_speed", "rejected"), [(1.0, 6), (-1.0, 6), (0.1, 0), (nan, 0)])
def test_frozen_needs_turning_wheels(wheel_speed, rejected):
    still = drive(0)
    _, reasons = run(lambda i: still, 10, wheel_speed=wheel_speed)
    assert (reasons.count("frozen"), reasons[:4]) == (rejected, [None] * 4)


def test_frame_order_and_the_unit_of_the_mean_error():
    state, _ = run(drive, 5)
    for number, reason in ((4, "duplicate"), (2, "out_of_order"), (None, None), (7, None)):
        assert step_gates(GATES, state, at(drive(5), number, 50 * MS))[1] == reason
    pose = replace(drive(0), position=(500.0, 1.0, 100.0), mean_error=0.5)
    assert step_gates(GATES, GateState(), pose, metres_per_unit=1e-3)[1] is None
    assert step_gates(GATES, GateState(), pose)[1] == "mean_error"


NOT_FINITE = {"x": nan, "y": nan, "yaw": nan, "height": nan, "tilt": nan}


@pytest.mark.parametrize(("wrong", "reason"), [
    ({"live": False}, "not_live"), (NOT_FINITE, "not_finite"),
    ({"position": (nan,) * 3}, "not_finite"), ({"position": (inf,) * 3}, "not_finite"),
    ({"quaternion": (nan,) * 4}, "not_finite"),
    ({"tracking_valid": False}, "invalid"), ({"position": (0.0,) * 3}, "zero_pose"),
    ({"quaternion": (0.0,) * 4}, "quaternion"), ({"mean_error": 0.006}, "mean_error"),
    ({"mean_error": nan}, "mean_error"), ({"position": (101.0, 0.0, 0.0)}, "units"),
    ({"tilt": 0.2}, "tilt"), ({"height": 0.14}, "height"),
])  # fmt: skip
def test_a_pose_that_is_none_is_rejected_with_its_reason(wrong, reason):
    state, _ = run(drive, 1)
    pose = at(drive(1), 1, 10 * MS)
    assert step_gates(GATES, state, pose)[1] is None
    assert step_gates(GATES, state, replace(pose, **wrong))[1] == reason
