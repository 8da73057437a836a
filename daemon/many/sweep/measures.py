"""What a drive of a sweep is judged by, and the columns of its table."""

from collections.abc import Iterable, Sequence

from steerd.daemon.many.sweep.quantities import Quantity
from steerd.daemon.many.tables import Column
from steerd.daemon.many.units import FAILED

MEASURES = (
    Column("e1_rms", "number", "m", "lateral error as estimated, RMS after the approach"),
    Column("e1_p95", "number", "m", "lateral error as estimated, 95 % of the time below"),
    Column("e1_max", "number", "m", "lateral error as estimated, largest"),
    Column("true_e1_rms", "number", "m", "lateral error of the simulated car itself, RMS"),
    Column("true_e1_max", "number", "m", "lateral error of the simulated car itself, largest"),
    Column("e2_rms", "number", "rad", "heading error as estimated, RMS"),
    Column("lane_margin", "number", "m", "what the largest error leaves to the watchdog's bound"),
    Column("steer_margin", "number", "1", "share of the wheel angle never used"),
    Column("damping", "number", "1", "least damping of the designed loop with the drawn car"),
    Column("delay_margin", "number", "s", "dead time that the drawn car's loop still tolerates"),
)
"""Of a drive; missing where it was not driven beyond the approach."""
_HEAD = (
    Column("drive", "count", "", "number of the drive"),
    Column("seed", "count", "", "of draws and of the simulated hardware's noise"),
)
_ENDS = (
    Column("outcome", "text", "", "driven, stopped, refused (no design) or failed"),
    Column("watchdog", "text", "", "that stopped it"),
    Column("reason", "text", "", "why it was stopped, refused or failed"),
    Column("seconds", "number", "s", "driven"),
    Column("metres", "number", "m", "driven"),
)
DRIVEN, STOPPED, REFUSED = "driven", "stopped", "refused"
OUTCOMES = (DRIVEN, STOPPED, REFUSED, FAILED)


def list_columns(quantities: Iterable[Quantity]) -> Sequence[Column]:
    """The table's columns for what is varied."""
    varied = [
        Column(q.name, "text" if q.is_text else "number", q.unit, q.meaning) for q in quantities
    ]
    return (*_HEAD, *varied, *_ENDS, *MEASURES)
