"""Bytes: VESC packets and NatNet frames against pyvesc and natnet from PyPI; session files.

The other libraries are optional (`pip install --group bench`); without them their ratio is left
out. Every comparison is of the same bytes.
"""

import json
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from benchmarks.timing import Timed, timed

import numpy as np  # isort: skip

from steerd.mocap_link import natnet
from steerd.mocap_link.natnet_wire import TRACKING_VALID, Frame, RigidBody
from steerd.steer_bus import messages as m
from steerd.steer_bus import topics
from steerd.steer_bus.codec import decode, encode
from steerd.steer_bus.session import SessionWriter
from steerd.steer_bus.session_read import open_session
from steerd.steer_bus.topics import make_session_topic
from steerd.vesc_link.commands import GetValues, SetErpm
from steerd.vesc_link.frames import FrameParser, encode_frame
from steerd.vesc_link.ids import FW_3_00
from steerd.vesc_link.packets import decode_reply, encode_command, encode_reply
from steerd.vesc_link.telemetry import Values

MINUTES, TICK_NS = 10, 10_000_000


def us(time: Timed) -> dict[str, float]:
    return {name: round(1e6 * value, 3) for name, value in time._asdict().items()}


def vesc() -> dict[str, Any]:
    """Encode a speed order, encode a poll, decode old firmware's telemetry (pyvesc's)."""
    measured = ("temp_fet_c", "motor_current", "input_current", "duty", "input_voltage")
    counted = {"erpm": 4321, "tachometer": 1000, "tachometer_abs": 2000, "fault": 0}
    values = Values(**dict.fromkeys(measured, 1.0), **counted)
    reply = encode_frame(encode_reply(values, FW_3_00))

    def receive() -> Any:
        (payload,) = FrameParser().feed(reply, 0)
        return decode_reply(payload, FW_3_00)

    ours = {
        "speed order, encode": lambda: encode_frame(encode_command(SetErpm(4321.0), FW_3_00)),
        "poll, encode": lambda: encode_frame(encode_command(GetValues(), FW_3_00)),
        "telemetry, decode": receive,
    }
    theirs: dict[str, Any] = {}
    try:
        import pyvesc

        theirs = {
            "speed order, encode": lambda: pyvesc.encode(pyvesc.SetRPM(4321)),
            "poll, encode": lambda: pyvesc.encode_request(pyvesc.GetValues),
            "telemetry, decode": lambda: pyvesc.decode(reply),
        }
        assert theirs["speed order, encode"]() == ours["speed order, encode"]()
        assert theirs["telemetry, decode"]()[0].rpm == receive().erpm == 4321
    except ImportError:
        pass
    return compared(ours, theirs)


def mocap() -> dict[str, Any]:
    body = RigidBody(1, (1.0, 0.1, 2.0), (0.0, 0.0, 0.0, 1.0), 5e-4, TRACKING_VALID)
    data = natnet.encode(Frame(1, (body,), timestamp=1.0), (3, 1))
    ours = {"frame, decode": lambda: natnet.decode(data, (3, 1))}
    theirs: dict[str, Any] = {}
    try:
        from natnet.data_frame import DataFrame
        from natnet.packet_buffer import PacketBuffer
        from natnet.version import Version
    except ImportError:
        return compared(ours, theirs)

    def read() -> Any:
        buffer = PacketBuffer(data)
        buffer.pointer = 4
        return DataFrame.read_from_buffer(buffer, Version(3, 1))

    assert read().rigid_bodies[0].id_num == 1
    return compared(ours, {"frame, decode": read})


def bus() -> dict[str, Any]:
    """The bus's own message, against msgspec's MessagePack of the same numbers."""
    import msgspec

    state = make_state(0)
    data = encode(state)
    names = [f.name for f in msgspec.structs.fields(m.StateMessage) if f.name != "header"]
    numbers = {name: getattr(state, name) for name in names}
    packed = msgspec.msgpack.encode(numbers)
    return compared(
        {
            "state, encode": lambda: encode(state),
            "state, decode": lambda: decode(m.StateMessage, data),
        },
        {
            "state, encode": lambda: msgspec.msgpack.encode(numbers),
            "state, decode": lambda: msgspec.msgpack.decode(packed),
        },
    )


def compared(ours: dict[str, Any], theirs: dict[str, Any]) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name, call in ours.items():
        found[name] = {"us": us(timed(call))}
        if name in theirs:
            found[name]["other_us"] = us(timed(theirs[name]))
    return found


def make_state(t_ns: int) -> Any:
    """A state message with every number set."""
    from dataclasses import fields

    values = {f.name: 1 if f.type in ("int", int) else 0.5 for f in fields(m.StateMessage)}
    header = m.make_header(t_ns, m.WORLD)
    kinds = {f.name: f.type for f in fields(m.StateMessage)}
    whole = {name: int(values[name]) for name in values if _is_whole(kinds[name])}
    return m.StateMessage(**{**values, **whole, "header": header})


def _is_whole(kind: Any) -> bool:
    return getattr(kind, "__origin__", None) is int


def session() -> dict[str, Any]:
    """Write ten minutes of what a tick writes, count it back, read it into arrays."""
    ticks = MINUTES * 6000
    state = encode(make_state(1))
    tick = encode(m.Tick(m.make_header(1, m.WORLD), 1, 2, 3, 4, 0))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "long.mcap"
        names = [make_session_topic("car1", t) for t in (topics.STATE, topics.TICK)]
        writer = SessionWriter(path, dict(zip(names, (m.StateMessage, m.Tick), strict=True)), {})
        began = time.process_time()
        for k in range(ticks):
            writer.write(names[0], state, k * TICK_NS)
            writer.write(names[1], tick, k * TICK_NS)
        writer.finish({"reason": "bench"})
        wrote = time.process_time() - began
        began = time.perf_counter()
        read = open_session(path)
        columns = [read.columns(cls) for cls in (m.StateMessage, m.Tick)]
        opened = time.perf_counter() - began
        began = time.perf_counter()
        raw = sum(1 for _ in _plain_reader(path))
        plain = time.perf_counter() - began
        kept = sum(len(c["header.stamp"]) if "header.stamp" in c else len(next(iter(c.values())))
                   for c in columns)  # fmt: skip
        size = path.stat().st_size
    return {
        "messages": 2 * ticks, "kept": kept, "raw": raw, "megabytes": round(size / 1e6, 2),
        "write_per_s": round(2 * ticks / wrote), "open_s": round(opened, 3),
        "mcap_reader_s": round(plain, 3),
    }  # fmt: skip


def _plain_reader(path: Path) -> Any:
    """The mcap package's own reader, message by message, undecoded."""
    from mcap.reader import make_reader

    with path.open("rb") as file:
        yield from make_reader(file).iter_messages()


def main() -> int:
    np.seterr(all="raise")
    print(json.dumps({"vesc": vesc(), "mocap": mocap(), "bus": bus(), "session": session()}))
    return 0


if __name__ == "__main__":
    sys.exit(main())
