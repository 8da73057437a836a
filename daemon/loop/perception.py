"""Perception: checks mocap frames, keeps telemetry, estimates the car's state."""

from collections import deque
from math import hypot, inf, isfinite, nan

from steerd.car_model.params import Car
from steerd.car_model.state import Command, State
from steerd.daemon.loop.following import LONG_TURN_S
from steerd.daemon.loop.watchdogs_pose import PoseVerdict, PoseWatch, step_innovation, step_pose
from steerd.daemon.settings.config import Settings
from steerd.estimator import state_filter as sf
from steerd.estimator.sensors import Measurement, make_gyro, make_pose, make_wheel_speed
from steerd.steer_bus import messages as m
from steerd.vesc_link.scaling import erpm_to_speed
from steerd.vesc_link.telemetry import has_chip

_TRACK_NS = round(1e9 * LONG_TURN_S)  # how long poses are kept
_SPEED_SPAN_S, _SPAN_OF_SD = 0.1, 20.0
"""Time over which mocap speed is taken, single steps at 100 Hz are mostly noise; and least time per
metre that a pose may be off, by which a noisy localiser's is longer, up to `LONG_TURN_S` [s/m]."""
BLIND_S = 0.5  # age after which a measured speed counts as unknown [s]
NO_TELEMETRY = m.VescTelemetry(m.make_header(0, m.BODY), 0, 0, -1, 0, 0, -1, -1, -1, *(nan,) * 10)
NO_STATE = State(*(nan,) * 7)  # before the first estimate
_SEEN = (PoseVerdict.ACCEPTED, PoseVerdict.REBASED)


class Perception:
    """Measurements and the state estimate that follows from them."""

    def __init__(self, car: Car[float], settings: Settings) -> None:
        self._filter = sf.make_state_filter(car, settings.filter, chassis=settings.file.chassis)
        self._state = sf.FilterState()
        self._thresholds, self._scaling = settings.thresholds, settings.scaling
        span_s = max(_SPEED_SPAN_S, _SPAN_OF_SD * settings.filter.pose_position_sd)
        self._speed_span_ns = round(1e9 * min(span_s, LONG_TURN_S))
        self._measurements: list[Measurement] = []
        self._commands: list[tuple[int, Command[float] | None]] = []
        self._refused = 0
        self._seen = 0
        self.watch = PoseWatch()
        self.track: deque[m.MocapPose] = deque()  # of the last `LONG_TURN_S`, and the one before
        self.values = NO_TELEMETRY  # the last reply with telemetry
        # By the wheels, from that reply, and by mocap alone over the last 100 to 200 ms [m/s];
        # NaN while unknown
        self.wheel_speed = self.mocap_speed = nan
        self.wheel: tuple[int, float] | None = None  # time of validity [ns] and speed
        self.accepted_ns: int | None = None  # arrival of the last good frame
        self.may_rebase = True  # set by the loop: the car is disarmed and stands

    def on_pose(self, pose: m.MocapPose) -> None:
        """Check a pose; an accepted one is fused at its time of validity."""
        self.watch, verdict = step_pose(
            self._thresholds, self.watch, pose, self.wheel_speed, self.may_rebase
        )
        if verdict is PoseVerdict.REBASED:
            self._state = sf.restart_filter(self._state)
            self.track.clear()
        if verdict in _SEEN and not pose.reject:
            self.accepted_ns = pose.t_arrival_ns
            self._measurements.append(make_pose(pose.t_valid_ns, pose.x, pose.y, pose.yaw))
            self.track.append(pose)
            # Now, not in the tick: the pose comes just before its deadline
            # (`steerd.daemon.process.pacing`).
            latest_ns = pose.t_arrival_ns
            for measurement in self._measurements:
                if measurement.t_ns > latest_ns:
                    latest_ns = measurement.t_ns
            self._fuse(latest_ns)

    def on_telemetry(self, telemetry: m.VescTelemetry) -> None:
        """Take motor telemetry; its wheel speed is valid in the middle of the exchange."""
        self.values = telemetry
        speed = self.wheel_speed = erpm_to_speed(self._scaling, telemetry.erpm)
        self.wheel = (telemetry.t_sent_ns + telemetry.t_received_ns) // 2, speed
        self._measurements.append(make_wheel_speed(*self.wheel))

    def on_imu(self, imu: m.VescImu) -> None:
        """Take the gyro's yaw rate, if there is a gyro."""
        if has_chip(imu.accel_x, imu.accel_y, imu.accel_z) and isfinite(imu.gyro_z):
            stamp_ns = (imu.t_sent_ns + imu.t_received_ns) // 2
            self._measurements.append(make_gyro(stamp_ns, imu.gyro_z))

    def on_command(self, t_ns: int, command: Command[float] | None) -> None:
        """Remember the command sent to the car; None when no speed is commanded."""
        self._commands.append((t_ns, command))

    def estimate(self, now_ns: int) -> sf.StateEstimate | None:
        """Fuse what arrived and predict to now; None before the first estimate."""
        self._fuse(now_ns)
        estimate = sf.predict_to(self._filter, self._state, now_ns)
        if estimate is not None:
            self._note_innovations(estimate)
        while len(self.track) > 2 and self.track[1].t_valid_ns <= now_ns - _TRACK_NS:
            self.track.popleft()
        self.mocap_speed = self._measure_mocap_speed(now_ns)
        return estimate

    def _fuse(self, now_ns: int) -> None:
        """Give the filter what came since the last call; the calls' number changes no estimate."""
        if self._measurements or self._commands:
            new, sent = self._measurements, self._commands
            self._state = sf.step(self._filter, self._state, now_ns, new, sent)
            self._measurements, self._commands = [], []

    def _note_innovations(self, estimate: sf.StateEstimate) -> None:
        pose = estimate.health.pose
        if pose.seen < self._seen or pose.refused < self._refused:
            self._seen = self._refused = 0
        refused, seen = pose.refused - self._refused, pose.seen - self._seen
        self._refused, self._seen = pose.refused, pose.seen
        for k in range(seen):
            self.watch = step_innovation(self._thresholds, self.watch, k >= seen - refused)

    def recent_wheel_speed(self, now_ns: int) -> float:
        """The same; NaN if the last reply is older than `BLIND_S`."""
        return self.wheel_speed if self.telemetry_age(now_ns) <= BLIND_S else nan

    def _measure_mocap_speed(self, now_ns: int) -> float:
        if len(self.track) < 2:
            return nan
        oldest_ns = now_ns - self._speed_span_ns
        first, last = self.track[0], self.track[-1]
        for pose in reversed(self.track):
            if pose.t_valid_ns <= oldest_ns:
                first = pose
                break
        span_ns = last.t_valid_ns - first.t_valid_ns
        return hypot(last.x - first.x, last.y - first.y) / (span_ns * 1e-9) if span_ns > 0 else nan

    def mocap_age(self, now_ns: int) -> float:
        """Seconds since a good frame arrived; infinite before the first."""
        return inf if self.accepted_ns is None else (now_ns - self.accepted_ns) * 1e-9

    def telemetry_age(self, now_ns: int) -> float:
        """Seconds since a reply; infinite before the first."""
        if self.values is NO_TELEMETRY:
            return inf
        return (now_ns - self.values.t_received_ns) * 1e-9


def best_speed(estimate: sf.StateEstimate | None, wheel_speed: float) -> float:
    """The speed for the supervisor [m/s]: the filter's while it is sound and has measurements.

    NaN if the last pose and the last wheel speed are older than `BLIND_S`: a filter that only
    predicts would report a moving car for ever.
    """
    if estimate is None or not estimate.health.sound:
        return wheel_speed  # which must be a recent one
    health = estimate.health
    fed = min(health.pose.age_s(estimate.t_ns), health.wheel_speed.age_s(estimate.t_ns)) <= BLIND_S
    return estimate.state.speed if fed else nan
