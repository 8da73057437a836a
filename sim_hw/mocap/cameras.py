"""The simulated cameras: the car's pose at each exposure, with noise and faults of the tracking."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

from steerd.mocap_link.frame import FrameConfig, Quat, make_body_pose
from steerd.mocap_link.source import Pose
from steerd.sim_hw.plant.car import SimCar
from steerd.sim_hw.plant.faults import HEALTHY_MOCAP, MocapFaultState
from steerd.sim_hw.plant.noise import NoiseSource
from steerd.steer_bus.quick_values import changed, quick_value

Planar = tuple[float, float, float]  # x, y, yaw of a true or seen pose in the world [m, m, rad]


class Bystander(NamedTuple):
    """Another tracked thing that stands in the room."""

    name: str
    id: int
    pose: Planar


@dataclass(frozen=True, slots=True)
class MocapConfig:
    """Settings of the simulated mocap system.

    The latency is that of a wired Motive system (`docs/reference/mocap-protocols.md#m5.1`).
    """

    kind: str = "natnet"  # ``natnet`` or ``vrpn``
    rate_hz: int = 100  # frames per second
    body: str = "car"  # the car's name and streaming id
    body_id: int = 1
    bystanders: tuple[Bystander, ...] = ()  # other tracked things
    # How the room and the body lie to world and CoG (what the client must undo)
    frame: FrameConfig = field(default_factory=FrameConfig)
    height: float = 0.1  # of the body's origin [m]
    position_noise: float = 2e-4  # standard deviations [m], [rad], [rad]
    yaw_noise: float = 1e-3
    tilt_noise: float = 2e-3
    mean_error: float = 5e-4  # marker residual [m]
    camera_ns: int = 4_570_000  # from mid-exposure to data received, and from there to transmit
    software_ns: int = 810_000
    jitter_ns: int = 120_000  # standard deviation of the transmit time
    network_ns: int = 100_000  # from transmit to arrival
    version: tuple[int, int] = (4, 1)  # NatNet bitstream
    multicast: bool = False  # NatNet frames go to the group, not to each client
    clock_hz: int = 10_000_000  # ticks per second of the server's clock (not 1e7 by law)
    epoch_ticks: int = 81_234_567_890  # its reading at the simulation's start
    skew_ppm: float = 15.0  # how fast it runs
    keepalive_ns: int = 10_000_000_000  # silence after which a unicast client is dropped


_NS = 1_000_000_000
_IMPOSTOR = (1.5, -1.0, 0.3)  # where the other thing stands when the room has none [m, m, rad]


@quick_value
class Capture:
    """One exposure; bodies as a client will read them, but for their times."""

    number: int
    t_ns: int
    bodies: tuple[Pose, ...]


class Cameras:
    """Exposes at the configured rate from ``t_start_ns``."""

    def __init__(self, config: MocapConfig, noise: NoiseSource, t_start_ns: int) -> None:
        self.fault_state: MocapFaultState = HEALTHY_MOCAP  # what is wrong with the tracking
        self.next_ns = t_start_ns  # the next exposure
        self._config = config
        self._noise = noise
        self._t_start_ns = t_start_ns
        self._exposures = 0
        self._number = 0
        self._last: Pose | None = None

    def set_fault_state(self, faults: MocapFaultState) -> None:
        """Be in this condition; with a server that restarts, frame numbers begin again."""
        self._number = 0 if faults.restart and not self.fault_state.restart else self._number
        self.fault_state = faults

    def captures(self, car: SimCar) -> Iterator[Capture]:
        """Exposures up to the car's time that are to be sent."""
        while self.next_ns <= car.t_ns:
            t_ns = self.next_ns
            self._exposures += 1
            self.next_ns = self._t_start_ns + self._exposures * _NS // self._config.rate_hz
            if self._exposures % self.fault_state.every == 0:
                self._number += 1
                yield Capture(self._number, t_ns, self._bodies(car, t_ns))

    def _bodies(self, car: SimCar, t_ns: int) -> tuple[Pose, ...]:
        config, faults = self._config, self.fault_state
        seen = car.observe_pose(t_ns)
        true = seen.x, seen.y, seen.yaw
        others = [*config.bystanders]
        own = self._displace(true, t_ns)
        if faults.swap or faults.impostor:
            own = others[0].pose if others else _IMPOSTOR
        if faults.swap and others:
            others[0] = others[0]._replace(pose=true)
        bodies = [] if faults.absent else [self._own(own)]
        return (*bodies, *(self._body(other.name, other.pose) for other in others))

    def _displace(self, pose: Planar, t_ns: int) -> Planar:
        """Faults of the tracked place and heading."""
        faults = self.fault_state
        if not (faults.jump or faults.drift or faults.flip):
            return pose
        shift = faults.jump + faults.drift * (t_ns - faults.since_ns) / _NS
        flipped = faults.flip == "always" or (faults.flip == "alternate" and self._number % 2)
        return pose[0] + shift, pose[1], pose[2] + (math.pi if flipped else 0.0)

    def _own(self, pose: Planar) -> Pose:
        """The car's body, with faults of the pose itself."""
        faults, last = self.fault_state, self._last
        if last is not None and (faults.frozen or faults.invalid):
            return changed(last, tracking_valid=not faults.invalid)
        body = self._body(self._config.body, pose)
        self._last = body
        if faults.invalid:
            body = changed(body, tracking_valid=False)
        if faults.mean_error:
            body = changed(body, mean_error=self._config.mean_error + faults.mean_error)
        if faults.negative and self._number % 2:
            w, x, y, z = body.quaternion
            body = changed(body, quaternion=(-w, -x, -y, -z))
        return _garble(body, faults.garble) if faults.garble else body

    def _body(self, name: str, pose: Planar) -> Pose:
        config, noise = self._config, self._noise
        sd = config.position_noise
        x, y, yaw, height = noise.normals(4)
        place = pose[0] + sd * x, pose[1] + sd * y, pose[2] + config.yaw_noise * yaw
        position, quaternion = make_body_pose(config.frame, *place, config.height + sd * height)
        if config.tilt_noise:
            tilt = 0.5 * config.tilt_noise
            ahead, aside = noise.normals(2)
            quaternion = _tilt(quaternion, tilt * ahead, tilt * aside, config.frame.up)
        scale = self.fault_state.scale
        if scale != 1.0:
            position = (scale * position[0], scale * position[1], scale * position[2])
        return Pose(name, None, None, None, 0, position, quaternion, config.mean_error)


def _tilt(q: Quat, a: float, b: float, up: str) -> Quat:
    """Turn a body by the small half-angles ``a``, ``b`` about its own two level axes."""
    w, x, y, z = q
    n = 1.0 - 0.5 * (a * a + b * b)  # q (n, a, b, 0) to second order, or (n, a, 0, b) with y up
    b, c = (b, 0.0) if up == "z" else (0.0, b)
    return (
        n * w - a * x - b * y - c * z,
        n * x + a * w + c * y - b * z,
        n * y + b * w + a * z - c * x,
        n * z + c * w + b * x - a * y,
    )


def _garble(body: Pose, how: str) -> Pose:
    """A pose that is none."""
    number = math.nan if how == "nan" else 0.0
    return changed(body, position=(number,) * 3, quaternion=(number,) * 4)
