"""Clock maps against synthetic servers with known truth; the real capture is played in `e2e`."""

from itertools import pairwise

import numpy as np
import pytest

from steerd.mocap_link.clock_sync import SKEW_MAX, EchoClock, HullClock, SourceTiming
from steerd.mocap_link.source import ClockKind, Pose

MS = 1_000_000
SECOND = 1000 * MS
T0 = 123_456_789_012_345  # host time at the start; nothing may depend on its size


class Truth:
    """A server clock: `ticks` of a host time, at any epoch, with any skew."""

    def __init__(self, hz: int, skew: float, epoch: int = 5_000_000_000_000) -> None:
        self.hz, self.skew, self.epoch = hz, skew, epoch

    def ticks(self, t_ns: int) -> int:
        return self.epoch + round((t_ns - T0) * (1 + self.skew) * self.hz / SECOND)


def pose(exposed: int | None, sent: int | None, arrival_ns: int) -> Pose:
    """A pose of a body at the origin, with its stamps."""
    return Pose("car", None, exposed, sent, arrival_ns, (0.0,) * 3, (1.0, 0.0, 0.0, 0.0))


def make_raw(truth: Truth, t_ns: int, pipeline_ns: int, network_ns: int) -> Pose:
    sent = t_ns + pipeline_ns
    return pose(truth.ticks(t_ns), truth.ticks(sent), sent + network_ns)


def echo(timing: SourceTiming, truth: Truth, t_ns: int, rng: np.random.Generator) -> None:
    there, back = (int(400_000 + rng.exponential(60_000)) for _ in range(2))
    timing.echo.add(t_ns, t_ns + there + back, truth.ticks(t_ns + there))


def run(timing: SourceTiming, truth: Truth, rng: np.random.Generator, seconds: float):
    """Drive `seconds` of 100 Hz frames and 2 Hz echoes: (error, kind) of each frame."""
    for i in range(20):
        echo(timing, truth, T0 + i * 5 * MS, rng)
    for i in range(round(seconds * 100)):
        t = T0 + 100 * MS + i * 10 * MS
        raw = make_raw(truth, t, 5_400_000, int(420_000 + rng.exponential(300_000)))
        estimate, kind = timing.time_pose(raw)
        yield estimate - t, kind
        if i % 50 == 0:
            echo(timing, truth, t + 8 * MS, rng)


@pytest.mark.parametrize(
    ("hz", "skew"), [(3_312_787, -40e-6), (10_000_000, 0.0), (1_000_000, 40e-6)]
)
def test_echo_is_within_a_tenth_of_a_millisecond(hz, skew):
    timing = SourceTiming(hz)
    out = list(run(timing, Truth(hz, skew), np.random.default_rng(1), 90.0))
    assert {kind for _, kind in out} == {ClockKind.ECHO}
    assert max(abs(error) for error, _ in out) < 0.3 * MS
    # the fit's window is 60 s: the slope is known to about a ppm by then
    assert timing.echo.skew == pytest.approx(-skew, abs=3e-6)
    assert 0.3 * MS < timing.echo.sigma_ns < 0.6 * MS


def test_negative_round_trips_are_ignored_and_unready_maps_say_so():
    clock = EchoClock(1000)
    clock.add(10, 5, 1)
    assert not clock.ready
    with pytest.raises(ValueError, match="0 Hz"):
        EchoClock(0)
    assert not HullClock(1000).ready
    assert HullClock(1000).sigma_ns == SECOND
    timing = SourceTiming(1000)
    timing.echo.add(0, 1, 2)  # one exchange is too few
    assert (timing.sigma_ns, timing.echo.resets) == (None, 0)


@pytest.mark.parametrize("skew", [-40e-6, 40e-6])
@pytest.mark.parametrize("jitter_ms", [0.3, 6.0])
def test_hull_keeps_only_the_smallest_delay(skew, jitter_ms):
    truth, rng = Truth(1_000_000, skew), np.random.default_rng(4)
    clock, errors = HullClock(truth.hz), []
    for i in range(9000):
        t = T0 + i * 10 * MS
        clock.add(truth.ticks(t), t + 6_100_000 + int(rng.exponential(jitter_ms * MS)))
        if i > 3000:
            errors.append(clock.to_host_ns(truth.ticks(t)) - t)
    assert np.mean(errors) == pytest.approx(6.1 * MS, abs=0.25 * MS)
    assert np.std(errors) < 0.1 * MS
    assert clock.skew == pytest.approx(-skew, abs=4e-6)
    assert abs(clock.skew) <= SKEW_MAX


def test_hull_restarts_when_source_time_goes_back():
    clock = HullClock(1_000_000)
    for i in range(300):
        clock.add(10**12 + i * 10_000, T0 + i * 10 * MS)
    assert clock.ready
    clock.add(5, T0 + 3001 * MS)
    assert not clock.ready
    assert clock.resets == 1


def test_one_way_step_drops_the_stamps_then_learns_anew():
    truth, timing = Truth(1_000_000, 0.0), SourceTiming(1_000_000, extra_latency_ns=6 * MS)
    kinds = []
    for i in range(1000):
        if i == 500:
            truth.epoch += truth.hz  # one second forward
        t = T0 + i * 10 * MS
        estimate, kind = timing.time_pose(make_raw(truth, t, 0, 6 * MS))
        assert abs(estimate - t) < 1 * MS
        kinds.append(kind)
    changes = [(i, b.value) for i, (a, b) in enumerate(pairwise(kinds), 1) if a != b]
    (_, hull), dropped, (again, last) = changes
    assert (hull, dropped, last) == ("hull", (500, "arrival"), "hull")
    assert 700 <= again <= 720


@pytest.mark.parametrize("sent", [5 * MS, 101 * MS, 2**64 - 1])
def test_arrival_subtracts_the_servers_pipeline_delay_but_no_more_than_a_pose_may_be_late(sent):
    timing = SourceTiming(1_000_000_000, extra_latency_ns=3 * MS if sent < 100 * MS else 0)
    late = 8 * MS if sent < 100 * MS else timing.late_ns
    assert timing.time_pose(pose(0, sent, T0)) == (T0 - late, ClockKind.ARRIVAL)


def test_without_stamps_arrival_it_is_and_no_sample_is_valid_after_it():
    timing = SourceTiming(1_000_000_000, extra_latency_ns=MS)
    for i in range(201):
        assert not timing.ready
        raw = pose(None, None, T0 + i * 10 * MS)
        assert timing.time_pose(raw) == (raw.t_arrival_ns - MS, ClockKind.ARRIVAL)
    assert timing.ready
    assert timing.sigma_ns is None
    timing, truth = SourceTiming(10_000_000), Truth(10_000_000, 0.0)
    for i in range(20):
        timing.echo.add(T0 + i, T0 + i, truth.ticks(T0) + 5000)  # 0.5 ms off
    raw = make_raw(truth, T0 + SECOND, 0, 0)
    estimate, _ = timing.time_pose(raw)
    assert estimate <= raw.t_arrival_ns
