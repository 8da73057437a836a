"""The report of `steerd identify`: one HTML file without links, results first."""

from collections.abc import Iterator
from math import degrees, isnan

from matplotlib import rc_context

from steerd.car_model.params import Car
from steerd.sysid.estimation.outcome import Outcome
from steerd.sysid.report import identify_figures as figures
from steerd.sysid.report.design_comparison import Profile, compare_designs
from steerd.sysid.report.drawing import STYLE, draw
from steerd.sysid.report.report import Card, Cell, Fold, Report, Section, Table

IMPROVEMENT_MIN = 1.02
"""A smaller factor is no improvement."""


@rc_context(STYLE)
def make_report(outcome: Outcome) -> Report:
    """What an identification found."""
    profiles = compare_designs(*_designs(outcome))
    e = outcome.excitation
    return Report(
        title="The car identified from these drives",
        subject=", ".join(outcome.sessions),
        about=f"{e.seconds:.0f} s, {e.distance:.0f} m, "
        f"{e.speed_low:.1f} to {e.speed_high:.1f} m/s, {e.lateral_accel:.1f} m/s² sideways · "
        f"method {outcome.method}, {outcome.seconds:.1f} s",
        lead="What the drives say of the car, judged by drives that were not fitted.",
        sections=[*_values(outcome), *_sections(outcome, profiles)],
        foot="Written by steerd identify. Frames are ISO 8855, angles positive to the left; "
        "sd is one standard error.",
        cards=list(make_cards(outcome)),
    )


def make_cards(outcome: Outcome) -> Iterator[Card]:
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


def _values(outcome: Outcome) -> Iterator[Section]:
    """The parameters: free, combined, fixed."""
    lacks = [f"Excitation: {lack}." for lack in outcome.excitation.lacking]
    heads = ["parameter", "value", "± sd", "start", "unit", ""]
    truth = outcome.truth._asdict() if outcome.truth is not None else None
    rows = []
    for name, row in outcome.free_rows.items():
        remark = "" if row.identifiable else f"not identifiable; {row.manoeuvre}"
        sd = "?" if row.sd is None else f"{row.sd:.2g}"
        texts = [name, f"{row.value:.5g}", sd, f"{row.before:.5g}", row.unit, remark]
        if truth is not None:
            texts.insert(4, f"{truth[name]:.5g}" if name in truth else "")
        rows.append([Cell(text, "" if row.identifiable else "quiet") for text in texts])
    if truth is not None:
        heads.insert(4, "true")
    table = Table(heads, rows, words=[len(heads) - 1])
    yield Section(notes=[*outcome.notes, *lacks], table=table)
    known = [f"{c.text} = {c.value:.5g} ± {c.sd:.2g} m" for c in outcome.combinations if c.known]
    combined = outcome.unidentified and known
    fixed = [
        f"{name} = {row.value:.5g} {row.unit if row.unit != '1' else ''}".rstrip()
        for name, row in outcome.rows.items()
        if not row.free
    ]
    yield Section(
        text=f"Identifiable combinations: {'; '.join(known)}." if combined else "",
        fold=Fold("fixed parameters", ", ".join(fixed)),
    )


def _designs(outcome: Outcome) -> tuple[Car[float], dict[str, Car[float]]]:
    """The plant, and the cars that controllers are designed from."""
    designs = {"identified": outcome.after, "start values": outcome.before}
    if outcome.truth is None:
        return outcome.after, designs
    return outcome.truth, {"truth": outcome.truth, **designs}


def _sections(outcome: Outcome, profiles: tuple[Profile, ...]) -> Iterator[Section]:
    yield Section(
        "Prediction of drives that were not fitted",
        f"Validated on {outcome.held_out_of}. Open loop: the state is fitted to the 0.4 s before, "
        "then only the commands are known.",
        figure=draw(figures.plot_held_out, 2.6, outcome.held_out, columns=2),
    )
    yield Section(figure=draw(figures.plot_traces, 4.0, outcome.traces, columns=2))
    plant = "the identified car" if outcome.truth is None else "the true (simulated) car"
    yield Section(
        "Lane keeping with controllers designed from these parameters",
        f"A figure eight at up to 2 m/s from 0.15 m beside it, on {plant}. {_closed(profiles)}",
        figure=figures.draw_profiles(profiles),
    )
    if outcome.fit is not None:
        yield Section(
            "Residuals",
            "Flat and as narrow as the line: the model explains the drive. Waves or a wide "
            "spread: something is missing, and steerd diagnose looks for it.",
            figure=figures.draw_residuals(outcome.fit),
        )
        yield Section(
            "Correlation of the estimates",
            "Near ±1: the data identify the combination, not its members.",
            figure=figures.draw_correlation(outcome.fit),
        )
    if outcome.searches:
        yield Section(
            "Convergence",
            "Parameters that stay near their starts do not change the loss: "
            "they are not identifiable.",
            figure=draw(figures.plot_searches, 3.0, outcome.searches, columns=2),
        )


def _closed(profiles: tuple[Profile, ...]) -> str:
    parts = []
    for p in profiles:
        result = f"refused ({p.refused})" if p.refused else f"{p.rms * 1e3:.1f} mm"
        parts.append(f"{p.design}, {p.friction} friction: {result}")
    return "RMS of e1: " + "; ".join(parts) + "."
