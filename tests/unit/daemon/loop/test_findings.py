"""Findings: their summary for the supervisor, advice, and numbers that nobody knows."""

from dataclasses import asdict
from math import inf, nan

import pytest

from steerd.daemon.loop import findings as fs
from steerd.daemon.loop.findings import WATCHDOGS, Severity, make_finding, summarise
from steerd.daemon.loop.transitions import Fact, SupervisorState
from steerd.daemon.settings.thresholds import Thresholds
from tests.unit.daemon.loop.watching import CALM, after, look

SQUARE = ((-5.0, -5.0), (5.0, -5.0), (5.0, 5.0), (-5.0, 5.0))


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
        ("mocap_age", "W1", "no good frame yet"), ("telemetry_age", "W7", "no reply yet"),
        ("sigma_position", "W6", "no estimate yet"), ("sigma_yaw", "W6", "no estimate yet"),
        ("fet_temperature", "W14", "the transistors' temperature is not known yet"),
        ("lateral_error", "W17", "no lane error"), ("heading_error", "W18", "no heading error"),
        ("lease_age", "W25", "no operator yet"),
    ],
)  # fmt: skip
@pytest.mark.parametrize("value", [inf, nan])
def test_a_number_that_is_not_known_trips_and_is_not_shown(name, id, text, value):
    (found,) = look(Thresholds(), **{name: value})
    assert found.text == f"{id} {WATCHDOGS[id].name}: {text}", "no advice about what nobody knows"
    assert found.severity is WATCHDOGS[id].severity
    assert not found.known


def test_no_text_ever_shows_a_number_that_is_none():
    numbers = [name for name, value in asdict(CALM).items() if isinstance(value, float)]
    fence = Thresholds(fence=SQUARE)
    for state in SupervisorState:
        for value in (nan, inf, -inf):
            for names in (numbers, *([name] for name in numbers)):
                found = after(2.0, fence, state=state, **dict.fromkeys(names, value))
                texts = [finding.text for finding in found]
                assert not [text for text in texts if "nan" in text or "inf " in text], names


def test_advice_in_simulation_is_about_the_simulation():
    found = make_finding("W7", "no reply for 120 ms")
    simulated = fs.advise_simulation(found)
    assert "USB" not in simulated.text
    assert simulated.text.startswith("W7 telemetry stale: no reply for 120 ms; a simulated VESC")
    assert simulated.severity is found.severity
    for other in (make_finding("W13", "3.10 V per cell"), fs.make_unknown("W7", "no reply yet")):
        assert fs.advise_simulation(other) is other
