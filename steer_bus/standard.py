"""The ROS 2 messages that tools already understand, in their exact layout.

Sources: common_interfaces, rcl_interfaces, ackermann_msgs and the ROS 2 branch of f1tenth/vesc.
Units are those of the ROS definitions; ``VescState.speed`` is in electrical rpm, as there.
"""

from typing import Any

from steerd.steer_bus import fields as ros
from steerd.steer_bus.fields import message

NS = 1_000_000_000


@message("builtin_interfaces/msg/Time")
class Time:
    """A time since the UNIX epoch: whole seconds and nanoseconds below one second."""

    sec: ros.Int32
    nanosec: ros.UInt32


@message("std_msgs/msg/Header")
class Header:
    """Stamp and coordinate frame of what follows."""

    stamp: Time
    frame_id: ros.String


@message("geometry_msgs/msg/Point")
class Point:
    """A position [m]."""

    x: ros.Float64
    y: ros.Float64
    z: ros.Float64


@message("geometry_msgs/msg/Vector3")
class Vector3:
    """A free vector in the unit of its context."""

    x: ros.Float64
    y: ros.Float64
    z: ros.Float64


@message("geometry_msgs/msg/Quaternion")
class Quaternion:
    """A rotation, scalar last."""

    x: ros.Float64
    y: ros.Float64
    z: ros.Float64
    w: ros.Float64


@message("geometry_msgs/msg/Pose")
class Pose:
    """Position and orientation."""

    position: Point
    orientation: Quaternion


@message("geometry_msgs/msg/PoseStamped")
class PoseStamped:
    """A pose in a frame at a time."""

    header: Header
    pose: Pose


@message("geometry_msgs/msg/PoseWithCovariance")
class PoseWithCovariance:
    """A pose with its 6×6 row-major covariance over (x, y, z, roll, pitch, yaw)."""

    pose: Pose
    covariance: ros.Float64x36


@message("geometry_msgs/msg/Twist")
class Twist:
    """Linear [m/s] and angular [rad/s] velocity."""

    linear: Vector3
    angular: Vector3


@message("geometry_msgs/msg/TwistWithCovariance")
class TwistWithCovariance:
    """A twist with its 6×6 row-major covariance."""

    twist: Twist
    covariance: ros.Float64x36


@message("nav_msgs/msg/Odometry")
class Odometry:
    """Pose in ``header.frame_id``, twist in ``child_frame_id``."""

    header: Header
    child_frame_id: ros.String
    pose: PoseWithCovariance
    twist: TwistWithCovariance


@message("ackermann_msgs/msg/AckermannDrive")
class AckermannDrive:
    """Steering [rad], its rate [rad/s], speed [m/s], acceleration [m/s²] and jerk [m/s³]."""

    steering_angle: ros.Float32
    steering_angle_velocity: ros.Float32
    speed: ros.Float32
    acceleration: ros.Float32
    jerk: ros.Float32


@message("ackermann_msgs/msg/AckermannDriveStamped")
class AckermannDriveStamped:
    """A drive command at a time."""

    header: Header
    drive: AckermannDrive


@message("vesc_msgs/msg/VescState")
class VescState:
    """The VESC's telemetry as f1tenth's driver publishes it (ROS 2 layout)."""

    temp_fet: ros.Float64
    temp_motor: ros.Float64
    current_motor: ros.Float64
    current_input: ros.Float64
    avg_id: ros.Float64
    avg_iq: ros.Float64
    duty_cycle: ros.Float64
    speed: ros.Float64
    voltage_input: ros.Float64
    charge_drawn: ros.Float64
    charge_regen: ros.Float64
    energy_drawn: ros.Float64
    energy_regen: ros.Float64
    displacement: ros.Int32
    distance_traveled: ros.Int32
    fault_code: ros.Int32
    pid_pos_now: ros.Float64
    controller_id: ros.Int32
    ntc_temp_mos1: ros.Float64
    ntc_temp_mos2: ros.Float64
    ntc_temp_mos3: ros.Float64
    avg_vd: ros.Float64
    avg_vq: ros.Float64


@message("vesc_msgs/msg/VescStateStamped")
class VescStateStamped:
    """VESC telemetry at a time."""

    header: Header
    state: VescState


@message("diagnostic_msgs/msg/KeyValue")
class KeyValue:
    """One named reading."""

    key: ros.String
    value: ros.String


@message("diagnostic_msgs/msg/DiagnosticStatus")
class DiagnosticStatus:
    """Health of one part; level 0 ok, 1 warn, 2 error, 3 stale."""

    level: ros.Byte
    name: ros.String
    message: ros.String
    hardware_id: ros.String
    values: tuple[KeyValue, ...]


@message("diagnostic_msgs/msg/DiagnosticArray")
class DiagnosticArray:
    """Health of all parts at a time."""

    header: Header
    status: tuple[DiagnosticStatus, ...]


@message("rcl_interfaces/msg/Log")
class Log:
    """A log line; level 10 debug, 20 info, 30 warn, 40 error, 50 fatal."""

    stamp: Time
    level: ros.UInt8
    name: ros.String
    msg: ros.String
    file: ros.String
    function: ros.String
    line: ros.UInt32


STANDARD_MESSAGES: tuple[type[Any], ...] = tuple(
    cls for cls in [*vars().values()] if hasattr(cls, "__ros_type__")
)


def make_time(stamp_ns: int) -> Time:
    """Make a ROS time of nanoseconds since the UNIX epoch."""
    return Time(stamp_ns // NS, stamp_ns % NS)


def make_header(stamp_ns: int, frame_id: str) -> Header:
    """Make a header of nanoseconds since the UNIX epoch and a frame."""
    return Header(Time(stamp_ns // NS, stamp_ns % NS), frame_id)


def stamp_ns(header: Header) -> int:
    """Give a header's stamp in nanoseconds since the UNIX epoch."""
    return header.stamp.sec * NS + header.stamp.nanosec
