"""Drives as arrays: commands on a uniform grid, measurements at their own times.

`read_run` reads a session, `make_run` takes arrays; both refuse unusable data (`data_checks`), with
a typed error that says what is wrong and what to do.
"""

# Why: docs/decisions/identification.md#d45

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import ceil
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from steerd.steer_bus.messages import ActuationMode
from steerd.steer_bus.session_read import Session
from steerd.steer_bus.topic_columns import Columns
from steerd.steer_bus.topics import ACTUATION, IMU, MOCAP, VESC, WHEEL, Topic, find_topic
from steerd.sysid.data.data_checks import Array, DataError, check_run, check_times, noise_of
from steerd.vesc_link.scaling import F1TENTH

GRID = 0.005
"""Step of the command grid [s], a tick of the control loop; `stable_substeps` refines it. Twice as
long is enough for smooth drives (RK4 is good to 1e-3 mm), but blurs dead times by 0.2 ms."""
SERVO_FRAME = 0.02  # period of a VESC's servo signal [s]; steerd drives servos through nothing else
RAMP_ERPM = 25_000.0
"""A VESC's own limit of its speed setpoint's slope [ERPM/s] (`s_pid_ramp_erpms_s`, since 5.03)."""
POSE_SPEED_NOISE_MAX = 0.02
"""Poses whose speed is less noisy than this measure it better than a wheel that slips [m/s]."""
HISTORY = 0.5  # known commands that the actuators are simulated over before a window [s]
PAUSE, PAUSE_STEPS = 0.3, 5.0
"""Poses that stay away so long [s], and so many times longer than they usually do, are a pause of
the log: no window reaches across one, where everything would hang on the start."""
HALF_SPAN = 2  # samples to either side over which rates of a pose are differences, at least ...
SPEED_BLUR = 0.15  # ... and more where the poses' noise would blur a speed by more than this [m/s]


class LogJitter(NamedTuple):
    """Sampling jitter of a steering log: it is late by `period (phase + drift t) mod period`."""

    run: str  # the drive's name
    period: float  # of the log [s]
    phase: float  # at the drive's first command, in periods
    drift: float  # how fast the phase moves [periods/s]

    def delay(self, t: Array) -> Array:
        """How late commands logged at `t` were stored [s]."""
        return np.asarray(self.period * np.mod(self.phase + self.drift * t, 1.0))

    def describe(self) -> str:
        """What was found, and what was done about it."""
        late, drift = 1e3 * self.period, 1e3 * abs(self.drift) * self.period
        apart = f"(two timers drift apart by {drift:.1f} ms/s), corrected"
        return f"{self.run}: steering stored 0 to {late:.0f} ms late {apart}"


class Pulse(NamedTuple):
    """How a drive's servo was pulsed."""

    run: str  # the drive's name
    phase: float  # of the pulses after the drive's first command [s]
    sure: float  # by how much the log-likelihood falls at the best phase that does not look alike
    # By how much it may be off: phases between the same two commands look alike, but for a dead
    # time (standard deviation) [s]
    blur: float = 0.0


class Ramp(NamedTuple):
    """Whether a drive's motor controller had its ramp."""

    run: str  # the drive's name
    rate: float  # limit of its setpoint [m/s^2]; 0 where the drive knows none
    sure: float  # by how much the other answer's log-likelihood is smaller


class Signal(NamedTuple):
    """A measurement or command: `values[i]` at `t[i]` [s]."""

    t: Array
    values: Array


NOTHING = Signal(np.empty(0), np.empty(0))


@dataclass(frozen=True, eq=False)
class Run:
    """One drive, or a segment of one. Times in seconds from its own first command."""

    name: str  # for messages and reports
    h: float  # step of the command grid [s]
    commands: Array  # (N, 2) steer [rad] and speed [m/s], means over the grid's steps
    pose: Signal  # times and (M, 3) x [m], y [m], yaw [rad, unwrapped]; gaps are allowed
    # `command`; or `wheel` or `pose` where there is no speed command and the measured speed is
    # prescribed instead (see `augmented_car.prescribe_speed`)
    speed_source: str = "command"
    wheel: Signal = NOTHING  # speed as reported with the nominal gain [m/s]; may be empty
    yaw_rate: Signal = NOTHING  # gyro [rad/s]; may be empty
    steer: Signal = NOTHING  # the commanded angles at their own times; may be empty
    servo_frame: float = 0.0  # period of the pulses that carry them [s]; 0: none (`command_timing`)
    speed_command: Signal = NOTHING  # the commanded speeds at their own times; may be empty
    speed_ramp: float = 0.0  # limit of the slope of what follows them [m/s^2]; 0: none is known
    start: float = 0.0  # where in its drive it begins [s]; drifts count from the drive's start
    # How much of the commands before a window is simulated [s]: a linkage with play keeps the
    # side of the last turn
    history: float = HISTORY
    log_jitter: LogJitter | None = None  # of the steering log; `commands` and `steer` are corrected
    pulse: Pulse | None = None  # of the servo, where `commands` are those that it took over
    ramp: Ramp | None = None  # of the motor controller, where it was asked whether it has one

    def __repr__(self) -> str:
        return f"<Run {self.name!r}, {len(self.commands)} commands of {self.h:g} s>"

    @property
    def edges(self) -> Array:
        """Times at which the command grid's steps begin and end [s]."""
        return np.arange(len(self.commands) + 1).astype(float) * self.h

    @property
    def duration(self) -> float:
        """Length of the commands [s]."""
        return len(self.commands) * self.h

    @property
    def driven(self) -> float:
        """The same without commands further back than every window is given [s]."""
        return self.duration - max(0.0, float(self.pose.t[0]) - HISTORY)


def check_sources(runs: Sequence[Run]) -> None:
    """Refuse drives of which some have speed commands and others a measured speed in their place.

    One car cannot follow the first with its speed loop and the second at once.

    Raises:
        DataError: there are both.
    """
    asked = [run.name for run in runs if run.speed_source == "command"]
    measured = [run.name for run in runs if run.speed_source != "command"]
    if asked and measured:
        what = f"{measured[0]} has no speed commands, {asked[0]} has"
        raise DataError(what, "name them apart, or take the measured speed of all: --speed wheel")


def hold_means(signal: Signal, edges: Array) -> Array:
    """Mean of a zero-order-hold signal over each interval between edges (exact).

    Before its first time the first value holds.
    """
    t, values = signal
    area = np.concatenate([[0.0], np.cumsum(values[:-1] * np.diff(t))])
    last = max(edges[-1], t[-1]) + 1.0
    t_all = np.concatenate([[min(edges[0], t[0]) - 1.0], t, [last]])
    before = -values[0] * (t[0] - t_all[0])
    area_all = np.concatenate([[before], area, [area[-1] + values[-1] * (last - t[-1])]])
    return np.asarray(np.diff(np.interp(edges, t_all, area_all)) / np.diff(edges))


def least_pause(t: Array) -> float:
    """How long poses at these times must stay away to be a pause of the log [s]."""
    return max(PAUSE, PAUSE_STEPS * float(np.median(np.diff(t)))) if len(t) > 1 else np.inf


def leave_out(pose: Signal, holes: Array) -> Signal:
    """Poses without those within holes of the recording: a pause of the log, at which it is cut."""
    kept = np.ones(len(pose.t), bool)
    for first, last in holes:
        wider = 0.505 * max(0.0, least_pause(pose.t) - (last - first))
        kept &= (pose.t < first - wider) | (pose.t > last + wider)
    return Signal(pose.t[kept], pose.values[kept])


class Rates(NamedTuple):
    """Forward speed [m/s] and yaw rate [rad/s] at times [s]."""

    t: Array
    speed: Array
    yaw_rate: Array


def pose_slopes(pose: Signal, span: float) -> Signal:
    """Slopes (n, 3) of poses over five samples, or over a longer span [s]; none at the ends."""
    t, p = pose
    most = (len(t) - 1) // 2
    step = float(np.median(np.diff(t))) if len(t) > 1 else 0.0
    if most < 1 or step <= 0.0:
        return Signal(t, np.zeros_like(p))
    half = min(max(HALF_SPAN, ceil(0.5 * span / step)), most)
    times = t[2 * half :] - t[: -2 * half]
    return Signal(t[half:-half], (p[2 * half :] - p[: -2 * half]) / times[:, None])


def pose_rates(pose: Signal) -> Rates:
    """Rates of poses, over as long as their noise asks for."""
    noise = max(noise_of(pose.t, pose.values[:, axis]) for axis in (0, 1))
    t, slope = pose_slopes(pose, 2.0**0.5 * noise / SPEED_BLUR)
    half = (len(pose.t) - len(t)) // 2
    yaw = pose.values[half : half + len(t), 2]
    speed = slope[:, 0] * np.cos(yaw) + slope[:, 1] * np.sin(yaw)
    return Rates(t, speed, slope[:, 2])


def _clean(signal: Signal | None) -> Signal:
    if signal is None or not len(signal.t):
        return NOTHING
    kept = np.isfinite(signal.values)
    return Signal(np.asarray(signal.t, float)[kept], np.asarray(signal.values, float)[kept])


def _forward_only(pose: Signal) -> Signal:
    """Poses without those that go back by less than a sample's time.

    A clock of another computer is estimated, and the estimate moves when a stalled machine takes up
    what had waited. Where time goes back further, the clock was set.
    """
    back = np.maximum.accumulate(pose.t) - pose.t if len(pose.t) else pose.t
    step = float(np.median(np.diff(pose.t))) if len(pose.t) > 1 else 0.0
    kept = ~((back > 0.0) & (back < step))
    return Signal(pose.t[kept], pose.values[kept])


def make_run(
    name: str,
    steer: Signal,
    speed: Signal | None,
    pose: Signal,
    *,
    wheel: Signal | None = None,
    yaw_rate: Signal | None = None,
    h: float = GRID,
) -> Run:
    """Put a drive's signals, those of `Run`, on one clock and a grid of step `h` [s]; check them.

    Each command holds until the next. Without commanded speeds a measured one is prescribed, that
    of the poses if they are precise enough, else the wheel's. Yaw may wrap.

    Raises:
        DataError: no fit should see these data.
    """
    steer, commanded, rolled, gyro = map(_clean, (steer, speed, wheel, yaw_rate))
    pose = _forward_only(pose)
    named = {"steer": steer, "speed": commanded, "wheel": rolled, "yaw rate": gyro}
    for what, signal in {**named, "pose": pose}.items():
        check_times(name, what, signal.t)
    if not len(steer.t) or not len(pose.t):
        missing = "poses" if len(steer.t) else "steering commands"
        raise DataError(f"{name}: no {missing}", "record mocap and actuation of a drive")
    if not np.isfinite(pose.values).all():
        raise DataError(f"{name}: a pose is not a number", "leave out lost samples, keep the gaps")
    zero, end = steer.t[0], min(steer.t[-1] + h, pose.t[-1])
    poses = np.column_stack([pose.values[:, :2], np.unwrap(pose.values[:, 2])])
    kept = pose.t - zero >= 0.0
    pose = Signal((pose.t - zero)[kept], poses[kept])
    edges: Array = np.arange(int(max(end - zero, 0.0) / h + 1e-9) + 1).astype(float) * h
    steer, commanded, rolled, gyro = (Signal(s.t - zero, s.values) for s in named.values())
    check_run(name, edges[-1], pose.t, pose.values)
    source = "command"
    if len(commanded.t):
        along = hold_means(commanded, edges)
    else:  # a measured speed is that of the step's end
        source, measured = _measured_speed(rolled, pose)
        along = np.interp(edges[1:], *measured)
    return Run(
        name, h, np.column_stack([hold_means(steer, edges), along]), pose, source, rolled, gyro,
        steer, speed_command=commanded,
    )  # fmt: skip


def _measured_speed(rolled: Signal, pose: Signal) -> tuple[str, Signal]:
    """Which measurement gives the speed: precise poses, else the wheel, which spins and skids."""
    blur = max(noise_of(pose.t, pose.values[:, i]) for i in (0, 1))
    span = 4.0 * float(np.median(np.diff(pose.t))) if len(pose.t) > 1 else 0.0
    sharp = 0.0 < 2.0**0.5 * blur < POSE_SPEED_NOISE_MAX * span
    if len(rolled.t) and not sharp:
        return "wheel", rolled
    return "pose", Signal(*pose_rates(pose)[:2])


_SOURCES = (MOCAP, ACTUATION, VESC, IMU, WHEEL)


def read_run(session: Session, tables: Mapping[str, Columns] | None = None) -> Run:
    """The drive of an open session; `tables` are its columns by topic, where they are read already.

    Poses that the mocap checks rejected are left out, and commands while the car was not driven
    (mode other than SPEED).

    Raises:
        DataError: the drive cannot be used for identification.
        steerd.steer_bus.session.SessionError: the file cannot be read.
    """
    name = session.info().path.name
    listed = sorted(session.info().topics, key=lambda topic: bool(topic.count))
    there = {find_topic(topic.name): topic for topic in listed}  # of two, one with messages
    for needed in (MOCAP, ACTUATION):
        if needed not in there:
            hint = "record with `steerd run`, or import the log with `steerd import`"
            raise DataError(f"{name}: no topic {needed.name!r}", hint)
    wanted = {
        topic: there[topic].name
        for topic in _SOURCES
        if topic in there and (there[topic].count or topic in (MOCAP, ACTUATION))
    }
    if tables is None or not tables.keys() >= {*wanted.values()}:
        tables = session.tables({key: topic.message for topic, key in wanted.items()})
    columns = {topic: tables[key] for topic, key in wanted.items()}
    run = make_run(name, **_signals(session, columns), h=GRID)
    # An import may state the ERPM of a VESC that steerd never drove.
    if "servo_gain" not in session.info().metadata.get("steerd.scaling", {}):
        return run
    return replace(run, servo_frame=SERVO_FRAME, speed_ramp=RAMP_ERPM / abs(read_erpm(session)[0]))


def read_erpm(session: Session) -> tuple[float, float]:
    """Gain [ERPM per m/s] and offset [ERPM] of a session's motor; F1TENTH's where it says none.

    Raises:
        steerd.steer_bus.session.SessionError: what it says is no number.
    """
    gain = session.number("steerd.scaling", "erpm_gain", F1TENTH.erpm_gain)
    return gain, session.number("steerd.scaling", "erpm_offset", F1TENTH.erpm_offset)


def _signals(session: Session, columns: dict[Topic, Columns]) -> dict[str, Signal]:
    """Every signal on the core's monotonic clock [s]."""
    mocap, actuation = columns[MOCAP], columns[ACTUATION]
    accepted = mocap["reject"] == ""
    first = int(mocap["t_valid_ns"][0]) if len(accepted) else 0
    epoch = int(mocap["stamp_ns"][0]) - first if len(accepted) else 0

    def seconds(stamps: NDArray[Any], offset: int = 0) -> Array:
        moved = stamps.astype(np.int64) + (offset - epoch - first)
        return np.asarray(moved.astype(np.float64) * 1e-9)

    def midway(table: Columns) -> Array:
        """Midway between asking and hearing."""
        return seconds((table["t_sent_ns"] + table["t_received_ns"]) // 2, epoch)

    driven = actuation["mode"] == ActuationMode.SPEED
    t_steer = seconds(actuation["stamp_ns"][driven])
    pose: Array = np.column_stack([mocap[c][accepted] for c in ("x", "y", "yaw")]).astype(float)
    holes = seconds(np.array(session.holes(), np.int64).reshape(-1, 2))
    found = {
        "pose": leave_out(Signal(seconds(mocap["t_valid_ns"][accepted], epoch), pose), holes),
        "steer": Signal(t_steer, actuation["steer"][driven].astype(float)),
        "speed": Signal(t_steer, actuation["speed"][driven].astype(float)),
    }
    if vesc := columns.get(VESC):
        gain, offset = read_erpm(session)
        found["wheel"] = Signal(midway(vesc), (vesc["erpm"].astype(float) - offset) / gain)
    elif wheel := columns.get(WHEEL):
        found["wheel"] = Signal(seconds(wheel["t_ns"], epoch), wheel["speed"].astype(float))
    if imu := columns.get(IMU):
        found["yaw_rate"] = Signal(midway(imu), imu["gyro_z"].astype(float))
    return found
