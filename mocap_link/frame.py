"""From a vendor's body pose to the car's planar pose.

Canonical frame: z up, x and y on the floor, metres, quaternion (w, x, y, z), yaw
counter-clockwise. The heading is the direction of the body's forward axis on the floor, never an
Euler angle: it is indifferent to the sign of the quaternion and well defined up to a 90° tilt.
"""

from dataclasses import dataclass
from math import acos, atan2, cos, hypot, pi, sin
from typing import NamedTuple

Vec3 = tuple[float, float, float]
Quat = tuple[float, float, float, float]

_AXES: dict[str, Vec3] = {
    "+x": (1.0, 0.0, 0.0),
    "-x": (-1.0, 0.0, 0.0),
    "+y": (0.0, 1.0, 0.0),
    "-y": (0.0, -1.0, 0.0),
    "+z": (0.0, 0.0, 1.0),
    "-z": (0.0, 0.0, -1.0),
}
_SCALE = {"m": 1.0, "mm": 1e-3}


@dataclass(frozen=True, slots=True)
class FrameConfig:
    """How the mocap room and the body on the car relate to the world and to the CoG."""

    units: str = "m"  # the server's length unit, `m` or `mm`
    up: str = "z"  # the server's up axis, `y` or `z`
    body_forward: str = "+x"  # the body axis (in the vendor's axes) that points to the car's front
    world_yaw: float = 0.0  # rotation of the mocap room in the world [rad], about its origin
    world_xy: tuple[float, float] = (0.0, 0.0)  # the mocap origin in the world [m]
    # Heading of the body's forward axis in the car [rad]; the car's heading is the body's minus
    # this (beta of the calibration drive)
    mount_yaw: float = 0.0
    marker_rear_x: float = 0.0  # the mocap body's origin ahead of the rear axle [m]
    marker_rear_y: float = 0.0  # and to the left of the car's centre line [m]
    cog_ahead_of_rear: float = 0.0  # l_r, the CoG ahead of the rear axle [m]

    def __post_init__(self) -> None:
        """Refuse configurations that have no meaning.

        Raises:
            ValueError: an unknown unit or axis, or a forward axis that points up.
        """
        if self.units not in _SCALE:
            raise ValueError(f"mocap units {self.units!r}: expected m or mm")
        if self.up not in ("y", "z"):
            raise ValueError(f"mocap up axis {self.up!r}: expected y or z")
        if self.body_forward not in _AXES:
            raise ValueError(f"body_forward {self.body_forward!r}: expected one of {set(_AXES)}")
        if self.body_forward[1] == self.up:
            raise ValueError(f"body_forward {self.body_forward} cannot be the up axis")


class PlanarPose(NamedTuple):
    """Pose of the CoG on the floor [m, rad], with the body's height [m] and tilt [rad]."""

    x: float
    y: float
    yaw: float
    height: float
    tilt: float


def relabel_vector(v: Vec3, up: str) -> Vec3:
    """Express a vendor vector with z up: (x, y, z) -> (x, -z, y) from y up."""
    return v if up == "z" else (v[0], -v[2], v[1])


def relabel_quaternion(q: Quat, up: str) -> Quat:
    """Express a vendor rotation with z up: (w, x, y, z) -> (w, x, -z, y) from y up.

    World and body axes are renamed alike, so it is no bare rotation of the body.
    """
    return q if up == "z" else (q[0], q[1], -q[3], q[2])


def rotate(q: Quat, v: Vec3) -> Vec3:
    """Rotate `v` by the unit quaternion `q` (w, x, y, z)."""
    w, x, y, z = q
    vx, vy, vz = v
    tx, ty, tz = 2 * (y * vz - z * vy), 2 * (z * vx - x * vz), 2 * (x * vy - y * vx)
    return (
        vx + w * tx + y * tz - z * ty,
        vy + w * ty + z * tx - x * tz,
        vz + w * tz + x * ty - y * tx,
    )


def wrap_angle(angle: float) -> float:
    """Wrap an angle into (-pi, pi]."""
    wrapped = (angle + pi) % (2 * pi) - pi
    return pi if wrapped == -pi else wrapped


def make_planar_pose(config: FrameConfig, position: Vec3, quaternion: Quat) -> PlanarPose:
    """Place the car from a body pose in vendor axes and units, its quaternion (w, x, y, z).

    Raises:
        ValueError: a quaternion of zero or non-finite length, or a position that is not finite.
    """
    norm = hypot(*quaternion)
    if not 0.0 < norm < float("inf") or not hypot(*position) < float("inf"):
        raise ValueError(f"no pose in position {position}, quaternion {quaternion}")
    w, a, b, c = quaternion
    q = relabel_quaternion((w / norm, a / norm, b / norm, c / norm), config.up)
    forward = rotate(q, relabel_vector(_AXES[config.body_forward], config.up))
    yaw = atan2(forward[1], forward[0]) + config.world_yaw - config.mount_yaw
    scale = _SCALE[config.units]
    px, py, pz = relabel_vector(position, config.up)
    px, py, pz = px * scale, py * scale, pz * scale
    cw, sw = (cos(config.world_yaw), sin(config.world_yaw)) if config.world_yaw else (1.0, 0.0)
    # p_rear = p_m - R(yaw) (rx, ry);  p_cog = p_rear + R(yaw) (l_r, 0)
    ox, oy = config.cog_ahead_of_rear - config.marker_rear_x, -config.marker_rear_y
    cy, sy = cos(yaw), sin(yaw)
    x = cw * px - sw * py + config.world_xy[0] + cy * ox - sy * oy
    y = sw * px + cw * py + config.world_xy[1] + sy * ox + cy * oy
    # third diagonal element of R(q): the body's up axis along the world's
    tilt = acos(max(-1.0, min(1.0, 1.0 - 2.0 * (q[1] * q[1] + q[2] * q[2]))))
    return PlanarPose(x, y, wrap_angle(yaw), pz, tilt)


def make_body_pose(
    config: FrameConfig, x: float, y: float, yaw: float, height: float = 0.0
) -> tuple[Vec3, Quat]:
    """Invert `make_planar_pose` for a level car: the vendor pose that a mocap system would send.

    Returns:
        Position in vendor axes and units, and quaternion (w, x, y, z) in vendor axes.
    """
    ox, oy = config.cog_ahead_of_rear - config.marker_rear_x, -config.marker_rear_y
    dx = x - (cos(yaw) * ox - sin(yaw) * oy) - config.world_xy[0]
    dy = y - (sin(yaw) * ox + cos(yaw) * oy) - config.world_xy[1]
    cw, sw = cos(config.world_yaw), sin(config.world_yaw)
    scale = _SCALE[config.units]
    px, py, pz = (cw * dx + sw * dy) / scale, (cw * dy - sw * dx) / scale, height / scale
    axis = relabel_vector(_AXES[config.body_forward], config.up)
    half = (yaw + config.mount_yaw - config.world_yaw - atan2(axis[1], axis[0])) / 2
    qw, qz = cos(half), sin(half)
    if config.up == "z":
        return (px, py, pz), (qw, 0.0, 0.0, qz)
    return (px, pz, -py), (qw, 0.0, qz, 0.0)
