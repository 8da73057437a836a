"""Runs of the hidden plant as session files, in the layout of imported and recorded drives.

Three flavours, as users bring them: `vesc` (poses, commands, ERPM), `wheel` (poses, commands, wheel
speed, gyro) and `bare` (poses and commands only). Nothing in a file depends on what is hidden.
"""

from dataclasses import dataclass
from math import cos, nan, sin
from pathlib import Path

import numpy as np

from benchmarks.blind_gap.car import PlantCar
from benchmarks.blind_gap.drives import LEAD
from benchmarks.blind_gap.plant import STEP, TICK, Array, Trace, motor_speed
from steerd.steer_bus import messages as m
from steerd.steer_bus.codec import encode
from steerd.steer_bus.session import SessionWriter
from steerd.steer_bus.topics import ACTUATION, IMU, MOCAP, VESC, WHEEL, Topic, make_session_topic

CAR = "blind"
FLAVOURS = ("vesc", "wheel", "bare")
ERPM_GAIN = 4614.0
"""ERPM per m/s that the car file of the F1TENTH car gives."""
EPOCH_NS = 1_750_000_000_000_000_000
_TICK_NS = round(TICK * STEP * 1e9)
_LOG_DELAY_NS = 200_000
_GYRO_SD, _WHEEL_SD = 0.02, 0.01
_TOPICS: dict[str, tuple[Topic, ...]] = {
    "vesc": (MOCAP, ACTUATION, VESC),
    "wheel": (MOCAP, ACTUATION, WHEEL, IMU),
    "bare": (MOCAP, ACTUATION),
}


@dataclass(frozen=True, slots=True)
class Run:
    """What the instruments recorded at 100 Hz: arrays of equal length.

    Attributes:
        t_ns: stamps of poses [ns].
        commands: rows wheel angle [rad], speed [m/s].
        poses: rows x, y, yaw.
        wheel: reported wheel speed [m/s].
        yaw_rate: gyro [rad/s].
    """

    t_ns: Array
    commands: Array
    poses: Array
    wheel: Array
    yaw_rate: Array


def make_run(car: PlantCar, trace: Trace, rng: np.random.Generator, jitter: float = 0.0) -> Run:
    """Instruments on a trace: the lead-in cut off, wheel speed and gyro with their errors.

    Args:
        car: the car that drove; its wheels may be of another size than the controller believes.
        trace: what happened.
        rng: errors of wheel speed, gyro and stamps.
        jitter: standard deviation of the poses' stamps [s]; order is kept.
    """
    first = LEAD // TICK
    states = trace.states[LEAD::TICK]
    n = len(states)
    late = rng.standard_normal(n) * jitter
    stamps = np.sort(np.arange(n) * TICK * STEP + late)
    turned = np.array([motor_speed(car, state) for state in states])
    spin = turned / (car.wheel_scale * car.speed_gain)
    return Run(
        np.round(stamps * 1e9) + 1_000_000_000,
        trace.commands[first:],
        trace.poses[first:],
        spin + _WHEEL_SD * rng.standard_normal(n),
        states[:, 5] + _GYRO_SD * rng.standard_normal(n),
    )


def reverse_run(run: Run) -> Run:
    """The run played backwards against a clock that runs forwards: no car does that."""
    return Run(run.t_ns, run.commands[::-1], run.poses[::-1], run.wheel[::-1], run.yaw_rate[::-1])


def swap_commands(run: Run, other: Run) -> Run:
    """The run with the commands of another."""
    n = min(len(run.commands), len(other.commands))
    return Run(run.t_ns[:n], other.commands[:n], run.poses[:n], run.wheel[:n], run.yaw_rate[:n])


def _pose(epoch_ns: int, t_ns: int, frame: int, pose: Array) -> m.MocapPose:
    x, y, yaw = (float(v) for v in pose)
    yaw = float(np.arctan2(sin(yaw), cos(yaw)))
    header = m.make_header(t_ns + epoch_ns, m.WORLD)
    quaternion = (cos(0.5 * yaw), 0.0, 0.0, sin(0.5 * yaw))
    stamps = (t_ns, t_ns, t_ns, frame, 0, 1)
    return m.MocapPose(header, *stamps, x, y, nan, *quaternion, nan, x, y, yaw, nan, nan, "")


def _messages(run: Run, at: int, flavour: str, epoch_ns: int) -> list[tuple[Topic, int, object]]:
    """The messages of one tick, each with its time of validity [ns]."""
    due_ns = 1_000_000_000 + at * _TICK_NS
    header = m.make_header(due_ns + epoch_ns, m.BODY)
    pose_ns = int(run.t_ns[at])
    steer, speed = (float(v) for v in run.commands[at])
    mode = m.ActuationMode.SPEED
    out: list[tuple[Topic, int, object]] = [
        (MOCAP, pose_ns, _pose(epoch_ns, pose_ns, at, run.poses[at])),
        (ACTUATION, due_ns, m.Actuation(header, at + 1, mode, steer, speed, nan, b"")),
    ]
    wheel = float(run.wheel[at])
    if flavour == "vesc" and at % 2 == 0:
        unknown = (-1, round(wheel * ERPM_GAIN), -1, -1, -1, -1, *(nan,) * 10)
        out.append((VESC, due_ns, m.VescTelemetry(header, due_ns, due_ns, *unknown)))
    if flavour == "wheel":
        imu = m.VescImu(header, due_ns, due_ns, *(nan,) * 5, float(run.yaw_rate[at]), *(nan,) * 4)
        out.append((WHEEL, due_ns, m.WheelSpeed(header, due_ns, wheel)))
        out.append((IMU, due_ns, imu))
    return out


def write_run(path: Path, run: Run, flavour: str, offset_ns: int = 0) -> None:
    """Write one run as a session.

    Args:
        path: the file, ending in `.mcap`; it must not exist.
        run: what was recorded.
        flavour: `vesc`, `wheel` or `bare`.
        offset_ns: when after the epoch of all runs this one took place [ns].

    Raises:
        SessionError: the file cannot be written.
    """
    topics, epoch_ns = _TOPICS[flavour], EPOCH_NS + offset_ns
    names = {topic.name: make_session_topic(CAR, topic) for topic in topics}
    writer = SessionWriter(
        path,
        {names[topic.name]: topic.message for topic in topics},
        {"steerd.session": {"car": CAR, "mode": "import", "epoch_ns": str(epoch_ns)}},
        {},
        epoch_ns,
    )
    for at in range(len(run.t_ns)):
        for topic, t_ns, message in _messages(run, at, flavour, epoch_ns):
            stamp = t_ns + epoch_ns
            writer.write(names[topic.name], encode(message), stamp + _LOG_DELAY_NS, stamp)
    writer.finish({"reason": "imported", "messages": str(writer.count)})
