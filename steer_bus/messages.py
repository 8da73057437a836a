"""steerd's own messages, one flat record each: header, integers, floats, then texts and bytes.

``header.stamp`` is UNIX time at the recorder's epoch, so that any viewer can place the message;
every ``*_ns`` field is CLOCK_MONOTONIC of the control core. A float that is absent is NaN, an
absent integer -1. The world frame is :data:`WORLD` (z up), the body frame :data:`BODY` (at the
CoG, x forward, y left); yaw and steer are positive to the left.
"""

from enum import IntEnum
from typing import Annotated, Any

from steerd.steer_bus import fields as ros
from steerd.steer_bus.fields import message
from steerd.steer_bus.standard import Header as Header
from steerd.steer_bus.standard import make_header as make_header
from steerd.steer_bus.standard import stamp_ns as stamp_ns

WORLD = "map"
BODY = "base_link"

Metre = Annotated[ros.Float64, "m"]
MetrePerSecond = Annotated[ros.Float64, "m/s"]
MetrePerSecond2 = Annotated[ros.Float64, "m/s^2"]
Radian = Annotated[ros.Float64, "rad"]
RadianPerSecond = Annotated[ros.Float64, "rad/s"]
PerMetre = Annotated[ros.Float64, "1/m"]
PerRadian = Annotated[ros.Float64, "1/rad"]
Second = Annotated[ros.Float64, "s"]
KilogramMetre2 = Annotated[ros.Float64, "kg m^2"]
Ampere = Annotated[ros.Float64, "A"]
Volt = Annotated[ros.Float64, "V"]
Celsius = Annotated[ros.Float64, "degC"]
Unitless = Annotated[ros.Float64, "1"]
Nanosecond = Annotated[ros.Int64, "ns"]
Millisecond = Annotated[ros.Int64, "ms"]


class ActuationMode(IntEnum):
    """What a tick put on the serial wire."""

    SILENT = 0
    SPEED = 1
    BRAKE = 2
    RELEASE = 3
    SHORT = 4


class RequestKind(IntEnum):
    """What an operator asks for. Zero is nothing, so that cleared memory never arms a car."""

    ARM = 1
    START = 2
    STOP = 3
    DISARM = 4
    CLEAR = 5
    ESTOP = 6
    KEEPALIVE = 7


@message("steerd_msgs/msg/Tick")
class Tick:
    """Timing of one control tick; ``work_ns`` is the work of the tick before it.

    ``due_ns`` is the deadline. A tick that comes with its pose wakes before it.
    """

    header: Header
    due_ns: Nanosecond
    woke_ns: Nanosecond
    work_ns: Nanosecond
    seq: ros.UInt32
    flags: ros.UInt32


@message("steerd_msgs/msg/MocapPose")
class MocapPose:
    """One mocap sample: as it came (``*_raw``, quaternion) and as the estimator may use it.

    ``t_valid_ns`` is mid-exposure on the host's clock, ``t_arrival_ns`` the kernel's receive
    stamp, ``source_ticks`` the source's own time. ``x``, ``y``, ``yaw`` are the CoG's planar pose;
    ``tilt`` is the angle of body z to world z. ``reject`` names the gate that refused the sample
    and is empty for an accepted one.
    """

    header: Header
    t_valid_ns: Nanosecond
    t_arrival_ns: Nanosecond
    source_ticks: ros.UInt64
    frame: ros.Int64
    clock_kind: ros.UInt8
    tracking_valid: ros.UInt8
    x_raw: Metre
    y_raw: Metre
    z_raw: Metre
    qw: Unitless
    qx: Unitless
    qy: Unitless
    qz: Unitless
    mean_error: Metre
    x: Metre
    y: Metre
    yaw: Radian
    height: Metre
    tilt: Radian
    reject: ros.String


@message("steerd_msgs/msg/VescTelemetry")
class VescTelemetry:
    """One reply of the VESC: motor, battery and temperatures, with send and receive stamps.

    ``erpm`` is electrical rpm; the tachometers count sixths of an electrical revolution;
    ``fault_code`` and ``status`` are the firmware's; ``uptime_ms`` is the VESC's own clock.
    """

    header: Header
    t_sent_ns: Nanosecond
    t_received_ns: Nanosecond
    uptime_ms: Millisecond
    erpm: ros.Int32
    tachometer: ros.Int32
    tachometer_abs: ros.Int32
    fault_code: ros.Int32
    status: ros.Int32
    v_in: Volt
    current_motor: Ampere
    current_in: Ampere
    duty: Unitless
    temp_fet: Celsius
    temp_motor: Celsius
    id: Ampere
    iq: Ampere
    vd: Volt
    vq: Volt


@message("steerd_msgs/msg/VescIdentity")
class VescIdentity:
    """Who the VESC is and how it stops by itself; sent whenever more of it becomes known.

    ``expected`` is 0 when its UUID is not the one of the car file; ``timeout_ms`` is -1 and
    ``timeout_brake_current`` NaN until GET_APPCONF was answered.
    """

    header: Header
    t_received_ns: Nanosecond
    timeout_ms: ros.Int32
    expected: ros.UInt8
    fw_major: ros.UInt8
    fw_minor: ros.UInt8
    timeout_brake_current: Ampere
    uuid: ros.String


@message("steerd_msgs/msg/VescImu")
class VescImu:
    """One IMU reply of the VESC in the board's frame; the quaternion is the firmware's own."""

    header: Header
    t_sent_ns: Nanosecond
    t_received_ns: Nanosecond
    accel_x: MetrePerSecond2
    accel_y: MetrePerSecond2
    accel_z: MetrePerSecond2
    gyro_x: RadianPerSecond
    gyro_y: RadianPerSecond
    gyro_z: RadianPerSecond
    qw: Unitless
    qx: Unitless
    qy: Unitless
    qz: Unitless


@message("steerd_msgs/msg/Actuation")
class Actuation:
    """What went to the serial wire in this tick: the intent and the exact bytes (``wire``).

    ``mode`` is an :class:`ActuationMode`; ``steer`` and ``speed`` are the commands after every
    limit, ``brake_current_a`` the brake current of a stop.
    """

    header: Header
    seq: ros.UInt32
    mode: ros.UInt8
    steer: Radian
    speed: MetrePerSecond
    brake_current_a: Ampere
    wire: ros.Bytes


@message("steerd_msgs/msg/State")
class StateMessage:
    """The tick's aggregate: estimate with standard deviations, lane errors, references.

    ``mode`` is the supervisor's state; ``slip_angle`` is the CoG's; ``e1`` is the CoG's lateral
    offset from the lane that it follows (left positive), which is the path unless live parameters
    shift it, ``e2`` the heading error in (-pi, pi]; ``nis_pose`` is the
    normalised innovation squared of the last pose (3 degrees of freedom).
    """

    header: Header
    mono_ns: Nanosecond
    seq: ros.UInt32
    flags: ros.UInt32
    mode: ros.UInt8
    x: Metre
    y: Metre
    yaw: Radian
    speed: MetrePerSecond
    yaw_rate: RadianPerSecond
    slip_angle: Radian
    steer: Radian
    x_sd: Metre
    y_sd: Metre
    yaw_sd: Radian
    speed_sd: MetrePerSecond
    yaw_rate_sd: RadianPerSecond
    slip_angle_sd: Radian
    steer_sd: Radian
    e1: Metre
    e2: Radian
    curvature: PerMetre
    path_s: Metre
    steer_ref: Radian
    speed_ref: MetrePerSecond
    nis_pose: Unitless


@message("steerd_msgs/msg/DriveCommand")
class DriveCommand:
    """An external controller's command, good for ``valid_ms`` after it arrives.

    ``boot_id`` and ``lease_id`` name the daemon's run and the lease under which it may drive;
    ``t_source_ns`` is the sender's own monotonic time and is compared only with itself.
    """

    header: Header
    boot_id: ros.UInt64
    lease_id: ros.UInt64
    t_source_ns: Nanosecond
    seq: ros.UInt32
    valid_ms: ros.UInt16
    steer: Radian
    speed: MetrePerSecond


@message("steerd_msgs/msg/OperatorRequest")
class OperatorRequest:
    """A person's request (``kind`` is a :class:`RequestKind`) under a lease."""

    header: Header
    boot_id: ros.UInt64
    lease_id: ros.UInt64
    seq: ros.UInt32
    kind: ros.UInt8
    operator: ros.String


@message("steerd_msgs/msg/Heartbeat")
class Heartbeat:
    """A sign of life that left the core at ``mono_ns``, and comes back from who holds the lease.

    Whoever keeps a lease alive sends the newest back under it with each keepalive; ``lease_id`` is
    0 until then. Back in the core, it has gone the whole way that a stop goes.
    """

    header: Header
    boot_id: ros.UInt64
    lease_id: ros.UInt64
    mono_ns: Nanosecond


@message("steerd_msgs/msg/ParameterRequest")
class ParameterRequest:
    """A person's request for other live parameters, under a lease; NaN leaves one as it is.

    ``speed`` is the highest along the lane, ``offset`` shifts the lane to the left of the path,
    ``gain`` is a share of the designed feedback.
    """

    header: Header
    boot_id: ros.UInt64
    lease_id: ros.UInt64
    seq: ros.UInt32
    speed: MetrePerSecond
    offset: Metre
    gain: Unitless
    operator: ros.String


@message("steerd_msgs/msg/Parameters")
class Parameters:
    """Live parameters that were accepted last, their bounds, and the answer to the last request.

    ``lease_id`` and ``seq`` are those of that request, zero before the first; ``accepted`` is 0 for
    one that was refused, and ``text`` says why.
    """

    header: Header
    lease_id: ros.UInt64
    seq: ros.UInt32
    accepted: ros.UInt8
    speed: MetrePerSecond
    speed_min: MetrePerSecond
    speed_max: MetrePerSecond
    offset: Metre
    offset_min: Metre
    offset_max: Metre
    gain: Unitless
    gain_min: Unitless
    gain_max: Unitless
    text: ros.String


@message("steerd_msgs/msg/Transition")
class Transition:
    """A change of the supervisor's state: a stable ``code`` and a sentence for people."""

    header: Header
    from_state: ros.UInt8
    to_state: ros.UInt8
    code: ros.String
    text: ros.String


@message("steerd_msgs/msg/ClockSample")
class ClockSample:
    """Once a second: the host's two clocks read together, and mocap time minus host time."""

    header: Header
    realtime_ns: Nanosecond
    monotonic_ns: Nanosecond
    mocap_offset_ns: Nanosecond


@message("steerd_msgs/msg/WheelSpeed")
class WheelSpeed:
    """A wheel or motor encoder's speed, for cars and logs that have no VESC; forward positive."""

    header: Header
    t_ns: Nanosecond
    speed: MetrePerSecond


@message("steerd_msgs/msg/Throttle")
class Throttle:
    """An open-loop motor command in the unit of its car (-1 to 1, mostly); forward positive."""

    header: Header
    t_ns: Nanosecond
    throttle: Unitless


@message("steerd_msgs/msg/Model")
class Model:
    """Once a second, with ``run --learn``: the car as learnt while it drives, and its changes.

    ``verdict`` is ``learning`` while the car is not known yet, ``none``, or that of the newest
    change: ``changed`` (too early to say), ``named``, ``unexplained``. That change began at
    ``since_ns`` and was called at ``noticed_ns`` (-1 without one); ``effect``, ``alternatives``
    (what the drive cannot distinguish from it) and ``confidence`` are empty unless it is named.
    ``windows`` counts the half seconds that were learnt from, ``dropped`` the records that the
    learner was too slow for. A parameter that is not learnt is NaN; ``identifiable`` lists those
    that this drive identifies, and ``details`` holds every value and change as JSON
    (docs/how-to/learn-while-driving.md).
    """

    header: Header
    mono_ns: Nanosecond
    since_ns: Nanosecond
    noticed_ns: Nanosecond
    windows: ros.UInt32
    dropped: ros.UInt32
    confidence: Unitless
    lf: Metre
    lf_sd: Metre
    lr: Metre
    lr_sd: Metre
    c_sf: PerRadian
    c_sf_sd: PerRadian
    c_sr: PerRadian
    c_sr_sd: PerRadian
    c_x: Unitless
    c_x_sd: Unitless
    inertia_z: KilogramMetre2
    inertia_z_sd: KilogramMetre2
    steer_gain: Unitless
    steer_gain_sd: Unitless
    steer_bias: Radian
    steer_bias_sd: Radian
    steer_delay: Second
    steer_delay_sd: Second
    steer_lag: Second
    steer_lag_sd: Second
    steer_rate: RadianPerSecond
    steer_rate_sd: RadianPerSecond
    speed_gain: Unitless
    speed_gain_sd: Unitless
    speed_lag: Second
    speed_lag_sd: Second
    drive_delay: Second
    drive_delay_sd: Second
    accel_max: MetrePerSecond2
    accel_max_sd: MetrePerSecond2
    decel_max: MetrePerSecond2
    decel_max_sd: MetrePerSecond2
    pose_delay: Second
    pose_delay_sd: Second
    verdict: ros.String
    effect: ros.String
    alternatives: ros.String
    identifiable: ros.String
    details: ros.String


@message("steerd_msgs/msg/Design")
class Design:
    """With ``run --adapt``: the design that the core took, and for which numbers of the car.

    ``number`` is 0 for the car file's own design, which ``text`` says why; the numbers are then NaN
    and there are no gains. Else ``gains`` holds rows of ``columns`` float64 (little-endian) at
    speeds from ``speed_min`` on, ``spacing`` apart, as docs/explanation/controller.md says; the
    ``body_*`` are where the mocap body is on the car. The learner proposes in the same form, with
    the time of its newest pose in ``mono_ns``.
    """

    header: Header
    mono_ns: Nanosecond
    number: ros.UInt32
    columns: ros.UInt32
    steer_gain: Unitless
    steer_bias: Radian
    steer_delay: Second
    steer_lag: Second
    speed_gain: Unitless
    c_sf: PerRadian
    c_sr: PerRadian
    body_yaw: Radian
    body_forward: Metre
    body_left: Metre
    speed_min: MetrePerSecond
    spacing: MetrePerSecond
    text: ros.String
    gains: ros.Bytes


OWN_MESSAGES: tuple[type[Any], ...] = tuple(
    cls for cls in [*vars().values()] if getattr(cls, "__ros_type__", "").startswith("steerd_msgs/")
)
