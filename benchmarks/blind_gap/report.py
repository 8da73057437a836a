"""`docs/results/blind-test.md`: the scores against the targets, one table and two pictures."""

from collections.abc import Callable, Iterable, Iterator
from math import isnan
from pathlib import Path

from benchmarks.blind_gap.plots import plot_calibration, plot_confusion
from benchmarks.blind_gap.score import Rate, Scores


def _percent(value: float) -> str:
    return "-" if isnan(value) else f"{100 * value:.1f} %"


def _rate(r: Rate) -> str:
    if not r.total:
        return "-"
    low, high = (100 * bound for bound in r.interval)
    return f"{_percent(r.value)} ({r.hits}/{r.total}; {low:.0f} to {high:.0f})"


def _count(r: Rate) -> str:
    return f"{r.hits}/{r.total}" if r.total else "-"


def _number(value: float, digits: int = 1, unit: str = "") -> str:
    return "-" if isnan(value) else f"{value:.{digits}f}{unit}"


def _table(head: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    titles = list(head)
    lines = [titles, ["---"] * len(titles), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"


def _format_test(value: float, test: Callable[[float], bool]) -> str:
    return "-" if isnan(value) else ("yes" if test(value) else "no")


def _row(title: str, got: str, target: str, value: float, limit: float, upper: bool) -> list[str]:
    test = (lambda v: v <= limit) if upper else (lambda v: v >= limit)
    return [title, got, target, _format_test(value, test)]


def _share(title: str, r: Rate, limit: float, upper: bool = False) -> list[str]:
    sign = "≤" if upper else "≥"
    return _row(title, _rate(r), f"{sign} {100 * limit:.0f} %", r.value, limit, upper)


def _size(title: str, value: float, limit: float, unit: str = "") -> list[str]:
    return _row(title, _number(value, 1, unit), f"≤ {limit:g}{unit}", value, limit, True)


OFF = 0.1
"""Median relative error of a parameter from which an effect is listed."""
_STRONG, _GENTLE = "rich, medium and large", "gentle, all"
_TARGETED = ("all nulls", "both named", "at least one")
"""Shares that the rows with targets give already."""


def _targets(s: Scores) -> str:
    none = Rate(0, 0)
    wrong = next(r for name, r in s.outside.items() if name.startswith("confident"))
    counted = f" ({s.shrinkage.count} cases)"
    rows = [
        _share("false alarms on nulls", s.alarms["all nulls"], 0.02, upper=True),
        _share("detection, rich, medium", s.detection.get("rich, medium", none), 0.90),
        _share("detection, rich, large", s.detection.get("rich, large", none), 0.98),
        _share("top-1 given detected, rich, medium and large", s.naming[_STRONG], 0.95),
        _share(
            "family given detected, rich, medium and large", s.naming[f"{_STRONG}: family"], 0.98
        ),
        _share("set holds the truth, rich, medium and large", s.coverage[_STRONG], 0.98),
        _size("mean size of the set", s.set_size[_STRONG], 2.5),
        _share("gentle: top-1 given detected", s.naming[_GENTLE], 0.60),
        _share("gentle: set holds the truth", s.coverage[_GENTLE], 0.95),
        _share("pairs: both named", s.pairs["both named"], 0.75),
        _share("pairs: at least one named", s.pairs["at least one"], 0.95),
        _share("outside the library: confident wrong name", wrong, 0.05, upper=True),
        _size("parameter error, median", 100 * s.parameters.median, 5.0, " %"),
        _size("parameter error, 90th percentile", 100 * s.parameters.p90, 20.0, " %"),
        _size(f"shrinkage error, median{counted}", s.shrinkage.median, 5.0, " points"),
        _size(f"shrinkage error, 90th percentile{counted}", s.shrinkage.p90, 15.0, " points"),
        *_rest(s),
    ]
    return _table(("metric", "reached (counts; 95 % interval)", "target", "met"), rows)


def _rest(s: Scores) -> Iterator[list[str]]:
    """What no target names: each drive and severity, each block."""
    for row, found in s.detection.items():
        got = f"{_count(found)}; {_count(s.naming[row])}; {_number(s.set_size[row])}"
        yield [f"{row}: detected; first name right; set size", got, "", ""]
    blocks = {"nulls": s.alarms, "pairs": s.pairs, "outside": s.outside, "control": s.controls}
    for kind, rates in blocks.items():
        for title, r in rates.items():
            if title not in _TARGETED:
                yield [f"{kind}: {title}", _count(r), "", ""]


def _by_effect(s: Scores) -> str:
    """The effects that are not always detected, not always named first, or off in size."""
    found = {name: rates for name, rates in s.by_effect.items() if rates[0].total}
    unseen = [f"`{n}` {_count(d)}" for n, (d, _, _) in found.items() if d.hits < d.total]
    misnamed = [f"`{n}` {_count(f)}" for n, (_, f, _) in found.items() if f.hits < f.total]
    off = [
        f"`{n}` {_number(100 * e.median, 0, ' %')}"
        for n, (_, _, e) in found.items()
        if e.median > OFF
    ]
    return (
        f"Of {len(found)} effects, medium and large: not always detected"
        f" {', '.join(unseen) or 'none'}; not always named first {', '.join(misnamed) or 'none'};"
        f" off by more than {100 * OFF:.0f} % in the median {', '.join(off) or 'none'}.\n"
    )


def _points(value: float, interval: tuple[float, float]) -> str:
    return f"{100 * value:.1f} points ({100 * interval[0]:.1f} to {100 * interval[1]:.1f})"


def _calibration(s: Scores) -> str:
    """The confidences' figures; their bins are in the picture."""
    r = s.reliability
    if not r.count:
        return "No cause was named.\n"
    low, high = r.brier_interval
    return (
        f"First causes named: {r.count}, nulls and defects outside the library included. Expected"
        f" calibration error {_points(r.ece, r.ece_interval)}; confidences that were exactly right"
        f" would show {100 * r.ece_chance[0]:.1f} on average and {100 * r.ece_chance[1]:.1f} one"
        f" time in twenty. Brier score {r.brier:.3f} ({low:.3f} to {high:.3f}); always saying the"
        f" share of right names would score {r.brier_plain:.3f}.\n"
    )


def make_report(s: Scores, title: str, notes: Iterable[str], pictures: str) -> str:
    """The page as Markdown; `pictures` is the folder of the figures as seen from the page."""
    median, p90, longest = s.seconds
    kinds = ", ".join(f"{count} {kind}" for kind, count in s.kinds.items())
    parts = [
        f"# {title}\n",
        "Written by `python -m benchmarks.blind_gap score`; the protocol is in"
        " `benchmarks/blind_gap/README.md`.\n",
        "".join(f"- {note}\n" for note in notes)
        + f"- {s.cases} cases: {kinds}; {s.missing} without a verdict.\n"
        + f"- A diagnosis took {_number(median)} s in the median, {_number(p90)} s in 90 %,"
        + f" {_number(longest)} s at most.\n",
        _targets(s),
        _by_effect(s),
        _calibration(s),
        f"![calibration]({pictures}/blind-test-calibration.svg)\n\n"
        f"![confusion by family]({pictures}/blind-test-confusion.svg)\n",
    ]
    return "\n".join(parts)


def write_report(s: Scores, path: Path, title: str, notes: Iterable[str]) -> None:
    """Write page and pictures.

    Raises:
        OSError: the disk does not take them.
    """
    folder = path.parent / "img"
    folder.mkdir(parents=True, exist_ok=True)
    plot_calibration(s, folder / "blind-test-calibration.svg")
    plot_confusion(s, folder / "blind-test-confusion.svg")
    path.write_text(make_report(s, title, notes, folder.name))
