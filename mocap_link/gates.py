"""Outlier tests before the filter: a planar car makes them cheap.

`step_gates` is pure: a state and an observation in, a state and a verdict out. Gates run in the
order of their cost to a wrong pose; the innovation gate is the estimator's. Thresholds follow
`docs/reference/mocap.md`; each rejection has a reason from `REASONS`.
"""

# Why: docs/decisions/filter-and-controller.md#d18

from dataclasses import dataclass
from math import hypot, isfinite, isnan, nan, pi, radians

from steerd.mocap_link.frame import wrap_angle
from steerd.mocap_link.source import Pose
from steerd.steer_bus.quick_values import changed, quick_value

REASONS: dict[str, str] = {
    "not_live": "the server replays a recording (edit mode)",
    "duplicate": "the frame number of the frame before",
    "out_of_order": "an older frame number",
    "not_finite": "NaN or infinity in the pose",
    "zero_pose": "position exactly (0, 0, 0): how some servers say 'not seen'",
    "quaternion": "quaternion length off 1",
    "invalid": "the server says: not tracked",
    "mean_error": "marker residual too large",
    "units": "more than 100 m from the origin: millimetres?",
    "tilt": "the body leans as a car on a flat floor cannot",
    "height": "the body left its height above the floor",
    "jump": "further than the car can have driven",
    "yaw_jump": "turned further than the car can have turned",
    "relocated": "steadily somewhere else: body swapped or carried; stop the car to take it in",
    "frozen": "bit-identical poses while the wheels turn",
}


@dataclass(frozen=True, slots=True)
class GateConfig:
    """Thresholds."""

    quaternion_tolerance: float = 0.01  # allowed deviation of the quaternion's length from 1
    mean_error_max: float = 5e-3  # largest marker residual [m] (a real room shows 0.5 mm)
    position_max: float = 100.0  # largest distance from the mocap origin [m]
    tilt_max: float = radians(10.0)  # largest tilt [rad]
    height_band: float = 0.03  # allowed deviation from the first accepted pose's height [m]
    speed_max: float = 6.0  # fastest the car can drive, with margin [m/s]
    jump_slack: float = 0.02  # position allowance at zero time [m]
    yaw_rate_max: float = 8.0  # fastest the car can turn [rad/s]
    yaw_slack: float = radians(5.0)  # yaw allowance at zero time [rad]
    gap_max: float = 0.15  # longest gap [s] for which the allowances keep growing
    frozen_count: int = 5  # bit-identical poses in a row that count as frozen
    frozen_speed: float = 0.15  # wheel speed [m/s] above which a still pose cannot be
    reacquire_count: int = 15  # mutually consistent poses that make a new place credible


@quick_value
class GateState:
    """What the gates remember."""

    frame: int | None = None  # last frame number
    last: Pose | None = None  # last accepted pose; None until the first
    before: Pose | None = None  # the one accepted before it; None after a new place
    height: float | None = None  # reference height [m]
    pose: tuple[float, ...] = ()  # last raw position and quaternion, and how often it came in a row
    repeats: int = 0  # see `pose`
    candidate: Pose | None = None  # last pose of a run at another place
    candidate_run: int = 0  # its length


def check_raw(config: GateConfig, raw: Pose, metres_per_unit: float = 1.0) -> str | None:
    """Gates on the pose as sent: is it live, a number, a rotation, and believed by the server?"""
    if not raw.live:
        return "not_live"
    p, q = raw.position, raw.quaternion
    norm = hypot(*q)
    distance = hypot(*p)
    # hypot of finite f64s can itself overflow; both overflow and NaN end here
    if not (isfinite(norm) and isfinite(distance)):
        return "not_finite"
    if not raw.tracking_valid:
        return "invalid"
    if distance == 0.0:
        return "zero_pose"
    if abs(norm - 1.0) > config.quaternion_tolerance:
        return "quaternion"
    error = raw.mean_error
    if error is not None and not abs(error) * metres_per_unit <= config.mean_error_max:
        return "mean_error"
    if distance * metres_per_unit > config.position_max:
        return "units"
    return None


def step_gates(
    config: GateConfig,
    state: GateState,
    pose: Pose,
    *,
    wheel_speed: float = nan,
    stationary: bool = False,
    metres_per_unit: float = 1.0,
) -> tuple[GateState, str | None]:
    """Judge one pose, timed and placed; the memory after, and None or the reason for rejection.

    Args:
        config: thresholds.
        state: memory before.
        pose: one without a place is rejected.
        wheel_speed: speed [m/s] of the wheels, NaN if unknown (a frozen pose then passes).
        stationary: the car is stopped and disarmed, so a new place may be taken in.
        metres_per_unit: the vendor's length unit.
    """
    order = find_disorder(state, pose)
    if order is not None:
        return state, order
    key = (*pose.position, *pose.quaternion)
    repeats = state.repeats + 1 if key == state.pose else 1
    state = changed(state, frame=pose.frame, pose=key, repeats=repeats)
    reason = check_raw(config, pose, metres_per_unit)
    if reason is None and isnan(pose.x):
        reason = "not_finite"
    if reason is not None:
        return state, reason
    if pose.tilt > config.tilt_max:
        return state, "tilt"
    if abs(wheel_speed) > config.frozen_speed and repeats >= config.frozen_count:
        return state, "frozen"
    return _check_place(config, state, pose, stationary)


def find_disorder(state: GateState, pose: Pose) -> str | None:
    """Say whether the frame number does not rise: `duplicate`, `out_of_order` or None."""
    if pose.frame is None or state.frame is None or pose.frame > state.frame:
        return None
    return "duplicate" if pose.frame == state.frame else "out_of_order"


def _check_place(
    config: GateConfig, state: GateState, pose: Pose, stationary: bool
) -> tuple[GateState, str | None]:
    reason = _compare(config, state, pose)
    if reason is None:
        height = pose.height if state.height is None else state.height
        placed = changed(state, last=pose, before=state.last, height=height)
        return changed(placed, candidate=None, candidate_run=0), None
    run = state.candidate_run + 1 if _is_steady(config, state.candidate, pose) else 1
    if run >= config.reacquire_count:
        if stationary:
            place = changed(state, last=pose, before=None, height=pose.height)
            return changed(place, candidate=None, candidate_run=0), None
        reason = "relocated"
    return changed(state, candidate=pose, candidate_run=run), reason


def _compare(config: GateConfig, state: GateState, pose: Pose) -> str | None:
    if state.height is not None and abs(pose.height - state.height) > config.height_band:
        return "height"
    if state.last is None:
        return None
    reason = find_jump(config, state.last, pose)
    if reason is None and state.candidate is not None and _is_steady(config, state.candidate, pose):
        # The allowance grows while poses are rejected, and would in the end admit the very body
        # that was rejected first: what goes on where it began stays out.
        aside = _distance(_expected(config, state.before, state.last, pose.t_valid_ns), pose)
        began = _expected(config, state.before, state.last, state.candidate.t_valid_ns)
        if aside > 0.5 * _distance(began, state.candidate):
            return "jump"
    return reason


def _expected(config: GateConfig, before: Pose | None, last: Pose, t_ns: int) -> Pose:
    """Where the car is at `t_ns` if it went on as between its last two poses."""
    step_ns = 0 if before is None else last.t_valid_ns - before.t_valid_ns
    if before is None or not 0 < step_ns * 1e-9 <= config.gap_max:
        return changed(last, t_valid_ns=t_ns)
    share = (t_ns - last.t_valid_ns) / step_ns
    x = last.x + share * (last.x - before.x)
    y = last.y + share * (last.y - before.y)
    yaw = last.yaw + share * wrap_angle(last.yaw - before.yaw)
    return changed(last, t_valid_ns=t_ns, x=x, y=y, yaw=yaw)


def _distance(a: Pose, b: Pose) -> float:
    # a radian counts as a metre
    return hypot(b.x - a.x, b.y - a.y) + abs(wrap_angle(b.yaw - a.yaw))


def _is_steady(config: GateConfig, a: Pose | None, b: Pose) -> bool:
    if a is None or abs(a.height - b.height) > config.height_band:
        return False
    return find_jump(config, a, b) is None


def find_jump(config: GateConfig, a: Pose, b: Pose) -> str | None:
    """Say whether the car cannot have gone from `a` to `b`: `jump`, `yaw_jump` or None.

    |dp| <= v_max dt + slack and |dyaw| <= r_max dt + slack.
    """
    dt = min(max(0.0, (b.t_valid_ns - a.t_valid_ns) * 1e-9), config.gap_max)
    if hypot(b.x - a.x, b.y - a.y) > config.speed_max * dt + config.jump_slack:
        return "jump"
    turn = abs(wrap_angle(b.yaw - a.yaw))
    if turn > min(config.yaw_rate_max * dt + config.yaw_slack, pi):
        return "yaw_jump"
    return None
