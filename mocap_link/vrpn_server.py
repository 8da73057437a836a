"""VRPN server side without I/O: what the simulator's mocap device speaks over each connection."""

from __future__ import annotations

from steerd.mocap_link import vrpn

_TYPES = (vrpn.POSE_TYPE, vrpn.PING_TYPE, vrpn.PONG_TYPE)
_POSE_ID, _PONG_ID = 0, 2


class VrpnServer:
    """One connection's server: greets, names its bodies, answers pings, encodes poses.

    Feed what arrives into `receive`, send what it and the other methods return.

    Args:
        bodies: names of the bodies; more may come with `add_body`.
    """

    def __init__(self, bodies: tuple[str, ...]) -> None:
        self._bodies: list[str] = []
        self._buffer = bytearray()
        self._greeted = False
        self._peer_types: dict[int, str] = {}
        self._sequence = 0
        self._hello = vrpn.encode_cookie() + b"".join(
            vrpn.encode(vrpn.make_description(vrpn.TYPE_DESCRIPTION, i, name))
            for i, name in enumerate(_TYPES)
        )
        self._hello += b"".join(self.add_body(body) for body in bodies)

    def hello(self) -> bytes:
        """Return what to send as soon as a client connects."""
        return self._hello

    def add_body(self, name: str) -> bytes:
        """Enable another body, at any time; returns its description."""
        self._bodies.append(name)
        sender = len(self._bodies) - 1
        return vrpn.encode(vrpn.make_description(vrpn.SENDER_DESCRIPTION, sender, name))

    def pose(
        self,
        body: str,
        stamp_us: int,
        position: tuple[float, float, float],
        quaternion_wxyz: tuple[float, float, float, float],
    ) -> bytes:
        """Encode one pose [m]; `stamp_us` is on the server's clock."""
        w, x, y, z = quaternion_wxyz
        payload = vrpn.write_pose(vrpn.Pose(0, position, (x, y, z, w)))
        return self._message(_POSE_ID, self._bodies.index(body), stamp_us, payload)

    def receive(self, data: bytes, stamp_us: int) -> bytes:
        """Take in bytes from the client; returns the answers.

        Raises:
            VrpnError: the peer does not speak VRPN; close the connection.
        """
        self._buffer += data
        if not self._greeted:
            if len(self._buffer) < vrpn.COOKIE_SIZE:
                return b""
            vrpn.check_cookie(bytes(self._buffer[: vrpn.COOKIE_SIZE]))
            del self._buffer[: vrpn.COOKIE_SIZE]
            self._greeted = True
        messages, used = vrpn.decode_stream(self._buffer)
        del self._buffer[:used]
        return b"".join(self._answer(message, stamp_us) for message in messages)

    def _answer(self, message: vrpn.Message, stamp_us: int) -> bytes:
        if message.type == vrpn.TYPE_DESCRIPTION:
            self._peer_types[message.sender] = vrpn.read_description(message.payload)
        elif self._peer_types.get(message.type) == vrpn.PING_TYPE:
            return self._message(_PONG_ID, 0, stamp_us, b"")
        return b""

    def _message(self, kind: int, sender: int, stamp_us: int, payload: bytes) -> bytes:
        self._sequence += 1
        sec, usec = divmod(stamp_us, 1_000_000)
        return vrpn.encode(vrpn.Message(kind, sender, sec, usec, payload, self._sequence))
