"""Frames that the real firmware's own C code confirmed byte for byte, decoded and built again.

All of them are framed; what a car's link does not use (`NOT_USED`) is no command and no reply.
Bytes and numbers are those of the firmware, the fields of replies have our names.
"""

import dataclasses
import json
from itertools import starmap
from pathlib import Path

import pytest

from steerd.vesc_link import commands as c
from steerd.vesc_link import telemetry as t
from steerd.vesc_link.frames import FrameParser, encode_frame
from steerd.vesc_link.ids import FW_3_00, FW_7_01, Firmware
from steerd.vesc_link.packets import decode_command, decode_reply, encode_command, encode_reply

SPEC = json.loads(Path(__file__).with_name("vesc_vectors.json").read_text())
VECTORS = {vector["name"]: vector for vector in SPEC["vectors"]}
NOT_USED = {9, 10, 20, 21, 31, 34, 47, 62, 63, 115, 128, 159}
"""Ids of what only VESC Tool, the CAN bus and other applications need."""
FOREIGN = [n for n, v in VECTORS.items() if int(v["payload"][:2], 16) in NOT_USED]
SETUP_REPLY = "get_values_setup_selective_reply"
"""To a mask with more than the uptime, which nobody asks for."""
USED = [name for name in VECTORS if name not in (*FOREIGN, SETUP_REPLY)]
REQUESTS = [name for name in USED if VECTORS[name]["dir"] == "host->vesc"]
REPLIES = [name for name in USED if VECTORS[name]["dir"] == "vesc->host"]

COMMANDS: dict[str, c.Command] = {
    "get_fw_version_req": c.GetFwVersion(), "get_values_req": c.GetValues(),
    "get_values_selective_req_drive": c.GetValuesSelective(0x0020A18F),
    "get_values_selective_req_sysid": c.GetValuesSelective(t.FAST_MASK),
    "get_values_selective_req_min": c.GetValuesSelective(0x180),
    "get_values_setup_selective_req": c.GetValuesSetupSelective(0x00202040),
    "set_duty_0.1": c.SetDuty(0.1), "set_duty_neg0.25": c.SetDuty(-0.25),
    "set_duty_1eneg05": c.SetDuty(1e-5), "set_current_5.5": c.SetCurrent(5.5),
    "set_current_neg12.345": c.SetCurrent(-12.345), "set_current_0.0": c.SetCurrent(0.0),
    "set_rpm_4614": c.SetErpm(4614), "set_rpm_neg2307": c.SetErpm(-2307), "set_rpm_0": c.SetErpm(0),
    "set_servo_0.5": c.SetServoPos(0.5), "set_servo_0.15": c.SetServoPos(0.15),
    "set_servo_0.85": c.SetServoPos(0.85), "set_servo_0.0": c.SetServoPos(0.0),
    "set_servo_1.0": c.SetServoPos(1.0), "alive": c.Alive(), "reboot": c.Reboot(),
    "get_imu_data_req_all": c.GetImuData(0xFFFF),
    "get_imu_data_req_acc_gyro": c.GetImuData(t.IMU_ACCEL_GYRO_MASK),
    "set_mcconf_temp_halfscale": c.SetMcConfTemp(
        0.5, 0.5, -9228, 9228, 0.004999999888241291, 0.949999988079071, -500, 500, -20, 40,
    ),
}  # fmt: skip


def expected_field(name, value):
    """A field as we call it, and its value in SI units."""
    match name[:-1]:
        case "acc_":
            return f"accel_{name[-1]}", value * t.STANDARD_GRAVITY
        case "gyro_":
            return name, value * 3.141592653589793 / 180
    parse = {"mask": lambda v: int(v, 16), "uuid": bytes.fromhex}.get(name, lambda v: v)
    return name, parse(value)


def firmware_of(name: str) -> Firmware:
    vector = VECTORS[name]
    if name.startswith("fw_version"):
        return Firmware(vector["decoded"]["major"], vector["decoded"]["minor"])
    marks = {"2.18": FW_3_00, "3.40": (3, 40), "3.55": (3, 55), "5.02": (5, 2)}
    return next((Firmware(*v) for mark, v in marks.items() if name.endswith(mark)), FW_7_01)


def payload_of(name: str) -> bytes:
    return bytes.fromhex(VECTORS[name]["payload"])


def test_every_request_vector_has_a_command_or_is_not_used():
    assert sorted(COMMANDS) == sorted(REQUESTS)


@pytest.mark.parametrize("name", [*FOREIGN, SETUP_REPLY])
def test_what_is_not_used_is_neither_command_nor_reply(name):
    assert decode_reply(payload_of(name)) is None
    assert name == SETUP_REPLY or decode_command(payload_of(name)) is None


@pytest.mark.parametrize("name", REQUESTS)
def test_command_encodes_to_the_frame_and_back(name):
    assert encode_frame(encode_command(COMMANDS[name])).hex() == VECTORS[name]["frame"]
    assert decode_command(payload_of(name)) == COMMANDS[name]


@pytest.mark.parametrize("name", REPLIES)
def test_reply_decodes_to_the_numbers_and_back(name):
    reply = decode_reply(payload_of(name))
    got = dataclasses.asdict(reply)
    told = {k: v for k, v in VECTORS[name]["decoded"].items() if k != "cmd"}
    for field, value in starmap(expected_field, told.items()):
        number = isinstance(value, float | int)
        assert got[field] == (pytest.approx(value, rel=1e-12) if number else value), field
    again = encode_frame(encode_reply(reply, firmware_of(name)))
    # 255 bytes are legal behind 0x03 too, though every sender writes the short header.
    short = encode_frame(payload_of(name)) if len(payload_of(name)) == 255 else b""
    assert again.hex() in (VECTORS[name]["frame"], short.hex())


@pytest.mark.parametrize("stream", SPEC["streams"], ids=lambda s: s["name"])
def test_stream_completes_at_the_firmware_byte_and_for_the_host_never_later(stream):
    data = bytes.fromhex(stream["bytes"])
    ends = {}
    for strict in (True, False):
        whole = FrameParser(strict=strict).feed(data, 0)
        assert [payload.hex() for payload in whole] == stream["payloads"]
        parser = FrameParser(strict=strict)
        got = [(p.hex(), n) for n, b in enumerate(data, 1) for p in parser.feed(bytes((b,)), 0)]
        assert [payload for payload, _ in got] == stream["payloads"]
        ends[strict] = [n for _, n in got]
    assert ends[True] == stream["completed_at_byte"]
    assert all(n <= late for n, late in zip(ends[False], ends[True], strict=True))
