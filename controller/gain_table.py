"""Feedback gains and steady-turn values over speed, looked up in plain floats on every tick."""

from typing import NamedTuple

N_LANE = 5  # errors fed back besides past references: e1, e1', e2, e2', wheel angle


class Turning(NamedTuple):
    """The car in a turn that keeps it on the path: per curvature, and per its change in time."""

    wheel: float  # road-wheel angle [rad m]
    wheel_change: float
    """[rad m s]; negative: in a tightening turn the wheel comes later than the curvature."""
    heading: float  # heading error e2 [rad m]: minus the slip of the turn
    heading_change: float  # [rad m s]


N_TURNING = len(Turning._fields)


class GainTable(NamedTuple):
    """Rows of numbers at equally spaced speeds; between them linear, outside held.

    A row is `(e1, e1_rate, e2, e2_rate, steer, past..., *Turning)`: gains [rad/m, rad s/m, 1, s,
    1, 1...], then the turn. `past` holds a gain for each reference still within the
    dead time, newest first.
    """

    speed_min: float  # speed of the first row [m/s]
    spacing: float  # [m/s]
    rows: tuple[tuple[float, ...], ...]

    @property
    def pasts(self) -> int:
        """How many past references are fed back."""
        return len(self.rows[0]) - N_LANE - N_TURNING

    @property
    def speeds(self) -> tuple[float, ...]:
        """Speeds of the rows [m/s]."""
        return tuple(self.speed_min + i * self.spacing for i in range(len(self.rows)))


def look_up(table: GainTable, speed: float) -> tuple[float, ...]:
    """The row at `speed` [m/s]."""
    rows = table.rows
    place = (speed - table.speed_min) / table.spacing
    if place <= 0.0:
        return rows[0]
    low = int(place)
    if low >= len(rows) - 1:
        return rows[-1]
    share = place - low
    return tuple([a + share * (b - a) for a, b in zip(rows[low], rows[low + 1], strict=True)])
