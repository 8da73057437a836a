"""The known frames against the simulated VESC, in every firmware it can be."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from steerd.vesc_link.frames import FrameParser
from steerd.vesc_link.ids import PROFILES, SINCE, CommandId, Firmware, command_id
from steerd.vesc_link.packets import decode_reply

SPEC: dict[str, Any] = json.loads(
    (Path(__file__).parents[2] / "vesc_link" / "vesc_vectors.json").read_text()
)
REQUESTS = [v for v in SPEC["vectors"] if v["dir"] == "host->vesc"]
ANSWERED = {
    CommandId.FW_VERSION, CommandId.GET_VALUES, CommandId.GET_VALUES_SELECTIVE,
    CommandId.GET_APPCONF, CommandId.GET_IMU_DATA, CommandId.GET_MCCONF_TEMP,
}  # fmt: skip


@pytest.mark.parametrize("firmware", PROFILES, ids=str)
def test_each_known_request_gets_its_reply_and_nothing_else(
    make_host: Callable[..., Any], firmware: Firmware
) -> None:
    requested = 0
    for vector in REQUESTS:
        host = make_host(firmware=firmware)
        host.world.serial_write(0, bytes.fromhex(vector["frame"]))
        payload = bytes.fromhex(vector["payload"])
        number = command_id(payload[0], firmware)
        if number is CommandId.REBOOT:
            assert host.world.serial_name is None
            continue
        replies = host.parser.feed(host.world.serial_read(2_000_000), 0)
        known = number is not None and firmware >= SINCE.get(number, Firmware(0, 0))
        if known and number in ANSWERED:
            requested += 1
            (reply,) = replies
            assert reply[0] == payload[0]
            assert decode_reply(reply, firmware) is not None
            if number is CommandId.GET_VALUES_SELECTIVE:
                assert reply[1:5] == payload[1:5]  # the mask comes back as it was requested
        else:
            acked = known and number is CommandId.SET_MCCONF_TEMP
            assert replies == ([payload[:1]] if acked else []), vector["name"]
    assert requested >= 2


def test_streams_of_the_real_parser_are_taken_in_alike(make_host: Callable[..., Any]) -> None:
    for stream in SPEC["streams"]:
        host = make_host(timeout_ms=0)
        seen: list[bytes] = []
        host.world.vesc._obey = lambda t_ns, payload, seen=seen: seen.append(payload)
        for byte in bytes.fromhex(stream["bytes"]):
            host.world.serial_write(0, bytes((byte,)))
        assert [p.hex() for p in seen] == stream["payloads"], stream["name"]
        assert isinstance(host.world.vesc._parser, FrameParser)
