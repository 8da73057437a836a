"""The gates one by one, on poses made by hand."""

from collections.abc import Callable
from dataclasses import replace
from math import nan, pi, radians

import pytest

from steerd.mocap_link.gates import GateConfig, GateState, step_gates
from steerd.mocap_link.source import Pose

MS = 1_000_000
CONFIG = GateConfig()


def make_pose(x: float, yaw: float = 0.0, height: float = 0.1) -> Pose:
    """A level pose with y 0; `at` gives it number and time."""
    q = (1.0, 0.0, 0.0, 0.0)
    return Pose(
        "car", None, None, None, 0, (x, 0.0, height), q,
        x=x, y=0.0, yaw=yaw, height=height, tilt=0.0,
    )  # fmt: skip


def at(pose: Pose, frame: int | None, t_ns: int) -> Pose:
    return replace(pose, frame=frame, t_valid_ns=t_ns)


def run(
    place: Callable[[int], Pose],
    n: int,
    state: GateState | None = None,
    *,
    first: int = 0,
    config: GateConfig = CONFIG,
    stationary: bool = False,
    wheel_speed: float = 1.0,
) -> tuple[GateState, list[str | None]]:
    """Feed frames `first` .. `first + n - 1` at 100 Hz."""
    state, reasons = state or GateState(), []
    for i in range(first, first + n):
        state, reason = step_gates(
            config, state, at(place(i), i, i * 10 * MS), wheel_speed=wheel_speed,
            stationary=stationary,
        )  # fmt: skip
        reasons.append(reason)
    return state, reasons


def drive(i: int) -> Pose:
    """1 m/s along x."""
    return make_pose(0.5 + 0.01 * i)


def shifted(dx: float, dyaw: float = 0.0) -> Callable[[int], Pose]:
    return lambda i: make_pose(drive(i).x + dx, dyaw)


@pytest.mark.parametrize("speed", [0.2, 1.0, 3.0, 5.0])
@pytest.mark.parametrize("beyond", [0.001, 0.01, 0.05, 0.5, -0.15, -0.5])
@pytest.mark.parametrize("count", [1, 2, 3])
def test_a_few_false_poses_leave_the_true_ones_in(speed, beyond, count):
    """Wherever they lie: just beyond what the car can have driven, or far from it."""
    reach = (CONFIG.speed_max - speed) * 0.01 + CONFIG.jump_slack

    def place(i: int) -> Pose:
        false = 20 <= i < 20 + count
        aside = (reach + beyond if beyond > 0.0 else beyond) if false else 0.0
        return make_pose(0.5 + 0.01 * speed * i + aside)

    _, reasons = run(place, 60)
    assert reasons[20] == "jump"
    assert reasons[20 + count :] == [None] * (40 - count)


@pytest.mark.parametrize(
    ("aside", "reason"),
    [*(((dx, 0.0), "jump") for dx in (0.1, 0.3, 0.5, 1.5, 20.0)),
     *(((0.0, dyaw), "yaw_jump") for dyaw in (radians(30), pi / 2, pi))],
)  # fmt: skip
def test_a_swapped_or_flipped_body_stays_out_however_long(aside, reason):
    state, _ = run(drive, 20)
    state, reasons = run(shifted(*aside), 300, state, first=20)
    assert reasons[0] == reason
    assert set(reasons[14:]) <= {"relocated", reason}
    assert (state.last.x, state.last.yaw) == pytest.approx((drive(19).x, 0.0))


@pytest.mark.parametrize("bad", [1, 2, 5, 14])
def test_the_true_pose_returns_at_once_after_a_jump(bad):
    state, _ = run(drive, 20)
    state, _ = run(shifted(0.5), bad, state, first=20)
    _, reasons = run(drive, 10, state, first=20 + bad)
    assert reasons == [None] * 10


def test_a_gap_widens_the_gate_by_what_the_car_can_drive():
    state, _ = run(drive, 20)
    allowed = CONFIG.speed_max * 0.06 + CONFIG.jump_slack
    for dx, reason in ((allowed - 0.001, None), (allowed + 0.001, "jump")):
        pose = at(make_pose(drive(19).x + dx), 25, 250 * MS)
        assert step_gates(CONFIG, state, pose)[1] == reason


def test_a_stopped_car_is_taken_in_elsewhere_after_fifteen_poses():
    state, _ = run(drive, 20)
    _, reasons = run(shifted(2.0), 20, state, first=20, stationary=True)
    assert reasons == ["jump"] * 14 + [None] * 6


def test_places_that_disagree_are_never_taken_in():
    state, _ = run(drive, 20)
    _, reasons = run(
        lambda i: shifted(2.0 + i % 3)(i), 60, state, first=20, stationary=True, wheel_speed=0.0
    )
    assert None not in reasons


def test_heights_that_disagree_are_never_taken_in():
    state, _ = run(drive, 20)
    _, reasons = run(
        lambda i: make_pose(drive(i).x, height=0.2 + 0.05 * (i % 2)), 60, state, first=20,
        stationary=True,
    )  # fmt: skip
    assert reasons == ["height"] * 60


@pytest.mark.parametrize(("wheel_speed", "rejected"), [(1.0, 6), (-1.0, 6), (0.1, 0), (nan, 0)])
def test_frozen_needs_turning_wheels(wheel_speed, rejected):
    still = drive(0)
    _, reasons = run(lambda i: still, 10, wheel_speed=wheel_speed)
    assert reasons.count("frozen") == rejected
    assert reasons[:4] == [None] * 4


def test_frame_order():
    state, _ = run(drive, 5)
    for number, reason in ((4, "duplicate"), (2, "out_of_order"), (None, None), (7, None)):
        assert step_gates(CONFIG, state, at(drive(5), number, 50 * MS))[1] == reason


def test_a_pose_without_a_place_is_rejected():
    nowhere = replace(drive(1), x=nan, y=nan, yaw=nan, height=nan, tilt=nan)
    assert step_gates(CONFIG, GateState(), nowhere)[1] == "not_finite"


def test_mean_error_is_in_the_servers_unit():
    pose = replace(drive(0), position=(500.0, 1.0, 100.0), mean_error=0.5)
    assert step_gates(CONFIG, GateState(), pose, metres_per_unit=1e-3)[1] is None
    assert step_gates(CONFIG, GateState(), pose)[1] == "mean_error"
