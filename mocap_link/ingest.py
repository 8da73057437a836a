"""What a source learns of its poses: time, place, verdict of the gates; and its own state."""

from collections import deque
from dataclasses import dataclass, field, replace
from math import nan
from typing import Any

from steerd.mocap_link import source
from steerd.mocap_link.clock_sync import SourceTiming
from steerd.mocap_link.frame import FrameConfig, make_planar_pose
from steerd.mocap_link.gates import GateConfig, GateState, find_disorder, step_gates
from steerd.steer_bus.quick_values import changed

_RATE_WINDOW_NS = 1_000_000_000
_RESTART_RUN = 10


@dataclass(frozen=True, slots=True)
class IngestConfig:
    """Everything by which a source times, places and judges its poses."""

    frame: FrameConfig = field(default_factory=FrameConfig)
    gates: GateConfig = field(default_factory=GateConfig)


class PoseIngest:
    """State of one source's pipeline; no I/O and no clock of its own.

    Attributes:
        timing: the source's clock maps; replace it when the server's clock becomes known.
        wheel_speed: latest wheel speed [m/s], NaN while unknown, for the frozen-pose gate.
        stationary: the car is stopped and disarmed, so a new place may be taken in.
    """

    def __init__(self, config: IngestConfig, timing: SourceTiming) -> None:
        self.config = config
        self.timing = timing
        self.wheel_speed = nan
        self.stationary = False
        self._gates = GateState()
        self._monitor = source.MonitorState()
        self._period_ns = source.PERIOD_NS
        self._arrivals: deque[int] = deque()
        self._clock: source.ClockKind | None = None
        self._disorder_run = 0
        self._expected_hz: float | None = None
        self._metres_per_unit = 1e-3 if config.frame.units == "mm" else 1.0

    def expect_rate(self, rate_hz: float) -> None:
        """Take the server's own frame rate as the period of the stale rule."""
        if 1.0 <= rate_hz <= 2000.0:
            self._expected_hz = rate_hz
            self._period_ns = round(1e9 / rate_hz)

    def restart(self) -> None:
        """The server started anew: its frame numbers and its clock begin again.

        The last accepted pose stays, so a restart cannot carry the car away.
        """
        self.timing.reset()
        self._gates = replace(self._gates, frame=None)
        self._disorder_run = 0

    def push(self, sent: source.Pose) -> source.Pose:
        """Time, place and judge one pose."""
        learn = self._watch_order(sent)
        t_valid_ns, self._clock = self.timing.time_pose(sent, learn=learn)
        try:
            x, y, yaw, height, tilt = make_planar_pose(
                self.config.frame, sent.position, sent.quaternion
            )
        except (ValueError, OverflowError):
            x = y = yaw = height = tilt = nan
        pose = changed(
            sent, t_valid_ns=t_valid_ns, clock=self._clock, x=x, y=y, yaw=yaw, height=height,
            tilt=tilt,
        )  # fmt: skip
        self._gates, reason = step_gates(
            self.config.gates,
            self._gates,
            pose,
            wheel_speed=self.wheel_speed,
            stationary=self.stationary,
            metres_per_unit=self._metres_per_unit,
        )
        self._arrivals.append(pose.t_arrival_ns)
        self._drop_old(pose.t_arrival_ns)
        self._step(pose.t_arrival_ns, True, reason is None)
        return pose if reason is None else changed(pose, rejected=reason)

    def on_timer(self, t_ns: int, *, connected: bool) -> None:
        """Let time pass."""
        self._drop_old(t_ns)
        self._step(t_ns, connected, None)

    def note_absent(self, t_ns: int) -> None:
        """A frame came without the body in it."""
        self._step(t_ns, True, False)

    def status(self, **session: Any) -> source.SourceStatus:
        """Describe the source now; the session adds what only it knows of a `SourceStatus`."""
        return source.SourceStatus(
            self._monitor.state,
            clock=self._clock,
            clock_sigma_ns=self.timing.sigma_ns,
            rate_hz=len(self._arrivals) * 1e9 / _RATE_WINDOW_NS,
            expected_rate_hz=self._expected_hz,
            **session,
        )

    def _step(self, t_ns: int, connected: bool, good: bool | None) -> None:
        self._monitor = source.step_monitor(
            self._monitor,
            t_ns,
            connected=connected,
            clock_ready=self.timing.ready,
            good=good,
            period_ns=self._period_ns,
        )

    def _watch_order(self, pose: source.Pose) -> bool:
        """Whether the frame is newer than those before, in time for the clock maps."""
        disorder = find_disorder(self._gates, pose)
        # one late frame is the network, ten in a row are a server that counts from 1 again
        self._disorder_run = self._disorder_run + 1 if disorder == "out_of_order" else 0
        if self._disorder_run >= _RESTART_RUN:
            self.restart()
            return True
        return disorder is None

    def _drop_old(self, t_ns: int) -> None:
        while self._arrivals and t_ns - self._arrivals[0] >= _RATE_WINDOW_NS:
            self._arrivals.popleft()
