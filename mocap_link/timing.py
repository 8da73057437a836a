"""Time of validity of each pose: the best clock map that passes its own sanity check."""

from steerd.mocap_link.clock_sync import NS, EchoClock, HullClock
from steerd.mocap_link.source import ClockKind, Pose

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
