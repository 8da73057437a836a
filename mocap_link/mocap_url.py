"""The one string that names a mocap source: `natnet://`, `vrpn://`, `ros2:///` or `zenoh:`."""

import re
from dataclasses import dataclass, replace
from urllib.parse import parse_qsl, unquote, urlsplit

from steerd.mocap_link.frame import FrameConfig

DEFAULT_PORTS = {"natnet": 1510, "vrpn": 3883}
_FORMS = "natnet://HOST[:PORT]/BODY?up=y, vrpn://HOST[:PORT]/BODY, ros2:///TOPIC or zenoh:KEY"
_ON_BUS = {
    "zenoh": (
        r"([^/]+(?:/[^/]+)*)",
        "a zenoh key is like zenoh:lab/pose/car, without outer slashes",
    ),
    "ros2": (r"///([A-Za-z_]\w*(?:/[A-Za-z_]\w*)*)", "a topic is like ros2:///pf/pose/odom"),
}
"""What follows the colon where poses come over the bus, and what is right."""


@dataclass(frozen=True, slots=True)
class MocapUrl:
    """A parsed source address."""

    scheme: str  # `natnet`, `vrpn`, `ros2` or `zenoh`
    host: str = ""  # server name or address; empty for the bus
    port: int = 0  # command port (NatNet) or TCP port (VRPN); 0 for the bus
    body: str = ""  # body name, or `id:42` (NatNet); empty for the bus
    key: str = ""  # on the bus: a key expression (zenoh), or a topic without its domain (ros2)
    up: str | None = None  # the vendor's up axis, `y` or `z`; None leaves it to the configuration
    # True or False forces it; None follows what the server says (NatNet)
    unicast: bool | None = None
    interface: str | None = None  # local address that joins the multicast group; None derives it

    def apply(self, frame: FrameConfig) -> FrameConfig:
        """The frame with what the address says of it: the up axis, and metres where it is ROS.

        Raises:
            ValueError: the up axis contradicts the body's forward axis.
        """
        units = "m" if self.scheme == "ros2" else frame.units
        return replace(frame, up=self.up or frame.up, units=units)


def parse_mocap_url(text: str) -> MocapUrl:
    """Parse a mocap address.

    Raises:
        ValueError: the text does not name a source; the message says what is wrong with it.
    """
    try:
        return _parse(text)
    except ValueError as error:
        raise ValueError(f"mocap address {text!r}: {error}") from None


def _parse(text: str) -> MocapUrl:
    scheme, _, rest = text.partition(":")
    if scheme in _ON_BUS:
        return _parse_key(scheme, rest)
    if scheme not in DEFAULT_PORTS or not rest.startswith("//"):
        raise ValueError(f"expected {_FORMS}")
    parts = urlsplit(text)
    try:
        port = parts.port
    except ValueError:
        raise ValueError("the port must be a number to 65535") from None
    body = unquote(parts.path.removeprefix("/"))
    if not parts.hostname:
        raise ValueError("no host")
    if not body:
        raise ValueError(f"no body; name it as in {scheme}://HOST/car")
    if body.startswith("id:") and scheme != "natnet":
        raise ValueError("only NatNet bodies have ids; give the name")
    if body.startswith("id:") and not body[3:].isdecimal():
        raise ValueError(f"{body!r} is not an id; expected id:NUMBER")
    options = _parse_options(scheme, parts.query)
    up, unicast = options.get("up"), options.get("unicast")
    return MocapUrl(
        scheme,
        parts.hostname,
        DEFAULT_PORTS[scheme] if port is None else port,
        body,
        up=up,
        unicast=None if unicast is None else unicast == "1",
        interface=options.get("interface"),
    )


def _parse_key(scheme: str, rest: str) -> MocapUrl:
    form, right = _ON_BUS[scheme]
    match = re.fullmatch(form, rest, re.ASCII)
    if match is None:
        raise ValueError(right)
    return MocapUrl(scheme, key=match[1], up="z" if scheme == "ros2" else None)


def _parse_options(scheme: str, query: str) -> dict[str, str]:
    allowed: dict[str, tuple[str, ...]] = {"up": ("y", "z")}
    if scheme == "natnet":
        allowed |= {"unicast": ("0", "1"), "interface": ()}
    options = dict(parse_qsl(query, keep_blank_values=True))
    for name, value in options.items():
        if name not in allowed:
            names = ", ".join(sorted(allowed))
            raise ValueError(f"unknown option {name!r}; known: {names}")
        if allowed[name] and value not in allowed[name]:
            raise ValueError(f"{name} must be {' or '.join(allowed[name])}, not {value!r}")
        if not value:
            raise ValueError(f"option {name!r} has no value")
    return options
