"""What is shown of an identification: on a terminal, on a page, in a notebook's figure."""

from collections import Counter
from collections.abc import Iterator, Sequence
from math import degrees, isfinite, isnan
from typing import TYPE_CHECKING

from steerd.sysid.estimation.outcome import Outcome
from steerd.sysid.report.report import (
    SPACE,
    Card,
    Cell,
    Fold,
    Line,
    Report,
    Section,
    Table,
    with_error,
)

if TYPE_CHECKING:
    from steerd.sysid.report.drawing import Diagrams

IMPROVEMENT_MIN = 1.02  # a smaller factor is no improvement
_CERTAIN = 10.0  # a phase whose log-likelihood leads by more is identified [nats]


def make_report(outcome: Outcome, following: Sequence[Line] = ()) -> Report:
    """What an identification found; `following` ends the screen."""
    e = outcome.excitation
    driven = f"{e.seconds:.0f} s, {e.distance:.0f} m"
    pace = f"{e.speed_low:.1f} to {e.speed_high:.1f} m/s, {e.lateral_accel:.1f} m/s² sideways"
    return Report(
        title="The car identified from these drives",
        subject=", ".join(outcome.sessions),
        about=f"{driven}, {pace} · method {outcome.method}, {outcome.seconds:.1f} s",
        lead="What the drives say of the car, judged by drives that were not fitted.",
        sections=_sections(outcome),
        foot="Written by steerd identify. Frames are ISO 8855, angles positive to the left; "
        "sd is one standard error.",
        cards=list(_cards(outcome)),
        screen=[
            Line("data", f"{', '.join(outcome.sessions)}: {driven}"),
            *_data(outcome, pace),
            SPACE,
            *_parameters(outcome),
            SPACE,
            *_validation(outcome),
            SPACE,
            *(Line("note", note) for note in outcome.notes),
            *following,
        ],
        figures=_figures(outcome),
    )


def _cards(outcome: Outcome) -> Iterator[Card]:
    """The figures that are read first."""
    free = outcome.free_rows.values()
    count = sum(row.identifiable for row in free)
    yield Card("identifiable", f"{count} of {len(free)}", "free parameters, from these drives")
    for last in [h for h in outcome.held_out if not isnan(h.after.position)][-1:]:
        before, after = last.before, last.after
        better = last.factor >= IMPROVEMENT_MIN
        change = f"the error falls by a factor of {last.factor:.1f}" if better else "no improvement"
        figure = f"{1e3 * before.position:.1f} → {1e3 * after.position:.1f} mm"
        yield Card(f"off {after.horizon:g} s ahead, by start values → identified", figure, change)
        figure = f"{degrees(before.heading):.2f} → {degrees(after.heading):.2f}°"
        yield Card("off in heading", figure, "both on drives that were not fitted")


# -- the screen ------------------------------------------------------------------------------------


def _data(outcome: Outcome, pace: str) -> Iterator[Line]:
    e, fit = outcome.excitation, outcome.fit
    sides = f"left {e.left:.0%}, right {e.right:.0%}, steering {e.steer_rate:.2f} rad/s"
    yield Line("driven", f"{pace}; {sides}")
    yield from (Line("lacking", what) for what in e.lacking)
    weakly = " (weakly identifiable)"
    for pulse in outcome.pulses:
        certain = "" if pulse.sure > _CERTAIN else weakly
        yield Line("servo", f"{pulse.run}: 50 Hz pulses at {1e3 * pulse.phase:.0f} ms{certain}")
    for ramp in outcome.ramps:
        limit = f"ramp of {ramp.rate:.1f} m/s²" if ramp.rate else "no ramp"
        yield Line("motor", f"{ramp.run}: {limit}{'' if ramp.sure > _CERTAIN else weakly}")
    yield from (Line("log", jitter.describe()) for jitter in outcome.log_jitters)
    for step in fit.selected if fit else ():
        gain = f"gains {step.gain:.0f} nats"
        yield Line("effect", f"{step.effect}: selected, these drives show it ({gain})")
    how = {
        "ours": f"windows of {fit.horizon:.0f} s" if fit else "",
        "paper": f"soft-DTW and chamfer by Adam, {len(outcome.searches)} starts",
        "cma-es": f"the same loss by CMA-ES, {len(outcome.searches)} starts",
    }
    yield Line("method", f"{outcome.method} ({how[outcome.method]}), {outcome.seconds:.1f} s")


def _parameters(outcome: Outcome) -> Iterator[Line]:
    """A line for each parameter that the drives identify; one sentence for all the others."""
    rows = {name: row for name, row in outcome.free_rows.items() if row.identifiable}
    width = max([13, *(len(name) + 1 for name in rows)])
    values = [with_error(row.value, row.sd) for row in rows.values()]
    wide = max([22, *map(len, values)])
    for (name, row), value in zip(rows.items(), values, strict=True):
        moved = abs(row.value - row.start) > 2.0 * (row.sd or 0.0)
        unit, word = "" if row.unit == "1" else row.unit, "changed" if moved else "unchanged"
        yield Line("", f"{name:<{width}}{value:>{wide}} {unit:<7} {word}", whole=True)
    helps = Counter(filter(None, outcome.unidentified.values())).most_common(1)
    most = f"; what would help most is {helps[0][0]}" if helps else ""
    if outcome.unidentified:
        yield Line("open", f"these drives do not identify {', '.join(outcome.unidentified)}{most}.")
    for c in (each for each in outcome.combinations if each.known):
        yield Line("", f"identifiable combination: {c.text} = {c.value:.6f} ± {c.sd:.6f} m")


def _validation(outcome: Outcome) -> Iterator[Line]:
    yield Line("prediction", f"of {outcome.held_out_of}")
    for h in outcome.held_out:
        a, b = h.after, h.before
        text = "no held-out drive is so long"
        if not isnan(a.position):
            start = f"{b.position * 1e3:.1f} mm {degrees(b.heading):.2f}°: {h.factor:.1f} x"
            text = f"{a.position * 1e3:7.1f} mm {degrees(a.heading):6.2f}°   (start {start})"
        yield Line("", f"{a.horizon:.1f} s   {text}", whole=True)
        if h.factor < 1.0 and a.median < b.median:
            text = f"median {a.median * 1e3:.1f} mm (start {b.median * 1e3:.1f} mm)"
            yield Line("", f"        {text}; a few are far off", whole=True)
    if len(outcome.regimes) > 1:
        medians = []
        for r in outcome.regimes:
            low, high = r.lateral_accel_low, r.lateral_accel_high
            where = f"to {high:g}" if isfinite(high) else f"above {low:g}"
            medians.append(f"{1e3 * r.median:.{int(r.median < 0.01)}f} mm {where}")
        yield Line("", f"median after 1 s by lateral acceleration [m/s²]: {', '.join(medians)}")


# -- the page --------------------------------------------------------------------------------------


def _figures(outcome: Outcome) -> "Iterator[Diagrams]":
    from steerd.sysid.report.identify_figures import draw_main

    yield from draw_main(outcome)


def _sections(outcome: Outcome) -> Iterator[Section]:
    from steerd.sysid.report import identify_figures as figures
    from steerd.sysid.report.drawing import Diagrams

    traces, held_out, parameters = _figures(outcome)
    lacks = [f"Excitation: {lack}." for lack in outcome.excitation.lacking]
    heads = ["parameter", "value ± sd", "unit", "start", "true", ""]
    truth = outcome.truth._asdict() if outcome.truth is not None else {}
    rows = []
    for name, row in outcome.free_rows.items():
        remark = "" if row.identifiable else f"not identifiable; {row.manoeuvre}"
        unit = "" if row.unit == "1" else row.unit
        true = f"{truth[name]:.5g}" if name in truth else ""
        texts = [name, with_error(row.value, row.sd), unit, f"{row.start:.5g}", true, remark]
        rows.append([Cell(text, "" if row.identifiable else "quiet") for text in texts])
    table = Table(heads, rows, words=[len(heads) - 1])
    known = [f"{c.text} = {c.value:.5g} ± {c.sd:.2g} m" for c in outcome.combinations if c.known]
    combined = [f"Identifiable combination: {text}." for text in known if outcome.unidentified]
    fixed = [
        f"{name} = {row.value:.5g} {row.unit if row.unit != '1' else ''}".rstrip()
        for name, row in outcome.rows.items()
        if not row.free
    ]
    yield Section(
        notes=[*outcome.notes, *lacks, *combined],
        table=table if truth else table.pick(*(head for head in heads if head != "true")),
        figures=[parameters],
        fold=Fold("fixed parameters", ", ".join(fixed)),
    )
    yield Section(
        "Prediction of drives that were not fitted",
        f"Validated on {outcome.held_out_of}. Open loop: the state is fitted to the 0.4 s before, "
        "then only the commands are known.",
        figures=[traces, held_out],
    )
    yield _designs(outcome)
    if outcome.fit is not None:
        left = outcome.fit.residuals
        kinds = sorted(set(left.group.tolist()))
        yield Section(
            "Residuals",
            "Flat and as narrow as the line: the model explains the drive. Waves or a wide "
            "spread: something is missing, and steerd diagnose looks for it.",
            figures=[Diagrams(figures.plot_residuals, 1.7, (left, kind), 2) for kind in kinds],
        )
        yield Section(
            "Correlation of the estimates",
            "Near ±1: the data identify the combination, not its members.",
            figures=[Diagrams(figures.plot_correlation, 4.6, [outcome.fit])],
        )
    if outcome.searches:
        yield Section(
            "Convergence",
            "Parameters that stay near their starts do not change the loss: "
            "they are not identifiable.",
            figures=[Diagrams(figures.plot_searches, 3.0, [outcome.searches], 2)],
        )


def _designs(outcome: Outcome) -> Section:
    from steerd.sysid.report import design_comparison, identify_figures

    truth = {} if outcome.truth is None else {"truth": outcome.truth}
    designs = {**truth, "identified": outcome.after, "start values": outcome.before}
    profiles = design_comparison.compare_designs(outcome.truth or outcome.after, designs)
    plant = "the identified car" if outcome.truth is None else "the true (simulated) car"
    results = "; ".join(
        f"{p.design}, {p.friction} friction: "
        + (f"refused ({p.refused})" if p.refused else f"{p.rms * 1e3:.1f} mm")
        for p in profiles
    )
    return Section(
        "Lane keeping with controllers designed from these parameters",
        f"A figure eight at up to 2 m/s from 0.15 m beside it, on {plant}. RMS of e1: {results}.",
        figures=[identify_figures.draw_profiles(profiles)],
    )
