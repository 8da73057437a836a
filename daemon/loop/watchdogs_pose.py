"""Watchdogs over single mocap frames and innovations (W2-W5), stepped once per frame.

They check the pose after unit and axis mapping, before the filter. ``mocap_link`` rejects outliers
for a good estimate; these watchdogs independently detect that mocap cannot be trusted.
"""

from enum import IntEnum
from math import hypot, isfinite, remainder, sqrt, tau
from operator import attrgetter

from steerd.daemon.settings.thresholds import Thresholds
from steerd.steer_bus.messages import MocapPose
from steerd.steer_bus.quick_values import changed, quick_value

JUMP_TIMES = 5  # number of jumps within ``jump_window`` that trip, in a row or not


class PoseVerdict(IntEnum):
    """What to do with a frame: only ACCEPTED and REBASED may bound the filter."""

    ACCEPTED = 0
    INVALID = 1
    FROZEN = 2
    JUMP = 3
    REBASED = 4
    """Accepted as a new start while nothing moves: the filter must start again from it."""


@quick_value
class PoseWatch:
    """Memory of the frame watchdogs; the counts are of frames in a row."""

    base: MocapPose | None = None  # the last good frame
    before: MocapPose | None = None  # the last good frame that arrived earlier than `base`
    frozen: int = 0
    invalid: int = 0
    jumps: int = 0
    jump_times: tuple[int, ...] = ()
    rejected: int = 0
    rejections: int = 0  # shift register: bit k set if the innovation was rejected k frames ago


def is_sane(th: Thresholds, pose: MocapPose) -> bool:
    """Whether a frame is a pose at all (W3): finite, unit quaternion, not exactly the origin."""
    w, x, y, z = pose.qw, pose.qx, pose.qy, pose.qz
    norm = sqrt(w * w + x * x + y * y + z * z)
    return (
        pose.tracking_valid != 0
        and bool(pose.x or pose.y or pose.height)
        and isfinite(pose.x + pose.y + pose.height + pose.yaw)
        and abs(norm - 1.0) <= th.quaternion_tolerance
    )


def _is_newer(base: MocapPose, pose: MocapPose) -> bool:
    if pose.frame < 0:
        # A stream keeps its order, but the poses of one TCP segment share its stamp.
        return pose.t_arrival_ns >= base.t_arrival_ns
    return pose.frame > base.frame and pose.t_arrival_ns > base.t_arrival_ns


def _is_jump(th: Thresholds, base: MocapPose, before: MocapPose | None, pose: MocapPose) -> bool:
    # Poses that arrived at one time have had the time since the arrival before, all together.
    at_once = pose.t_arrival_ns == base.t_arrival_ns
    start = before if before is not None and at_once else base
    step = hypot(pose.x - start.x, pose.y - start.y)
    bound = th.jump_speed * ((pose.t_arrival_ns - start.t_arrival_ns) / 1e9) + th.jump_margin
    return step > bound or abs(remainder(pose.yaw - base.yaw, tau)) > th.yaw_step


_place = attrgetter("x", "y", "height", "qw", "qx", "qy", "qz")
"""All that the last good pose must have in common with one that repeats it bit by bit."""


def _check_pose(th: Thresholds, w: PoseWatch, pose: MocapPose, wheel_speed: float) -> PoseVerdict:
    if not is_sane(th, pose):
        return PoseVerdict.INVALID
    base = w.base
    if base is None:
        return PoseVerdict.REBASED
    if not _is_newer(base, pose):
        return PoseVerdict.INVALID
    if abs(wheel_speed) > th.freeze_speed and _place(base) == _place(pose):
        return PoseVerdict.FROZEN
    return PoseVerdict.JUMP if _is_jump(th, base, w.before, pose) else PoseVerdict.ACCEPTED


def step_pose(
    th: Thresholds, w: PoseWatch, pose: MocapPose, wheel_speed: float, may_rebase: bool
) -> tuple[PoseWatch, PoseVerdict]:
    """Check one frame, placed; the new memory and the verdict.

    A car that stands by `wheel_speed` [m/s] may well repeat its pose bit by bit. `may_rebase`: the
    car is disarmed or latched, and stands. Frames that are sane but contradict the last good one
    (carried by hand, server restarted), or the filter (it was blind while the car drove), then
    become the new truth when enough of them arrive in a row. Never while the motor may turn.
    """
    verdict = _check_pose(th, w, pose, wheel_speed)
    astray = may_rebase and w.rejected >= th.nis_frames
    if verdict == PoseVerdict.ACCEPTED and not astray:
        before = (
            w.base if w.base is not None and pose.t_arrival_ns > w.base.t_arrival_ns else w.before
        )
        good = PoseWatch(pose, before, 0, 0, 0, w.jump_times, w.rejected, w.rejections)
        return good, verdict
    if verdict in (PoseVerdict.ACCEPTED, PoseVerdict.REBASED):
        return PoseWatch(pose), PoseVerdict.REBASED
    if verdict == PoseVerdict.FROZEN:
        return changed(w, frozen=w.frozen + 1), verdict
    if verdict == PoseVerdict.JUMP:
        times = (*w.jump_times[1 - JUMP_TIMES :], pose.t_arrival_ns)
        w = changed(w, jumps=w.jumps + 1, jump_times=times)
        stuck = w.jumps >= th.jump_frames
    else:
        w = changed(w, invalid=w.invalid + 1)
        stuck = w.invalid >= th.invalid_frames and is_sane(th, pose)
    if may_rebase and stuck:
        return PoseWatch(pose), PoseVerdict.REBASED
    return w, verdict


def step_innovation(th: Thresholds, w: PoseWatch, rejected: bool) -> PoseWatch:
    """Count whether the filter's innovation gate rejected an accepted frame (W5)."""
    frames = round(th.nis_window * th.mocap_rate)
    register = (w.rejections << 1 | rejected) & ((1 << frames) - 1)
    row = w.rejected + 1 if rejected else 0
    return PoseWatch(w.base, w.before, w.frozen, w.invalid, w.jumps, w.jump_times, row, register)


def is_flapping(th: Thresholds, w: PoseWatch, t_ns: int) -> bool:
    """Whether the pose has jumped ``JUMP_TIMES`` times within ``jump_window`` before now (W4)."""
    times = w.jump_times
    return len(times) == JUMP_TIMES and (t_ns - times[0]) / 1e9 <= th.jump_window


def rejected_share(th: Thresholds, w: PoseWatch) -> float:
    """Share of the frames of the last ``nis_window`` that the filter rejected (W5)."""
    return w.rejections.bit_count() / round(th.nis_window * th.mocap_rate)
