"""When a watchdog trips: the numbers of `docs/reference/safety-requirements.md#s4`, bounded.

Default, range and unit of a threshold stand in one place: its line in `Thresholds`.
"""

from dataclasses import dataclass
from math import isfinite, radians
from typing import Annotated

from steerd.controller.limits import Bound, LimitError, find_bounds, find_out_of_bounds

FENCE_CORNERS_MIN = 3


@dataclass(frozen=True, slots=True)
class Thresholds:
    """Every watchdog's numbers; cannot be made outside their ranges.

    ``fence`` is a polygon of (x, y) [m] in the world frame, empty for none.

    Raises:
        LimitError: one line for each number outside its range, or for a fence that is no polygon.
    """

    # W1 mocap stale: age that warns; trips after `mocap_blind` metres, within these two times.
    mocap_warn: Annotated[float, Bound(0.005, 0.15, "s")] = 0.030
    mocap_blind: Annotated[float, Bound(0.05, 0.30, "m")] = 0.30
    mocap_shortest: Annotated[float, Bound(0.02, 0.05, "s")] = 0.05
    mocap_longest: Annotated[float, Bound(0.05, 0.15, "s")] = 0.15
    # W2 mocap frozen: identical poses in a row, while the wheels are faster than `freeze_speed`.
    freeze_warn: Annotated[int, Bound(1, 5, "frames")] = 3
    freeze_frames: Annotated[int, Bound(2, 10, "frames")] = 5
    freeze_speed: Annotated[float, Bound(0.05, 0.3, "m/s")] = 0.15
    # W3 mocap invalid: bad poses in a row; deviation of the quaternion's norm from 1.
    invalid_frames: Annotated[int, Bound(1, 10, "frames")] = 5
    quaternion_tolerance: Annotated[float, Bound(1e-6, 0.05, "")] = 0.02
    # W4 mocap jump: a step beyond speed x time + margin; in a row, or scattered in a window.
    jump_speed: Annotated[float, Bound(1.0, 8.0, "m/s")] = 6.0
    jump_margin: Annotated[float, Bound(0.005, 0.10, "m")] = 0.05
    yaw_step: Annotated[float, Bound(radians(5), radians(45), "rad")] = radians(30)
    jump_frames: Annotated[int, Bound(1, 5, "frames")] = 3
    jump_window: Annotated[float, Bound(0.5, 2.0, "s")] = 1.0
    # W5 innovation: rejected poses in a row, or their share of a window at the mocap rate.
    nis_frames: Annotated[int, Bound(2, 10, "frames")] = 5
    nis_share: Annotated[float, Bound(0.1, 0.5, "")] = 0.3
    nis_window: Annotated[float, Bound(0.1, 1.0, "s")] = 0.5
    mocap_rate: Annotated[float, Bound(30, 500, "Hz")] = 100.0
    # W6 estimate diverged: standard deviations of the state estimate.
    sigma_position: Annotated[float, Bound(0.01, 0.20, "m")] = 0.15
    sigma_yaw: Annotated[float, Bound(radians(1), radians(15), "rad")] = radians(10)
    # W7 telemetry stale: age of the last reply.
    telemetry_warn: Annotated[float, Bound(0.02, 0.1, "s")] = 0.050
    telemetry: Annotated[float, Bound(0.03, 0.15, "s")] = 0.100
    # W13 battery: voltage of a cell.
    cell_warn: Annotated[float, Bound(3.2, 4.2, "V")] = 3.5
    cell: Annotated[float, Bound(3.1, 4.2, "V")] = 3.3
    cell_hold: Annotated[float, Bound(0.0, 1.0, "s")] = 0.5
    # W14 temperature: of transistors and motor.
    fet_warn: Annotated[float, Bound(30, 90, "C")] = 75.0
    fet: Annotated[float, Bound(30, 95, "C")] = 85.0
    motor_warn: Annotated[float, Bound(30, 100, "C")] = 80.0
    motor: Annotated[float, Bound(30, 110, "C")] = 95.0
    # W17 lateral error: trips after `lateral_hold`, beyond `lateral_max` at once.
    lateral_warn: Annotated[float, Bound(0.02, 0.6, "m")] = 0.20
    lateral: Annotated[float, Bound(0.05, 0.6, "m")] = 0.30
    lateral_hold: Annotated[float, Bound(0.0, 0.3, "s")] = 0.1
    lateral_max: Annotated[float, Bound(0.1, 1.0, "m")] = 0.60
    # W18 heading error.
    heading_warn: Annotated[float, Bound(radians(5), radians(60), "rad")] = radians(30)
    heading: Annotated[float, Bound(radians(10), radians(60), "rad")] = radians(45)
    # W19 fence: stopping distance = speed x delay + braking with `brake_decel` + margin.
    fence: tuple[tuple[float, float], ...] = ()
    fence_warn: Annotated[float, Bound(0.0, 5.0, "m")] = 0.5
    fence_delay: Annotated[float, Bound(0.1, 1.0, "s")] = 0.1
    fence_margin: Annotated[float, Bound(0.1, 5.0, "m")] = 0.1
    # W20 overspeed: beyond the limit by this factor and by this margin, the larger one.
    overspeed_ratio: Annotated[float, Bound(1.0, 1.3, "")] = 1.15
    overspeed_margin: Annotated[float, Bound(0.0, 0.3, "m/s")] = 0.15
    overspeed_hold: Annotated[float, Bound(0.0, 0.1, "s")] = 0.05
    # W21 speed mismatch: wheels against mocap, absolute and as a share of the larger one.
    mismatch_speed: Annotated[float, Bound(0.1, 1.0, "m/s")] = 0.5
    mismatch_share: Annotated[float, Bound(0.05, 0.5, "")] = 0.3
    mismatch_hold: Annotated[float, Bound(0.0, 0.4, "s")] = 0.2
    # W22 blocked: share of the current limit while the wheels are slower than this.
    blocked_current: Annotated[float, Bound(0.1, 0.8, "")] = 0.5
    blocked_speed: Annotated[float, Bound(0.02, 0.15, "m/s")] = 0.08
    blocked_hold: Annotated[float, Bound(0.1, 2.0, "s")] = 1.0
    # W23 steering saturated: share of the limit that counts as full lock; for so long.
    saturated: Annotated[float, Bound(0.5, 1.0, "")] = 0.98
    saturated_warn: Annotated[float, Bound(0.0, 2.0, "s")] = 0.5
    saturated_hold: Annotated[float, Bound(0.1, 2.0, "s")] = 1.0
    # W24 stop not effective: share of the expected deceleration that a window must show.
    brake_decel: Annotated[float, Bound(1.5, 8.0, "m/s2")] = 3.5
    stop_share: Annotated[float, Bound(0.3, 0.9, "")] = 0.5
    stop_lag: Annotated[float, Bound(0.0, 0.3, "s")] = 0.15
    stop_window: Annotated[float, Bound(0.1, 0.5, "s")] = 0.3
    stop_speed: Annotated[float, Bound(0.05, 0.3, "m/s")] = 0.15
    # W30 speed, W31 steering not followed: share that the car file's numbers may be off, noise in
    # standard deviations, play of the steering; time beyond the bounds, or the way if that is less.
    follow_share: Annotated[float, Bound(0.05, 0.3, "")] = 0.2
    follow_noise: Annotated[float, Bound(3.0, 8.0, "")] = 4.0
    follow_steer: Annotated[float, Bound(0.005, 0.08, "rad")] = 0.015
    follow_hold: Annotated[float, Bound(0.03, 0.1, "s")] = 0.1
    follow_distance: Annotated[float, Bound(0.05, 0.15, "m")] = 0.10
    # W25 lease or deadman: age of the operator's last message.
    lease_warn: Annotated[float, Bound(0.05, 0.3, "s")] = 0.15
    lease: Annotated[float, Bound(0.1, 0.3, "s")] = 0.30
    # W28 clock: time that the machine slept between two ticks.
    suspend_step: Annotated[float, Bound(0.01, 0.05, "s")] = 0.05
    # W8 serial write: bytes that wait in the port; ticks in a row with more than that.
    out_queue: Annotated[int, Bound(64, 256, "B")] = 256
    out_ticks: Annotated[int, Bound(1, 3, "ticks")] = 3
    # W15 loop late: one tick; missed ticks in a row; their share of a second.
    late: Annotated[float, Bound(0.005, 0.025, "s")] = 0.025
    late_run: Annotated[int, Bound(1, 3, "ticks")] = 3
    late_share: Annotated[float, Bound(0.0, 0.02, "")] = 0.02
    # W16 guardian: age of its last sign of life.
    guardian: Annotated[float, Bound(0.02, 0.05, "s")] = 0.05
    # W26 recorder, W27 gateway: time for which the pipe was full.
    recorder_full: Annotated[float, Bound(0.1, 1.0, "s")] = 1.0
    gateway_full: Annotated[float, Bound(0.1, 1.0, "s")] = 1.0

    def __post_init__(self) -> None:
        problems = find_out_of_bounds({name: getattr(self, name) for name in BOUNDS}, BOUNDS)
        corners = [value for corner in self.fence for value in corner]
        few = 0 < len(self.fence) < FENCE_CORNERS_MIN
        if few or not all(isfinite(value) for value in corners):
            problems += ("fence needs at least three corners (x, y) in metres, all finite",)
        if problems:
            raise LimitError("\n".join(problems))


BOUNDS = find_bounds(Thresholds)
LAUNCH_SPEED = 0.5  # until the launch checks have passed [m/s]
LAUNCH_DISTANCE = 0.5  # by the wheels, until they do [m]
SOFT_DECEL = 1.5  # slope of the speed cap while stopping [m/s^2]
LAUNCH_RATIO = 0.7, 1.4  # mocap's distance over the wheels' that the launch check lets pass
