"""The table of a set of drives."""

from collections.abc import Sequence
from typing import Any

import numpy as np

Row = dict[str, Any]
NOTICED_WITHIN, NAMED_WITHIN = 2.0, 6.0
"""A change, a name counts as in time within this [s]."""
_HEAD = (
    "| change | drives | noticed | by 2 s | median | named right by 6 s | median |"
    " wrong at the end | alone, right |\n| --- | --- | --- | --- | --- | --- | --- | --- | --- |"
)


def describe(rows: Sequence[Row]) -> str:
    """One line a change, and the drives without one."""
    names = list(dict.fromkeys(row["change"] for row in rows if row["change"]))
    lines = [_HEAD, *(_line(name, [r for r in rows if r["change"] == name]) for name in names)]
    quiet = [row for row in rows if not row["change"]]
    early = sum(row["false"] for row in rows if row["change"])
    lines += ["", f"Called before the change: {early} in {len(rows) - len(quiet)} drives."]
    if quiet:
        called = sum(row["false"] for row in quiet)
        peak = max(row["peak"] for row in quiet)
        lines.append(f"Without a change: {called} called in {len(quiet)} drives; peak {peak:.1f}.")
    cpu = np.median([row["cpu"] for row in rows])
    lines.append(f"Processor time per second of driving, median: {100.0 * cpu:.1f} %.")
    return "\n".join(lines)


def _line(name: str, rows: Sequence[Row]) -> str:
    noticed = np.array([row["noticed"] for row in rows], float)
    right = np.array([row["right"] for row in rows], float)
    final = [row["final"] for row in rows]
    wrong = sum(bool(said) and name not in said for said in final)
    alone = sum(said == [name] for said in final)
    in_time = int((right <= NAMED_WITHIN).sum())
    return (
        f"| {name} | {len(rows)} | {int(np.isfinite(noticed).sum())} |"
        f" {int((noticed <= NOTICED_WITHIN).sum())} | {_middle(noticed)} |"
        f" {in_time} | {_middle(right)} | {wrong} | {alone} |"
    )


def _middle(times: Any) -> str:
    """Median with what never came at the end, and in words where that is the middle."""
    middle = float(np.median(np.where(np.isfinite(times), times, np.inf)))
    return f"{middle:.1f} s" if np.isfinite(middle) else "never"
