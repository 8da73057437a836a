"""Standard ROS messages for viewers, derived from steerd's own: outside the core, at most 50 Hz."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from math import cos, sin
from typing import Any

from steerd.daemon.ipc.pipe_records import PipeRecord, read_message
from steerd.steer_bus import messages as m
from steerd.steer_bus import standard as ros
from steerd.steer_bus import topics
from steerd.steer_bus.codec import encode
from steerd.steer_bus.topics import Topic

PERIOD_NS = 20_000_000  # shortest time between two messages of a kind


def _pose(x: float, y: float, yaw: float) -> ros.Pose:
    return ros.Pose(ros.Point(x, y, 0.0), ros.Quaternion(0.0, 0.0, sin(0.5 * yaw), cos(0.5 * yaw)))


def _diagonal(*variances: float) -> tuple[float, ...]:
    matrix = [0.0] * 36
    for place, variance in zip((0, 7, 35), variances, strict=True):
        matrix[place] = variance
    return tuple(matrix)


def make_odometry(state: m.StateMessage) -> ros.Odometry:
    """The estimate as `nav_msgs/Odometry`, velocity in the body frame."""
    vx, vy = state.speed * cos(state.slip_angle), state.speed * sin(state.slip_angle)
    twist = ros.Twist(ros.Vector3(vx, vy, 0.0), ros.Vector3(0.0, 0.0, state.yaw_rate))
    return ros.Odometry(
        state.header,
        m.BODY,
        ros.PoseWithCovariance(
            _pose(state.x, state.y, state.yaw),
            _diagonal(state.x_sd**2, state.y_sd**2, state.yaw_sd**2),
        ),
        ros.TwistWithCovariance(
            twist, _diagonal(state.speed_sd**2, state.speed_sd**2, state.yaw_rate_sd**2)
        ),
    )


def make_pose_stamped(pose: m.MocapPose) -> ros.PoseStamped:
    """A processed mocap sample as `geometry_msgs/PoseStamped`."""
    return ros.PoseStamped(pose.header, _pose(pose.x, pose.y, pose.yaw))


_UNASKED = dict.fromkeys((
    "charge_drawn", "charge_regen", "energy_drawn", "energy_regen", "pid_pos_now",
    "controller_id", "ntc_temp_mos1", "ntc_temp_mos2", "ntc_temp_mos3",
), 0)  # fmt: skip
"""What the daemon does not ask a VESC for."""


def make_vesc_state(vesc: m.VescTelemetry) -> ros.VescStateStamped:
    """Telemetry as `vesc_msgs/VescStateStamped` (`speed` is ERPM there)."""
    state = ros.VescState(
        temp_fet=vesc.temp_fet,
        temp_motor=vesc.temp_motor,
        current_motor=vesc.current_motor,
        current_input=vesc.current_in,
        avg_id=vesc.id,
        avg_iq=vesc.iq,
        duty_cycle=vesc.duty,
        speed=float(vesc.erpm),
        voltage_input=vesc.v_in,
        displacement=vesc.tachometer,
        distance_traveled=vesc.tachometer_abs,
        fault_code=max(vesc.fault_code, 0),
        avg_vd=vesc.vd,
        avg_vq=vesc.vq,
        **_UNASKED,
    )
    return ros.VescStateStamped(vesc.header, state)


_VIEWS: dict[str, tuple[Topic, Callable[[Any], Any]]] = {
    topics.STATE.name: (topics.ODOM, make_odometry),
    topics.MOCAP.name: (topics.POSE, make_pose_stamped),
    topics.VESC.name: (topics.VESC_STATE, make_vesc_state),
}


@dataclass
class Views:
    """Converts records to standard ROS messages, at most 50 of each kind per second."""

    _due_ns: dict[str, int] = field(default_factory=dict)
    _count: dict[str, int] = field(default_factory=dict)

    def convert(self, record: PipeRecord) -> Iterator[PipeRecord]:
        """The standard message made of this record, if one is due."""
        view = _VIEWS.get(record.topic.name)
        if view is None or record.log_time_ns < self._due_ns.get(record.topic.name, 0):
            return
        self._due_ns[record.topic.name] = record.log_time_ns + PERIOD_NS
        topic, make = view
        count = self._count[topic.name] = self._count.get(topic.name, -1) + 1
        data = encode(make(read_message(record)))
        yield PipeRecord(topic, count, record.log_time_ns, record.publish_time_ns, data)
