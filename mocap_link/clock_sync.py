"""Map a mocap server's clock onto the host's CLOCK_MONOTONIC: the time of validity of each pose.

No epoch is assumed: ticks count from boot (Motive), from 1970 or from power-up, at any frequency.
Ticks stay integers and are subtracted before anything is divided. Methods and figures:
`docs/reference/mocap-protocols.md#m5`.
"""

from collections import deque
from itertools import pairwise

from steerd.mocap_link.source import ClockKind, Pose

NS = 1_000_000_000
SKEW_MAX = 200e-6
"""No two quartz clocks differ by more; a fit that says so is noise."""

WINDOW_NS = 60 * NS


class _ClockMap:
    """`host = source_ns + offset + skew * (source_ns - x_ref)`, all relative to one origin.

    `skew` is the rate of the host's clock against the source's, minus 1; `resets` counts how often
    all was forgotten.
    """

    def __init__(self, frequency_hz: int) -> None:
        if frequency_hz <= 0:
            raise ValueError(f"clock frequency {frequency_hz} Hz")
        self.frequency_hz = frequency_hz
        self.resets = 0
        self._set_origin(0, 0)

    def _set_origin(self, ticks: int, host_ns: int) -> None:
        self._ticks0, self._host0 = ticks, host_ns
        self._x_ref = self._offset = self.skew = 0.0

    def _source_ns(self, ticks: int) -> int:
        return (ticks - self._ticks0) * NS // self.frequency_hz

    def _residual(self, x: int, host_ns: int) -> float:
        """What the map leaves of a point `x` [source ns], `host_ns`."""
        return host_ns - self._host0 - x - self._offset - self.skew * (x - self._x_ref)

    def to_host_ns(self, ticks: int) -> int:
        """Map a source time to CLOCK_MONOTONIC [ns]."""
        x = self._source_ns(ticks)
        return self._host0 + x + round(self._offset + self.skew * (x - self._x_ref))


class EchoClock(_ClockMap):
    """Two-way clock map from echo exchanges (Cristian's algorithm with a fitted skew).

    The server stamped between our sending and receiving, so each exchange bounds the offset to
    half its round trip. Exchanges within `rtt_slack_ns` of the best round trip enter a line fit
    whose slope has a prior of 0 +- 50 ppm: a burst of 100 ms says nothing about skew.
    """

    min_samples = 5
    rtt_slack_ns = 150_000
    step_slack_ns = 2_000_000
    _skew_prior = 50e-6
    _jitter_floor_ns = 20_000.0

    def __init__(self, frequency_hz: int) -> None:
        super().__init__(frequency_hz)
        self._samples: deque[tuple[int, int, int]] = deque()  # source ns, host mid ns, rtt ns
        self._rtt_min = 0

    @property
    def ready(self) -> bool:
        """Whether enough exchanges were made."""
        return len(self._samples) >= self.min_samples

    @property
    def sigma_ns(self) -> int:
        """Half the best round trip [ns]."""
        return self._rtt_min // 2

    def reset(self) -> None:
        """Forget everything: the server restarted or its clock stepped."""
        self._samples.clear()
        self.resets += 1

    def add(self, t_sent_ns: int, t_received_ns: int, server_ticks: int) -> None:
        """Take in one exchange; a stepped clock resets the map to this exchange."""
        rtt = t_received_ns - t_sent_ns
        if rtt < 0:
            return
        middle = t_sent_ns + rtt // 2
        if self._samples:
            off = self._residual(self._source_ns(server_ticks), middle)
            if abs(off) > rtt / 2 + self.step_slack_ns:
                self.reset()
        if not self._samples:
            self._set_origin(server_ticks, middle)
        self._samples.append((self._source_ns(server_ticks), middle, rtt))
        while self._samples[-1][1] - self._samples[0][1] > WINDOW_NS:
            self._samples.popleft()
        self._fit()

    def _fit(self) -> None:
        self._rtt_min = min(rtt for _, _, rtt in self._samples)
        limit = self._rtt_min + self.rtt_slack_ns
        good = [(x, m - self._host0 - x) for x, m, rtt in self._samples if rtt <= limit]
        n = len(good)
        x_mean = sum(x for x, _ in good) / n
        y_mean = sum(y for _, y in good) / n
        sxx = sum((x - x_mean) ** 2 for x, _ in good)
        sxy = sum((x - x_mean) * (y - y_mean) for x, y in good)
        jitter = max(self._jitter_floor_ns, self._rtt_min / 2)
        slope = sxy / (sxx + (jitter / self._skew_prior) ** 2)
        self._x_ref, self._offset = x_mean, y_mean
        self.skew = max(-SKEW_MAX, min(SKEW_MAX, slope))


class HullClock(_ClockMap):
    """One-way clock map: the lower hull of arrival minus source time.

    The fastest datagrams lie on a line whose slope is the skew; the rest lies above it. Minima of
    0.1 s buckets over 60 s are kept; once a second the hull edge above the mean time becomes the
    map. Below 10 s of data the slope is taken as 0, for a short hull's slope is noise. What
    remains is the smallest delay, a constant that `extra_latency_ns` stands for.

    `ready` says whether 2 s of data were seen.
    """

    bucket_ns = NS // 10
    refit_ns = NS
    warm_ns = 2 * NS
    skew_from_ns = 10 * NS
    step_ns = NS // 50

    def __init__(self, frequency_hz: int) -> None:
        super().__init__(frequency_hz)
        self._buckets: deque[tuple[int, int]] = deque()  # source ns, host - source [ns]
        self._bucket_end = self._next_fit = 0
        self._last_ticks: int | None = None
        self.ready = False

    @property
    def sigma_ns(self) -> int:
        """Spread of the bucket minima above the line [ns], mean."""
        if not self.ready:
            return NS
        above = [y - self._offset - self.skew * (x - self._x_ref) for x, y in self._buckets]
        return round(sum(above) / len(above))

    def reset(self) -> None:
        """Forget everything: the server restarted or its clock stepped."""
        self._buckets.clear()
        self._last_ticks = None
        self.ready = False
        self.resets += 1

    def add(self, source_ticks: int, t_arrival_ns: int) -> None:
        """Take in one datagram.

        A source time that goes back, or a delay 20 ms below the smallest ever seen, is a stepped
        clock and resets the map.
        """
        if self._last_ticks is not None and source_ticks < self._last_ticks:
            self.reset()
        x = self._source_ns(source_ticks)
        if self.ready and self._residual(x, t_arrival_ns) < -self.step_ns:
            self.reset()
        if self._last_ticks is None:
            self._set_origin(source_ticks, t_arrival_ns)
            x = 0
            self._bucket_end = t_arrival_ns
            self._next_fit = t_arrival_ns + self.warm_ns
        self._last_ticks = source_ticks
        y = t_arrival_ns - self._host0 - x
        if t_arrival_ns >= self._bucket_end:
            self._buckets.append((x, y))
            self._bucket_end = t_arrival_ns + self.bucket_ns
        elif y < self._buckets[-1][1]:
            self._buckets[-1] = (x, y)
        if t_arrival_ns >= self._next_fit:
            self._next_fit = t_arrival_ns + self.refit_ns
            self._fit(x)

    def _fit(self, now: int) -> None:
        while now - self._buckets[0][0] > WINDOW_NS:
            self._buckets.popleft()
        points = self._buckets
        self._x_ref = sum(x for x, _ in points) / len(points)
        span = points[-1][0] - points[0][0]
        slope = _hull_slope(list(points), self._x_ref) if span >= self.skew_from_ns else 0.0
        self.skew = max(-SKEW_MAX, min(SKEW_MAX, slope))
        self._offset = min(y - self.skew * (x - self._x_ref) for x, y in points)
        self.ready = True


def _hull_slope(points: list[tuple[int, int]], x: float) -> float:
    """Slope of the lower convex hull's edge over `x` (Andrew's monotone chain)."""
    hull: list[tuple[int, int]] = []
    for p in points:
        while len(hull) > 1:
            (ax, ay), (bx, by) = hull[-2], hull[-1]
            if (bx - ax) * (p[1] - ay) - (by - ay) * (p[0] - ax) > 0:
                break
            hull.pop()
        if hull and hull[-1][0] == p[0]:
            hull[-1] = min(hull[-1], p)
        else:
            hull.append(p)
    for (ax, ay), (bx, by) in pairwise(hull):
        if x <= bx:
            return (by - ay) / (bx - ax)
    return 0.0


DEFAULT_EXTRA_LATENCY_NS = {
    "natnet": 0,  # mid-exposure is on the wire and the echo is two-way
    "natnet2": 6_000_000,  # before 3.0: exposure to arrival, as measured on a wired 3.0 system
    "vrpn": 8_000_000,
    "zenoh": 0,
}


class SourceTiming:
    """Chooses between echo, hull and arrival for one source.

    A mapped sending time must lie at most 1 ms after and less than 50 ms before the arrival, or
    the map is suspect: the pose falls back to the next map, and 10 suspect poses in a row reset
    the map. The one-way map times a pose that is up to 150 ms late all the same: the network held
    it back, for a source time that goes back resets that map at once. Between mid-exposure and
    sending lie 50 ms at the most. When `echo.resets` rises, the session should measure echoes anew.

    Args:
        frequency_hz: ticks per second of the source's clock.
        extra_latency_ns: what the maps cannot see, subtracted from every time of validity.

    Attributes:
        echo: the two-way map, to be fed with exchanges; without any it is never in force.
    """

    early_ns = 1_000_000
    late_ns = 50_000_000
    lost_ns = 150_000_000
    suspects_to_reset = 10

    def __init__(self, frequency_hz: int, extra_latency_ns: int = 0) -> None:
        self.frequency_hz = frequency_hz
        self.extra_latency_ns = extra_latency_ns
        self.echo = EchoClock(frequency_hz)
        self.hull = HullClock(frequency_hz)
        self._suspects: dict[EchoClock | HullClock, int] = {}
        self._first_arrival_ns: int | None = None
        self._settled = False

    @property
    def ready(self) -> bool:
        """Whether poses are timed as well as this source ever will be.

        That is a ready map, or 2 s after which the source's stamps turned out to be useless.
        """
        return self._settled or self.hull.ready or self.echo.ready

    @property
    def sigma_ns(self) -> int | None:
        """Error bound of the best ready map [ns]; None while on arrival times."""
        if self.echo.ready:
            return self.echo.sigma_ns
        return self.hull.sigma_ns if self.hull.ready else None

    def reset(self) -> None:
        """Forget both maps: reconnect, restart, or a stepped clock."""
        self.echo.reset()
        self.hull.reset()
        self._suspects.clear()

    def time_pose(self, raw: Pose, *, learn: bool = True) -> tuple[int, ClockKind]:
        """Return the pose's time of validity [ns, CLOCK_MONOTONIC] and how it was found.

        `learn` False (a repeated or reordered frame) leaves the maps as they are.
        """
        if self._first_arrival_ns is None:
            self._first_arrival_ns = raw.t_arrival_ns
        self._settled = raw.t_arrival_ns - self._first_arrival_ns >= HullClock.warm_ns
        sent = raw.source_ticks if raw.transmit_ticks is None else raw.transmit_ticks
        if sent is None:
            return raw.t_arrival_ns - self.extra_latency_ns, ClockKind.ARRIVAL
        measured = sent if raw.source_ticks is None else raw.source_ticks
        # a server's own pipeline delay is known in ticks, whatever map is in force; ticks that
        # make it absurd must not carry the pose to a time that no clock has
        pipeline_ns = (sent - measured) * NS // self.frequency_hz
        pipeline_ns = min(max(0, pipeline_ns), self.late_ns)
        sent_ns, kind = self._map_sent(sent, raw.t_arrival_ns, learn)
        t_valid_ns = min(sent_ns, raw.t_arrival_ns) - pipeline_ns - self.extra_latency_ns
        return t_valid_ns, kind

    def _map_sent(self, ticks: int, t_arrival_ns: int, learn: bool) -> tuple[int, ClockKind]:
        if learn:
            self.hull.add(ticks, t_arrival_ns)
        one_way = self._try(self.hull, ticks, t_arrival_ns, learn)
        two_way = self._try(self.echo, ticks, t_arrival_ns, learn)
        if two_way is not None:
            return two_way, ClockKind.ECHO
        if one_way is not None:
            return one_way, ClockKind.HULL
        return t_arrival_ns, ClockKind.ARRIVAL

    def _try(
        self, clock: EchoClock | HullClock, ticks: int, t_arrival_ns: int, learn: bool
    ) -> int | None:
        if not clock.ready:
            return None
        t_ns = clock.to_host_ns(ticks)
        age_ns = t_arrival_ns - t_ns
        early, late = age_ns < -self.early_ns, age_ns >= self.late_ns
        if learn:
            suspects = self._suspects.get(clock, 0) + 1 if early or late else 0
            if suspects >= self.suspects_to_reset:
                suspects = 0
                clock.reset()
            self._suspects[clock] = suspects
        # Delayed poses come all at once, and only their stamps distinguish them: at the
        # time of arrival each would be a jump from the one before.
        delayed = clock is self.hull and age_ns < self.lost_ns
        return None if early or (late and not delayed) else t_ns
