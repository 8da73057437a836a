"""Texts of the watchdogs, to the letter, and their summary for the supervisor."""

from dataclasses import asdict
from math import inf, nan

import pytest

from steerd.daemon.loop.findings import (
    WATCHDOGS,
    Severity,
    advise_simulation,
    make_finding,
    make_unknown,
    summarise,
)
from steerd.daemon.loop.transitions import Fact, SupervisorState
from steerd.daemon.loop.watchdogs import WatchdogState, step_watchdogs
from steerd.daemon.loop.watchdogs_pose import PoseWatch
from steerd.daemon.settings.thresholds import Thresholds
from steerd.steer_bus.quick_values import changed
from tests.unit.daemon.loop.watching import CALM

TH = Thresholds()
S = 10**9
SQUARE = ((-5.0, -5.0), (5.0, -5.0), (5.0, 5.0), (-5.0, 5.0))


def said(seconds=0.0, th=TH, **changes):
    """(id, text) of all findings, at once or after a condition was held for so long."""
    memory, found = step_watchdogs(th, WatchdogState(), changed(CALM, **changes))
    if seconds:
        end = changed(CALM, **{**changes, "t_ns": CALM.t_ns + round(seconds * S)})
        _, found = step_watchdogs(th, memory, end)
    return [(finding.id, finding.text) for finding in found]


@pytest.mark.parametrize(
    ("seconds", "changes", "id", "expected"),
    [
        (0.0, {"mocap_age": 4.0}, "W1", "no good frame for 4000 ms (limit 150 ms)"),
        (0.0, {"mocap_age": 2.0, "speed": 4.0}, "W1", "no good frame for 2000 ms (limit 75 ms)"),
        (0.0, {"pose": PoseWatch(frozen=4)}, "W2", "4 identical frames at 1.50 m/s"),
        (0.0, {"pose": PoseWatch(invalid=3)}, "W3", "3 bad frames in a row"),
        (0.0, {"pose": PoseWatch(jumps=2, jump_times=(1, 2))}, "W4", "2 jumps in a row, 2 lately"),
        (0.0, {"pose": PoseWatch(rejected=2, rejections=0b11011)}, "W5",
         "2 frames in a row rejected, 8% lately"),
        (0.0, {"sigma_position": 0.2}, "W6", "sigma 0.200 m, 0.6°"),
        (0.0, {"covariance_ok": False}, "W6", "covariance not positive definite"),
        (0.0, {"telemetry_age": 3.0}, "W7", "no reply for 3000 ms"),
        (0.2, {"status": 1, "state": SupervisorState.ARMED}, "W9", "status bit 0 stays set"),
        (0.0, {"status": 2}, "W10", "status bit 1 is set"),
        (0.0, {"fault_code": 4}, "W11", "fault code 4"),
        (0.0, {"fault_code": 10}, "W12", "fault code 10"),
        (0.0, {"cell_voltage": 3.4}, "W13", "3.40 V per cell"),
        (0.5, {"cell_voltage": 3.2}, "W13", "3.20 V per cell"),
        (0.0, {"fet_temperature": 78.0}, "W14", "transistors at 78 C"),
        (0.0, {"fet_temperature": 90.0}, "W14", "transistors at 90 C"),
        (0.0, {"motor_temperature": 84.0}, "W14", "motor at 84 C"),
        (0.0, {"lateral_error": -0.25}, "W17", "0.25 m"),
        (0.1, {"lateral_error": 0.35}, "W17", "0.35 m"),
        (0.0, {"heading_error": 0.6}, "W18", "34°"),
        (0.0, {"th": Thresholds(fence=SQUARE), "x": 4.9, "y": -1.25}, "W19",
         "the car at (4.90, -1.25) m needs 0.57 m to stop"),
        (0.1, {"speed_erpm": 2.5, "speed_mocap": 2.4}, "W20", "wheels 2.50, mocap 2.40 m/s"),
        (0.2, {"speed_mocap": 0.5}, "W21", "wheels 1.50, mocap 0.50 m/s"),
        (1.0, {"current_share": 0.75, "speed_erpm": 0.01, "speed_mocap": 0.0}, "W22",
         "75% of the current limit at 0.01 m/s"),
        (0.0, {"lease_age": 2.0}, "W25", "not renewed for 2000 ms"),
    ],
)  # fmt: skip
def test_text_of_a_trip_at_once_or_after_a_while(seconds, changes, id, expected):
    found = said(seconds, **changes)
    if not seconds:
        assert [name for name, _ in found] == [id]
    assert any(f": {expected}; " in text for name, text in found if name == id), found


def test_summary_takes_the_worst_text_and_all_bits():
    warn = make_finding("W7", "60 ms", Severity.WARN)
    soft, kill = make_finding("W13", "3.2 V"), make_finding("W10", "pressed")
    assert summarise(()) == (0, "")
    assert summarise((warn,)) == (0, "")
    assert summarise((warn, soft)) == (Fact.SOFT, soft.text)
    assert summarise((soft, kill, soft)) == (Fact.SOFT | Fact.KILLED, kill.text)


def test_every_watchdog_of_the_page_exists_with_advice():
    assert {f"W{k}" for k in range(1, 30)} <= set(WATCHDOGS)
    assert all(row.advice and row.severity > Severity.WARN for row in WATCHDOGS.values())
    with pytest.raises(KeyError):
        make_finding("W99", "")


@pytest.mark.parametrize(
    ("name", "id", "text"),
    [
        ("mocap_age", "W1", "no good frame yet"),
        ("sigma_position", "W6", "no estimate yet"),
        ("sigma_yaw", "W6", "no estimate yet"),
        ("telemetry_age", "W7", "no reply yet"),
        ("fet_temperature", "W14", "the transistors' temperature is not known yet"),
        ("lateral_error", "W17", "no lane error"),
        ("heading_error", "W18", "no heading error"),
        ("lease_age", "W25", "no operator yet"),
    ],
)
@pytest.mark.parametrize("value", [inf, nan])
def test_a_number_that_is_not_known_trips_and_is_not_shown(name, id, text, value):
    _, (found,) = step_watchdogs(TH, WatchdogState(), changed(CALM, **{name: value}))
    assert found.text == f"{id} {WATCHDOGS[id].name}: {text}", "no advice about what nobody knows"
    assert found.severity is WATCHDOGS[id].severity
    assert not found.known


def test_no_text_ever_shows_a_number_that_is_none():
    numbers = [name for name, value in asdict(CALM).items() if isinstance(value, float)]
    fence = Thresholds(fence=SQUARE)
    for state in SupervisorState:
        for value in (nan, inf, -inf):
            for names in (numbers, *([name] for name in numbers)):
                texts = said(2.0, fence, state=state, **dict.fromkeys(names, value))
                assert not [text for _, text in texts if "nan" in text or "inf " in text], names


def test_advice_in_simulation_is_about_the_simulation():
    found = make_finding("W7", "no reply for 120 ms")
    simulated = advise_simulation(found)
    assert "USB" not in simulated.text
    assert simulated.text.startswith("W7 telemetry stale: no reply for 120 ms; a simulated VESC")
    assert simulated.severity is found.severity
    other = make_finding("W13", "3.10 V per cell")
    assert advise_simulation(other) is other
    unknown = make_unknown("W7", "no reply yet")
    assert advise_simulation(unknown) is unknown
