"""How the simulated mocap system is built: cameras, server, clock, network."""

from dataclasses import dataclass, field
from typing import NamedTuple

from steerd.mocap_link.frame import FrameConfig

MULTICAST, TO_COMMAND, TO_DATA = "multicast", "command", "data"
"""Where NatNet frames go: the group, or a unicast client's command or data socket."""


class Bystander(NamedTuple):
    """Another tracked thing that stands in the room; world frame."""

    name: str
    id: int
    x: float
    y: float
    yaw: float


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
    transport: str = TO_COMMAND  # `MULTICAST`, `TO_COMMAND` or `TO_DATA`
    clock_hz: int = 10_000_000  # ticks per second of the server's clock (not 1e7 by law)
    epoch_ticks: int = 81_234_567_890  # its reading at the simulation's start
    skew_ppm: float = 15.0  # how fast it runs
    keepalive_ns: int = 10_000_000_000  # silence after which a unicast client is dropped

    def __post_init__(self) -> None:
        """Refuse what no server can be.

        Raises:
            ValueError: an unknown kind or transport, or a rate of zero.
        """
        if self.kind not in ("natnet", "vrpn"):
            raise ValueError(f"mocap kind {self.kind!r}: expected natnet or vrpn")
        if self.transport not in (MULTICAST, TO_COMMAND, TO_DATA):
            raise ValueError(f"transport {self.transport!r}: expected multicast, command or data")
        if self.rate_hz < 1 or self.clock_hz < 1:
            raise ValueError("rate_hz and clock_hz must be at least 1")
