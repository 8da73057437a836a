"""Flags of the runner as findings of its watchdogs."""

import pytest

from steerd.daemon.loop.findings import WATCHDOGS
from steerd.daemon.loop.flags import Flag, make_reported_findings

NAMES = {
    Flag.SERIAL_FAULT: "W8", Flag.GUARDIAN_LOST: "W16", Flag.GUARDIAN_TRIPPED: "W15",
    Flag.RECORDER_LOST: "W26", Flag.GATEWAY_LOST: "W27", Flag.EXCEPTION: "W29",
    Flag.SUSPENDED: "W28", Flag.REBOOTED: "W12",
}  # fmt: skip


def bits_of_flag():
    return [value for name, value in vars(Flag).items() if name.isupper()]


def test_every_flag_is_one_bit_of_its_own():
    bits = bits_of_flag()
    assert sorted(bits) == [1 << k for k in range(len(bits))]


@pytest.mark.parametrize("flag", bits_of_flag())
@pytest.mark.parametrize("linked", [0, Flag.LINKED])
def test_each_flag_reports_its_watchdog_or_none(flag, linked):
    found = list(make_reported_findings(flag | linked))
    assert [finding.id for finding in found] == ([NAMES[flag]] if flag in NAMES else [])
    assert all(finding.severity == WATCHDOGS[finding.id].severity for finding in found)
