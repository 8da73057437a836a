"""The gap report: one HTML file that needs nothing else, for a reader who was not there."""

from collections.abc import Iterator
from dataclasses import dataclass

from matplotlib import rc_context

from steerd.car_model.effects import EFFECTS
from steerd.sim_gap.diagnosis import Diagnosis
from steerd.sim_gap.lane_comparison import LaneComparison
from steerd.sim_gap.report import gap_figures as figures
from steerd.sim_gap.report.summary_text import (
    EQUATIONS,
    FAMILIES,
    ambiguity,
    cause_words,
    headline,
    known_leads,
    lane_rows,
    lane_words,
    residual_words,
    share_words,
    short,
    shrink_words,
    summary_of,
    value_words,
)
from steerd.sim_gap.verdict.evidence import Cause
from steerd.sysid.report.drawing import STYLE, draw
from steerd.sysid.report.report import Card, Fold, Report, Section, Table

OTHER_SHOWN = 0.005
"""Something else is shown from this probability on."""
GRADES = {"explained": "good", "partial": "fair", "unexplained": "bad", "unjudged": "bad"}
METHOD = (
    "The drives are cut into windows of one second. From each window's start, which is unknown and "
    "estimated, the base car predicts what mocap, wheels and gyro should show, from the commands "
    "alone. The error is measured in units of its own noise: 1 is noise, more is a gap. Every "
    "effect of the library is then added by itself, the base's parameters staying free within "
    "their uncertainty, and is scored on windows that its fit did not see (one nat is a factor 2.7 "
    "in likelihood). The name goes to the effect that predicts best; what predicts nearly as well, "
    "or looks alike in these drives, is listed beside it."
)


@dataclass(frozen=True)
class Subject:
    """What was diagnosed."""

    sessions: tuple[str, ...]  # names of the files
    seconds: float  # driving that was looked at [s]
    base: str  # where the base car comes from
    held_out_of: str  # what was held out, as text; empty if nothing
    following: str  # what to drive next, as text
    notes: tuple[str, ...] = ()  # what a reader should know about the data


@rc_context(STYLE)
def make_report(subject: Subject, found: Diagnosis, lane: LaneComparison | None) -> Report:
    """What a diagnosis found."""
    s = found.shrinkage
    how = Section(
        "How this was done",
        METHOD,
        notes=(*subject.notes, *found.notes),
        fold=Fold(
            "the prediction, as it was written before the reserved drives were opened",
            f"{s.text} SHA-256 {s.digest}",
        ),
    )
    return Report(
        title="What the simulation is missing of this car",
        subject=", ".join(subject.sessions),
        about=f"{subject.seconds:.0f} s to explain · base: {subject.base}",
        lead=headline(found),
        sections=[*_sections(subject, found, lane), how],
        foot="Written by steerd diagnose. Frames are ISO 8855, angles positive to the left; "
        "sd is one standard error; intervals are 90 %.",
        verdict=FAMILIES[found.verdict],
        grade=GRADES.get(found.verdict, ""),
        cards=list(make_cards(found)),
    )


def make_cards(found: Diagnosis) -> Iterator[Card]:
    """The figures that are read first."""
    leads = known_leads(found.before) or [0]
    last = min(leads, key=lambda i: abs(found.before.errors[i][0] - 1.0))
    before, after = found.before.errors[last], found.after.errors[last]
    lead = f"position error after {before[0]:g} s"
    if found.causes:
        first = found.causes[0]
        parameter, (value, sd, unit) = _surest(first)
        more = f" and {found.causes[1].effect}" if len(found.causes) > 1 else ""
        yield Card("cause", f"{first.effect}{more}", _sureness(found))
        yield Card("how large", value_words(value, sd, unit), f"{first.effect}: {parameter} ± sd")
        figure = f"{short(1e3 * before[1])} → {short(1e3 * after[1])} mm"
        yield Card(lead, figure, "base car → with the effect")
        yield _shrunk(found)
        return
    yield Card(lead, f"{short(1e3 * before[1])} mm", "root mean square, base car")
    low, high = found.before.interval
    text = f"1 is noise alone; 90 %: {low:.2g} to {high:.2g}"
    yield Card("error over noise", f"{found.before.whitened:.2g}", text)
    if found.candidates:
        effect, probability, _ = max(found.candidates, key=lambda row: row[1])
        yield Card("best candidate", effect, f"{probability:.0%}: not enough")


def _sureness(found: Diagnosis) -> str:
    """How sure the names are, and how likely something else is."""
    sure = " and ".join(f"{cause.confidence:.0%}" for cause in found.causes)
    other = found.something_else
    return f"{sure} sure" + (f"; something else {other:.0%}" if other >= OTHER_SHOWN else "")


def _surest(cause: Cause) -> tuple[str, tuple[float, float, str]]:
    """The parameter that is furthest from doing nothing, in its standard errors."""
    nulls = {p.name: p.null for p in EFFECTS[cause.effect].parameters}

    def sigmas(item: tuple[str, tuple[float, float, str]]) -> float:
        name, (value, sd, _) = item
        return abs(value - nulls[name]) / max(sd, 1e-12)

    return max(cause.parameters.items(), key=sigmas)


def _shrunk(found: Diagnosis) -> Card:
    s, label = found.shrinkage, "excess error removed"
    if s.measured is None:
        return Card(label, share_words(s.predicted), "predicted")
    said = f"measured; predicted {share_words(s.predicted)}"
    return Card(label, share_words(s.measured), said)


def _sections(subject: Subject, found: Diagnosis, lane: LaneComparison | None) -> Iterator[Section]:
    explained = bool(found.causes)
    yield Section(
        "How large the gap is",
        "The car's pose and wheel speed are predicted from a window's start; this is how far the "
        "prediction is off after so many seconds, with 90 % intervals. The start itself is fitted "
        "to the window, so a wrong model is met best somewhere in its middle.",
        figure=draw(
            lambda *axes: figures.plot_gap(axes, found),
            2.5,
            columns=len(figures.find_measured(found.before)),
            colours=figures.effect_colours(explained=explained),
        ),
    )
    if found.verdict != "none":
        yield from _where(found, explained)
    if found.candidates:
        shown = min(len(found.candidates) + 1, figures.SHOWN_MOST)
        yield Section(
            "Which effect",
            _which(found),
            figure=draw(
                figures.plot_candidates,
                0.7 + 0.24 * max(shown, 2),
                found,
                colours=figures.candidate_colours(found),
            ),
        )
    if explained:
        yield from _why(found)
        yield Section(
            "How far the gap shrinks",
            f"Adding the effect: {shrink_words(found, subject.held_out_of)}.",
            figure=draw(figures.plot_shrinkage, 1.35, found.shrinkage),
        )
    if lane is not None:
        yield Section(
            "Lane keeping, driven again",
            f"{_sentence(lane_words(lane))} Laps are averaged by place along the lane; controller, "
            "path and speed are the session's own, only the simulated car is exchanged.",
            figure=figures.draw_lane(lane),
            table=Table(("", "recorded", "base car", "with the effect"), lane_rows(lane)),
        )
    if found.verdict in ("unexplained", "partial"):
        yield Section("What is left", f"{_sentence(residual_words(found))}")
    yield Section("What next", f"{_sentence('to drive: ' + subject.following)} {_typed(found)}")


def _typed(found: Diagnosis) -> str:
    if not found.causes:
        return ""
    return (
        "The same command with -o CAR.toml writes the effect into a car file. A simulation with "
        "--car CAR.toml then behaves like this car, and controllers and filters designed from that "
        "file know of the effect as far as it is a parameter of theirs."
    )


def _sentence(text: str) -> str:
    return text[:1].upper() + text[1:] + ("" if text.endswith(".") else ".")


def _where(found: Diagnosis, explained: bool) -> Iterator[Section]:
    where = found.where
    yield Section(
        "Where it lies", where.sentence, figure=draw(figures.plot_where, 1.9, where, columns=2)
    )
    if found.timeline is not None:
        yield Section(
            "",
            "Over time: each bar is a window of one second. Shaded stretches stand out; the dotted "
            "line is noise alone.",
            figure=figures.draw_timeline(found.timeline, where.windows, explained),
        )
    regimes = where.regimes[:6]
    if regimes:
        yield Section(
            "",
            "By regime: right of the dotted line the error is larger than elsewhere "
            "(coloured where its interval says so).",
            figure=draw(figures.plot_regimes, 0.7 + 0.28 * len(regimes), regimes),
        )


def _which(found: Diagnosis) -> str:
    if not found.causes:
        return (
            "The likeliest effects, each added to the base. None is so much likelier than the base "
            "alone that it could be called a cause."
        )
    stage = EQUATIONS.get(found.where.equation[0].name, found.where.stage)
    text = f"The error lies in the {stage}; every effect was tried all the same. "
    confounded = [f"{c.effect} ({ambiguity(c)})" for c in found.causes if ambiguity(c)]
    if not confounded:
        return f"{text}On these drives nothing in the library is mistaken for what was found."
    return f"{text}Not distinguishable from it: {'; '.join(confounded)}."


def _why(found: Diagnosis) -> Iterator[Section]:
    rows = [
        (
            cause.effect,
            cause_words(cause),
            f"{cause.confidence:.0%}",
            f"{summary_of(cause.effect)}: {EFFECTS[cause.effect].equation}".replace("->", "→"),
            ambiguity(cause) or "nothing",
        )
        for cause in found.causes
    ]
    heads = ("effect", "value ± sd", "confidence", "what it is", "not distinguishable from")
    other = f"Something else than the library: {found.something_else:.0%}."
    yield Section("How sure", other, table=Table(heads, rows, words=(1, 3, 4)))
