"""Thresholds: defaults of `docs/reference/safety-requirements.md#s4`, bounds no car file lifts."""

from math import inf, nan, nextafter, radians

import msgspec
import pytest

from steerd.controller.limits import LimitError
from steerd.daemon.settings.thresholds import BOUNDS, Thresholds, check_bounds

SQUARE = ((-2.0, -2.0), (2.0, -2.0), (2.0, 2.0), (-2.0, 2.0))


@pytest.mark.parametrize("name", BOUNDS)
def test_thresholds_hold_their_bounds_exactly(name):
    bound = BOUNDS[name]
    for value in (bound.low, bound.high):
        assert getattr(Thresholds(**{name: value}), name) == value
    for value in (nextafter(bound.low, -inf), nextafter(bound.high, inf), nan):
        with pytest.raises(LimitError, match=f"^{name} = "):
            Thresholds(**{name: value})


def test_fence_must_be_a_polygon():
    for fence in (((0.0, 0.0), (1.0, 0.0)), (*SQUARE[:2], (nan, 0.0))):
        with pytest.raises(LimitError, match="fence needs"):
            Thresholds(fence=fence)
    assert Thresholds(fence=SQUARE[:3]).fence == SQUARE[:3]


def test_units_and_ranges_are_those_of_the_annotations():
    assert BOUNDS["jump_speed"] == (1.0, 8.0, "m/s")
    assert BOUNDS["out_queue"] == (64, 256, "B")
    for name, bound in BOUNDS.items():
        with pytest.raises(msgspec.ValidationError):
            msgspec.convert({name: bound.high + 1}, Thresholds)


def test_numbers_of_a_table_are_checked_before_they_are_converted():
    check_bounds({"jump_speed": 8, "fence": [], "deadman": False, "late": True, "unknown": 1e9})
    with pytest.raises(LimitError, match=r"^jump_speed = 9 m/s is outside 1\.\.8 m/s: "):
        check_bounds({"jump_speed": 9})


def test_every_threshold_but_the_fence_is_bounded():
    names = set(Thresholds.__dataclass_fields__)
    assert names - set(BOUNDS) == {"fence"}
    assert Thresholds().yaw_step == radians(30)


def test_ceilings_are_these_and_changing_one_is_a_decision():
    """The bounds that keep a person in the lane safe, written a second time on purpose."""
    highest = {
        "mocap_blind": 0.30, "mocap_shortest": 0.05, "mocap_longest": 0.15, "freeze_frames": 10,
        "freeze_speed": 0.3, "invalid_frames": 10, "quaternion_tolerance": 0.05, "jump_speed": 8.0,
        "jump_margin": 0.10, "jump_frames": 5, "nis_frames": 10, "nis_share": 0.5,
        "sigma_position": 0.20, "telemetry": 0.15, "cell_hold": 1.0, "fet": 95, "motor": 110,
        "lateral": 0.6, "lateral_max": 1.0, "overspeed_ratio": 1.3, "overspeed_margin": 0.3,
        "overspeed_hold": 0.1, "mismatch_speed": 1.0, "mismatch_hold": 0.4, "blocked_hold": 2.0,
        "saturated_hold": 2.0, "follow_share": 0.3, "follow_noise": 8.0, "follow_steer": 0.08,
        "follow_hold": 0.1, "follow_distance": 0.15, "stop_lag": 0.3, "stop_window": 0.5,
        "lease": 0.3,
        "suspend_step": 0.05, "out_queue": 256, "out_ticks": 3, "late": 0.025, "late_run": 3,
        "late_share": 0.02, "guardian": 0.05, "recorder_full": 1.0, "gateway_full": 1.0,
    }  # fmt: skip
    assert {name: BOUNDS[name].high for name in highest} == highest
    lowest = {"cell": 3.1, "fence_delay": 0.1, "fence_margin": 0.1, "stop_share": 0.3}
    assert {name: BOUNDS[name].low for name in lowest} == lowest


def test_defaults_are_those_of_the_safety_page():
    th = Thresholds()
    assert (th.mocap_warn, th.mocap_blind) == (0.030, 0.30)
    assert (th.mocap_shortest, th.mocap_longest) == (0.05, 0.15)
    assert (th.freeze_warn, th.freeze_frames, th.invalid_frames, th.jump_frames) == (3, 5, 5, 3)
    assert (th.telemetry_warn, th.telemetry, th.lease_warn, th.lease) == (0.05, 0.1, 0.15, 0.3)
    assert (th.cell_warn, th.cell, th.cell_hold) == (3.5, 3.3, 0.5)
    assert (th.fet_warn, th.fet, th.motor_warn, th.motor) == (75, 85, 80, 95)
    assert (th.lateral_warn, th.lateral, th.lateral_hold, th.lateral_max) == (0.2, 0.3, 0.1, 0.6)
    assert (th.overspeed_ratio, th.overspeed_hold) == (1.15, 0.05)
    assert (th.mismatch_speed, th.mismatch_share, th.mismatch_hold) == (0.5, 0.3, 0.2)
    assert (th.blocked_current, th.blocked_speed, th.blocked_hold) == (0.5, 0.08, 1.0)
    assert (th.saturated, th.saturated_warn, th.saturated_hold) == (0.98, 0.5, 1.0)
    assert (th.stop_share, th.stop_window, th.suspend_step) == (0.5, 0.3, 0.05)
    assert (th.out_queue, th.out_ticks, th.guardian) == (256, 3, 0.05)
    assert (th.late, th.late_run, th.late_share) == (0.025, 3, 0.02)
    assert (th.recorder_full, th.gateway_full) == (1.0, 1.0)
