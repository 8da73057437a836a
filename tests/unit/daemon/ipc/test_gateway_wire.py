"""Requests as packets: name and message return; what is no request has an empty name."""

import pytest

from steerd.daemon.ipc.gateway_wire import pack_request, unpack_request


@pytest.mark.parametrize("data", [b"", b"x", b"\0\0", bytes(range(256))])
def test_a_request_returns_as_it_was(data):
    assert unpack_request(pack_request("operator", data)) == ("operator", data)


@pytest.mark.parametrize("packet", [b"", b"operator", b"\xff" * 9])
def test_a_packet_without_a_name_is_no_request(packet):
    assert unpack_request(packet) == ("", b"")
