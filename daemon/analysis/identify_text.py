"""The one screen that `steerd identify` prints."""

import re
import shlex
from collections import Counter
from collections.abc import Iterator
from math import degrees, isfinite, isnan
from pathlib import Path
from typing import NamedTuple

from steerd.daemon.analysis.hints import complete, name_all, simulate_with
from steerd.daemon.common.screen import WIDTH, wrap
from steerd.steer_bus.session_read import Session
from steerd.sysid.estimation.outcome import Outcome, Row
from steerd.sysid.inference.plain_car import POOR
from steerd.sysid.report.report import with_error

_COMMAND = ("next: steerd", "      steerd")
_CERTAIN = 10.0
"""A phase whose log-likelihood leads by more is identified [nats]."""


class Asked(NamedTuple):
    """What the screen depends on beside the outcome.

    Attributes:
        sessions: the drives.
        improved: whether the result predicts no worse than the start.
        axles_measured: whether the wheelbase was stated.
        written: the car file that was written.
    """

    sessions: tuple[Session, ...]
    improved: bool
    axles_measured: bool
    written: Path | None = None


def describe(outcome: Outcome, asked: Asked) -> str:
    """The screen; what to do next comes last."""
    parts = [_data(outcome), _parameters(outcome), _validation(outcome), _next(outcome, asked)]
    return "\n\n".join("\n".join(_fitted(lines)) for lines in map(list, parts) if lines)


def _fitted(lines: list[str]) -> Iterator[str]:
    """The lines broken between words where they are too wide, indented as their own label is."""
    for line in lines:
        if len(line) <= WIDTH or line.startswith(_COMMAND):  # a command to copy is never broken
            yield line
        else:
            yield from wrap(line, "", " " * _indent(line))


def _indent(line: str) -> int:
    """Where the text after a label begins."""
    label = re.match(r"(\w+: +|\w+ {2,}| +)", line)
    return label.end() if label else 0


def _data(outcome: Outcome) -> Iterator[str]:
    e = outcome.excitation
    yield f"data       {', '.join(outcome.sessions)}: {e.seconds:.0f} s, {e.distance:.0f} m"
    pace = f"{e.speed_low:.1f} to {e.speed_high:.1f} m/s, {e.lateral_accel:.1f} m/s² sideways"
    sides = f"left {e.left:.0%}, right {e.right:.0%}, steering {e.steer_rate:.2f} rad/s"
    yield f"driven     {pace}; {sides}"
    yield from (f"lacking    {what}" for what in e.lacking)
    windows = f"windows of {outcome.fit.horizon:.0f} s" if outcome.fit else ""
    how = {"ours": windows, "paper": "soft-DTW and chamfer by Adam"}
    effort = f", {len(outcome.searches)} starts" if outcome.searches else ""
    name = how.get(outcome.method, "the same loss by CMA-ES")
    for pulse in outcome.pulses:
        certain = "" if pulse.sure > _CERTAIN else " (weakly identifiable)"
        yield f"servo      {pulse.run}: 50 Hz pulses at {1e3 * pulse.phase:.0f} ms{certain}"
    for ramp in outcome.ramps:
        limit = f"ramp of {ramp.rate:.1f} m/s²" if ramp.rate else "no ramp"
        certain = "" if ramp.sure > _CERTAIN else " (weakly identifiable)"
        yield f"motor      {ramp.run}: {limit}{certain}"
    for jitter in outcome.log_jitters:
        found, corrected = jitter.describe()
        yield f"log        {found}"
        yield f"           {corrected}"
    for step in outcome.selected_effects:
        gain = f"gains {step.gain:.0f} nats"
        yield f"effect     {step.effect}: selected, these drives show it ({gain})"
    yield f"method     {outcome.method} ({name}{effort}), {outcome.seconds:.1f} s"


def _parameters(outcome: Outcome) -> Iterator[str]:
    """A line for each parameter that the drives identify; one sentence for all the others."""
    rows = {name: row for name, row in outcome.free_rows.items() if row.identifiable}
    width = max([13, *(len(name) + 1 for name in rows)])
    for name, row in rows.items():
        unit = "" if row.unit == "1" else row.unit
        yield f"{name:<{width}}{with_error(row.value, row.sd):>24} {unit:<7} {_word(row)}"
    if not outcome.unidentified:
        return
    helps = Counter(filter(None, outcome.unidentified.values())).most_common(1)
    most = f"; what would help most is {helps[0][0]}" if helps else ""
    yield f"These drives do not identify {', '.join(outcome.unidentified)}{most}."
    for c in (each for each in outcome.combinations if each.known):
        yield f"identifiable combination: {c.text} = {c.value:.6f} ± {c.sd:.6f} m"


def _word(row: Row) -> str:
    """Whether the drives moved the value, as far as its standard error shows."""
    return "changed" if abs(row.value - row.before) > 2.0 * (row.sd or 0.0) else "unchanged"


def _validation(outcome: Outcome) -> Iterator[str]:
    yield f"prediction of {outcome.held_out_of}"
    for h in outcome.held_out:
        a, b = h.after, h.before
        if isnan(a.position):
            yield f"   {a.horizon:.1f} s   no held-out drive is so long"
            continue
        yield (
            f"   {a.horizon:.1f} s   {a.position * 1e3:7.1f} mm {degrees(a.heading):6.2f}°   "
            f"(start {b.position * 1e3:.1f} mm {degrees(b.heading):.2f}°: {h.factor:.1f} x)"
        )
    yield from _regimes(outcome)


def _class(low: float, high: float) -> str:
    return f"to {high:g}" if isfinite(high) else f"above {low:g}"


def _regimes(outcome: Outcome) -> Iterator[str]:
    if len(outcome.regimes) < 2:
        return
    medians = [
        f"{1e3 * r.median:.{int(r.median < 0.01)}f} mm {_class(r.low, r.high)}"
        for r in outcome.regimes
    ]
    yield f"   median after 1 s by lateral acceleration [m/s²]: {', '.join(medians)}"


def _next(outcome: Outcome, asked: Asked) -> Iterator[str]:
    written, sessions = asked.written, asked.sessions
    yield from (f"note: {note}" for note in outcome.notes)
    if any("`--speed wheel`" in note for note in outcome.notes):
        yield "next: the same command with --speed wheel: these values explain a speed"
        yield "      that the car was not driven at; do not drive with them"
    elif not asked.improved:
        yield "next: these values predict no better than the start; keep the old car file"
        yield from _why(outcome, asked)
    elif not any(row.identifiable for row in outcome.free_rows.values()):
        yield "next: nothing is identifiable from these data; do not drive with these values:"
        yield "      keep the old car file, and do what the notes say"
    elif written is not None:
        yield f"next: {simulate_with(written, sessions)}"
        yield "      (on the car: its --port and --mocap for --sim --fast)"
        names = name_all([session.info().path for session in sessions])
        yield f"      steerd diagnose {names} --base {shlex.quote(str(written))}"
        yield "      (what this model still misses)"
    else:
        yield "next: repeat with -o car.toml, which writes a car file to drive with"


def _why(outcome: Outcome, asked: Asked) -> Iterator[str]:
    """What to try where the fit did not help."""
    poor = outcome.fit is None or max(outcome.fit.misfit.values(), default=0.0) > POOR
    if poor and not asked.axles_measured:
        yield "      measure the distance of the axles and give it as --wheelbase M: a longer"
        yield "      car, a smaller steering gain and a slower one are hard to distinguish"
    elif not poor and outcome.unidentified:
        text = "the start explains these drives, and they are too gentle to improve it: drive "
        yield f"      {complete(f'{text}`steerd collect --plan mixed`', asked.sessions)}"
