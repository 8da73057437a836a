"""When a watchdog trips: the numbers of `docs/reference/safety-requirements.md#s4`, bounded."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import isfinite, radians

from steerd.controller.limits import Bound, LimitError, find_out_of_bounds

BOUNDS: Mapping[str, Bound] = {
    "mocap_warn": Bound(0.005, 0.15, "s"),
    "mocap_blind": Bound(0.05, 0.30, "m"),
    "mocap_shortest": Bound(0.02, 0.05, "s"),
    "mocap_longest": Bound(0.05, 0.15, "s"),
    "freeze_warn": Bound(1, 5, "frames"),
    "freeze_frames": Bound(2, 10, "frames"),
    "freeze_speed": Bound(0.05, 0.3, "m/s"),
    "invalid_frames": Bound(1, 10, "frames"),
    "quaternion_tolerance": Bound(1e-6, 0.05, ""),
    "jump_speed": Bound(1.0, 8.0, "m/s"),
    "jump_margin": Bound(0.005, 0.10, "m"),
    "yaw_step": Bound(radians(5), radians(45), "rad"),
    "jump_frames": Bound(1, 5, "frames"),
    "jump_window": Bound(0.5, 2.0, "s"),
    "nis_frames": Bound(2, 10, "frames"),
    "nis_share": Bound(0.1, 0.5, ""),
    "nis_window": Bound(0.1, 1.0, "s"),
    "mocap_rate": Bound(30, 500, "Hz"),
    "sigma_position": Bound(0.01, 0.20, "m"),
    "sigma_yaw": Bound(radians(1), radians(15), "rad"),
    "telemetry_warn": Bound(0.02, 0.1, "s"),
    "telemetry": Bound(0.03, 0.15, "s"),
    "cell_warn": Bound(3.2, 4.2, "V"),
    "cell": Bound(3.1, 4.2, "V"),
    "cell_hold": Bound(0.0, 1.0, "s"),
    "fet_warn": Bound(30, 90, "C"),
    "fet": Bound(30, 95, "C"),
    "motor_warn": Bound(30, 100, "C"),
    "motor": Bound(30, 110, "C"),
    "lateral_warn": Bound(0.02, 0.6, "m"),
    "lateral": Bound(0.05, 0.6, "m"),
    "lateral_hold": Bound(0.0, 0.3, "s"),
    "lateral_max": Bound(0.1, 1.0, "m"),
    "heading_warn": Bound(radians(5), radians(60), "rad"),
    "heading": Bound(radians(10), radians(60), "rad"),
    "fence_warn": Bound(0.0, 5.0, "m"),
    "fence_delay": Bound(0.1, 1.0, "s"),
    "fence_margin": Bound(0.1, 5.0, "m"),
    "overspeed_ratio": Bound(1.0, 1.3, ""),
    "overspeed_margin": Bound(0.0, 0.3, "m/s"),
    "overspeed_hold": Bound(0.0, 0.1, "s"),
    "mismatch_speed": Bound(0.1, 1.0, "m/s"),
    "mismatch_share": Bound(0.05, 0.5, ""),
    "mismatch_hold": Bound(0.0, 0.4, "s"),
    "blocked_current": Bound(0.1, 0.8, ""),
    "blocked_speed": Bound(0.02, 0.15, "m/s"),
    "blocked_hold": Bound(0.1, 2.0, "s"),
    "saturated": Bound(0.5, 1.0, ""),
    "saturated_warn": Bound(0.0, 2.0, "s"),
    "saturated_hold": Bound(0.1, 2.0, "s"),
    "brake_decel": Bound(1.5, 8.0, "m/s2"),
    "stop_share": Bound(0.3, 0.9, ""),
    "stop_lag": Bound(0.0, 0.3, "s"),
    "stop_window": Bound(0.1, 0.5, "s"),
    "stop_speed": Bound(0.05, 0.3, "m/s"),
    "lease_warn": Bound(0.05, 0.3, "s"),
    "lease": Bound(0.1, 0.3, "s"),
    "suspend_step": Bound(0.01, 0.05, "s"),
    "out_queue": Bound(64, 256, "B"),
    "out_ticks": Bound(1, 3, "ticks"),
    "late": Bound(0.005, 0.025, "s"),
    "late_run": Bound(1, 3, "ticks"),
    "late_share": Bound(0.0, 0.02, ""),
    "guardian": Bound(0.02, 0.05, "s"),
    "recorder_full": Bound(0.1, 1.0, "s"),
    "gateway_full": Bound(0.1, 1.0, "s"),
}


@dataclass(frozen=True, slots=True)
class Thresholds:
    """Every watchdog's numbers; cannot be made outside ``BOUNDS``.

    Units stand in ``BOUNDS``; ``fence`` is a polygon of (x, y) [m] in the world, empty for none.

    Raises:
        LimitError: one line for each number outside its bound, or for a fence that is no polygon.
    """

    mocap_warn: float = 0.030
    mocap_blind: float = 0.30
    mocap_shortest: float = 0.05
    mocap_longest: float = 0.15
    freeze_warn: int = 3
    freeze_frames: int = 5
    freeze_speed: float = 0.15
    invalid_frames: int = 5
    quaternion_tolerance: float = 0.02
    jump_speed: float = 6.0
    jump_margin: float = 0.05
    yaw_step: float = radians(30)
    jump_frames: int = 3
    jump_window: float = 1.0
    nis_frames: int = 5
    nis_share: float = 0.3
    nis_window: float = 0.5
    mocap_rate: float = 100.0
    sigma_position: float = 0.15
    sigma_yaw: float = radians(10)
    telemetry_warn: float = 0.050
    telemetry: float = 0.100
    cell_warn: float = 3.5
    cell: float = 3.3
    cell_hold: float = 0.5
    fet_warn: float = 75.0
    fet: float = 85.0
    motor_warn: float = 80.0
    motor: float = 95.0
    lateral_warn: float = 0.20
    lateral: float = 0.30
    lateral_hold: float = 0.1
    lateral_max: float = 0.60
    heading_warn: float = radians(30)
    heading: float = radians(45)
    fence: tuple[tuple[float, float], ...] = ()
    fence_warn: float = 0.5
    fence_delay: float = 0.1
    fence_margin: float = 0.1
    overspeed_ratio: float = 1.15
    overspeed_margin: float = 0.15
    overspeed_hold: float = 0.05
    mismatch_speed: float = 0.5
    mismatch_share: float = 0.3
    mismatch_hold: float = 0.2
    blocked_current: float = 0.5
    blocked_speed: float = 0.08
    blocked_hold: float = 1.0
    saturated: float = 0.98
    saturated_warn: float = 0.5
    saturated_hold: float = 1.0
    brake_decel: float = 3.5
    stop_share: float = 0.5
    stop_lag: float = 0.15
    stop_window: float = 0.3
    stop_speed: float = 0.15
    lease_warn: float = 0.15
    lease: float = 0.30
    suspend_step: float = 0.05
    out_queue: int = 256
    out_ticks: int = 3
    late: float = 0.025
    late_run: int = 3
    late_share: float = 0.02
    guardian: float = 0.05
    recorder_full: float = 1.0
    gateway_full: float = 1.0

    def __post_init__(self) -> None:
        """Refuse what the bounds do not allow."""
        values = {name: float(getattr(self, name)) for name in BOUNDS}
        problems = find_out_of_bounds(values, BOUNDS)
        corners = [value for corner in self.fence for value in corner]
        if self.fence and (len(self.fence) < 3 or not all(isfinite(value) for value in corners)):
            problems += ("fence needs at least three corners (x, y) in metres, all finite",)
        if problems:
            raise LimitError("\n".join(problems))
