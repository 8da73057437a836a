"""What is shown of a diagnosis: on a terminal, on a page, in a notebook's figure."""

from collections.abc import Callable, Iterator
from math import degrees
from typing import TYPE_CHECKING

from steerd.car_model.effect import Role
from steerd.car_model.effects import EFFECTS
from steerd.sim_gap.diagnosis import Diagnosis
from steerd.sim_gap.lane_comparison import LaneComparison, figures_of
from steerd.sim_gap.verdict.confidence import Cause, Estimated
from steerd.sim_gap.verdict.where import EQUATIONS
from steerd.sysid.report.report import (
    DEGREES,
    SCALES,
    Card,
    Fold,
    Line,
    Report,
    Section,
    Table,
    with_error,
)

if TYPE_CHECKING:
    from steerd.sysid.report.drawing import Diagrams

LARGE = 1000.0  # from here on the larger unit reads better
OTHER_SHOWN = 0.005  # something else is shown from this probability on
VERDICTS = {
    "none": ("no gap", ""), "explained": ("explained", "good"),
    "partial": ("partly explained", "fair"), "unexplained": ("a gap without a name", "bad"),
    "unjudged": ("cannot be judged", "bad"),
}  # fmt: skip
"""What a page calls a verdict, and how good that is."""
TO_DRIVE = {
    "none": "nothing; if the car behaves badly elsewhere, record it there",
    "explained": "nothing more is needed to name it",
    "partial": "the same once more, and faster: the remainder must be reproducible to be modelled",
    "unexplained": "`steerd collect --plan mixed`: more kinds of driving identify more of it",
    "unjudged": "nothing yet: first `steerd identify`, then `--base` that car, "
    "`--healthy` its drives",
}
"""What to drive next where no manoeuvre distinguishes two names."""
METHOD = (
    "The drives are cut into windows of one second. From each window's start, which is unknown and "
    "estimated, the base car predicts what mocap, wheels and gyro should show, from the commands "
    "alone. The error is measured in units of its own noise: 1 is noise, more is a gap. Every "
    "effect of the library is then added, the base's parameters staying free within their "
    "uncertainty, and counts by how likely it makes the drives beyond what it explains of healthy "
    "ones. The name goes to the likeliest; what is nearly as likely is listed beside it."
)


def make_report(
    found: Diagnosis, complete: Callable[[str], str] = str, following: str = ""
) -> Report:
    """What a diagnosis found.

    `complete` makes commands in a text run as they are printed; `following` is the next to type.
    """
    case, to_drive = found.case, complete(manoeuvre_words(found))
    sessions = ", ".join(case.sessions)
    facts, (verdict, grade) = f"{case.seconds:.0f} s to explain", VERDICTS[found.verdict]
    return Report(
        title="What the simulation is missing of this car",
        subject=sessions,
        about=f"{facts} · base: {case.base_source}",
        lead=headline(found),
        sections=_sections(found, to_drive),
        foot="Written by steerd diagnose. Frames are ISO 8855, angles positive to the left; "
        "sd is one standard error; intervals are 90 %.",
        verdict=verdict,
        grade=grade,
        cards=list(_cards(found)),
        screen=[
            Line("drives", f"{facts}, of {sessions}; base: {case.base_source}"),
            Line("verdict", f"{found.verdict.upper()}. {headline(found)}"),
            *_screen(found),
            Line("drive next", to_drive),
            *(Line("note", note) for note in (*case.notes, *found.notes)),
            Line("next", following, whole=True),
        ],
        figures=_figures(found),
    )


def _screen(found: Diagnosis) -> Iterator[Line]:
    if found.verdict != "none":
        yield Line("where", found.where.sentence)
    for cause in found.causes:
        sure = f"confidence {cause.confidence:.0%}"
        yield Line("cause", f"{cause.effect}: {cause_words(cause)}, {sure}")
        if ambiguity(cause):
            yield Line("confounded", ambiguity(cause))
    if found.causes and found.something_else >= OTHER_SHOWN:
        yield Line("", f"something else than the library's effects: {found.something_else:.0%}")
    if found.verdict in ("unexplained", "partial"):
        yield Line("left over", residual_words(found))
    yield Line("gap after", "; ".join(gap_words(found)))
    if found.causes:
        yield Line("shrinks by", shrink_words(found))
        yield Line("", f"prediction sha256 {found.shrinkage.digest[:16]}…")
    if found.lane is not None:
        yield Line("closed loop", lane_words(found.lane))
    elif found.lane_note and found.causes:
        yield Line("closed loop", found.lane_note.removeprefix("closed loop "))


def furthest(cause: Cause) -> tuple[str, Estimated]:
    """The size that is furthest from doing nothing, in its standard errors; a place is no size."""
    sizes = [p for p in EFFECTS[cause.effect].parameters if p.role is Role.SIZE]
    at = cause.parameters
    size = max(sizes, key=lambda p: abs(at[p.name].value - p.null) / max(at[p.name].sd, 1e-12))
    return size.name, at[size.name]


def _cards(found: Diagnosis) -> Iterator[Card]:
    """The figures that are read first."""
    pairs = found.leads or [(found.before.errors[0], found.after.errors[0])]
    last = min(pairs, key=lambda pair: abs(pair[0].seconds - 1.0))
    before, after = (short(1e3 * each.position.value) for each in last)
    lead = f"position error after {last[0].seconds:g} s"
    if found.causes:
        first, other = found.causes[0], found.something_else
        parameter, (value, sd, unit) = furthest(first)
        sure = f"{' and '.join(f'{cause.confidence:.0%}' for cause in found.causes)} sure"
        sure += f"; something else {other:.0%}" if other >= OTHER_SHOWN else ""
        more = f" and {found.causes[1].effect}" if len(found.causes) > 1 else ""
        yield Card("cause", f"{first.effect}{more}", sure)
        yield Card("how large", value_words(value, sd, unit), f"{first.effect}: {parameter} ± sd")
        yield Card(lead, f"{before} → {after} mm", "base car → with the effect")
        s, share = found.shrinkage, share_words(found.shrinkage.predicted)
        figure, text = share, "predicted"
        if s.measured is not None:
            figure, text = share_words(s.measured), f"measured; predicted {share}"
        yield Card("excess error removed", figure, text)
        return
    yield Card(lead, f"{before} mm", "root mean square, base car")
    low, high = found.before.interval
    text = f"1 is noise alone; 90 %: {low:.2g} to {high:.2g}"
    yield Card("error over noise", f"{found.before.whitened:.2g}", text)
    if found.candidates:
        effect, probability, _ = max(found.candidates, key=lambda row: row[1])
        yield Card("best candidate", effect, f"{probability:.0%}: not enough")


def _figures(found: Diagnosis) -> "Iterator[Diagrams]":
    from steerd.sim_gap.report.gap_figures import draw_main

    yield from draw_main(found)


def _sections(found: Diagnosis, to_drive: str) -> Iterator[Section]:
    from steerd.sim_gap.report import gap_figures as figures
    from steerd.sysid.report.drawing import Diagrams

    gap, candidates, timeline = _figures(found)
    where, lane = found.where, found.lane
    yield Section(
        "How large the gap is",
        "The car's pose and wheel speed are predicted from a window's start; this is how far the "
        "prediction is off after so many seconds, with 90 % intervals. The start itself is fitted "
        "to the window, so a wrong model is met best somewhere in its middle.",
        figures=[gap],
    )
    if found.verdict != "none":
        yield Section(
            "Where it lies", where.sentence, figures=[Diagrams(figures.plot_where, 1.9, [where], 2)]
        )
        yield Section(
            text="Over time: each bar is a window of one second. Shaded stretches stand out; the "
            "dotted line is noise alone.",
            figures=[timeline],
        )
        if where.regimes:
            height = 0.7 + 0.28 * len(where.regimes)
            yield Section(
                text="By regime: right of the dotted line the error is larger than elsewhere "
                "(coloured where its 90 % interval says so).",
                figures=[Diagrams(figures.plot_regimes, height, [where.regimes])],
            )
    if found.candidates:
        yield Section("Which effect", _which(found), figures=[candidates])
    if found.causes:
        shrinks = Diagrams(figures.plot_shrinkage, 1.35, [found.shrinkage])
        yield from _cause_sections(found, shrinks)
    if lane is not None:
        yield Section(
            "Lane keeping, driven again",
            f"{_sentence(lane_words(lane))} Laps are averaged by place along the lane; controller, "
            "path and speed are the session's own, only the simulated car is exchanged.",
            figures=[figures.draw_lane(lane)],
            table=Table(("", "recorded", "base car", "with the effect"), lane_rows(lane)),
        )
    if found.verdict in ("unexplained", "partial"):
        yield Section("What is left", _sentence(residual_words(found)))
    typed = (
        " The same command with -o CAR.toml writes the effect into a car file. A simulation with "
        "--car CAR.toml then behaves like this car, and controllers and filters designed from that "
        "file know of the effect as far as it is a parameter of theirs."
    )
    text = _sentence(f"to drive: {to_drive}")
    yield Section("What next", text + typed if found.causes else f"{text} ")
    prediction = f"{found.shrinkage.text} SHA-256 {found.shrinkage.digest}"
    before = "the prediction, as it was written before the reserved drives were opened"
    yield Section("How this was done", METHOD, found.all_notes, fold=Fold(before, prediction))


def _cause_sections(found: Diagnosis, shrinks: "Diagrams") -> Iterator[Section]:
    """How sure the causes are, and how far they shrink the gap."""
    rows = []
    for cause in found.causes:
        what = "{0.summary}: {0.equation}".format(EFFECTS[cause.effect]).replace("->", "→")
        known = cause.effect, cause_words(cause), f"{cause.confidence:.0%}"
        rows.append((*known, what, ambiguity(cause) or "nothing"))
    heads = ("effect", "value ± sd", "confidence", "what it is", "not distinguishable from")
    other = f"Something else than the library: {found.something_else:.0%}."
    yield Section("How sure", other, table=Table(heads, rows, words=(1, 3, 4)))
    yield Section(
        "How far the gap shrinks", f"Adding the effect: {shrink_words(found)}.", figures=[shrinks]
    )


def _sentence(text: str) -> str:
    return text[:1].upper() + text[1:] + ("" if text.endswith(".") else ".")


def _which(found: Diagnosis) -> str:
    if not found.causes:
        return (
            "The likeliest effects, each added to the base. None is so much likelier than the base "
            "alone that it could be called a cause."
        )
    stage = EQUATIONS[found.where.equation[0].name]
    text = f"The error lies in the {stage}; every effect was tried all the same. "
    confounded = [f"{c.effect} ({ambiguity(c)})" for c in found.causes if ambiguity(c)]
    if not confounded:
        return f"{text}On these drives nothing in the library is mistaken for what was found."
    return f"{text}Not distinguishable from it: {'; '.join(confounded)}."


# -- in words --------------------------------------------------------------------------------------


def value_words(value: float, sd: float, unit: str) -> str:
    """A value with its standard error to two digits of it, in a unit that suits the value."""
    scale, small = SCALES.get(unit, (1.0, unit))
    if abs(scale * value) >= LARGE:
        scale, small = 1.0, unit
    small = "" if small == "1" else small.replace("^2", "²")
    return f"{with_error(scale * value, scale * sd)} {small}".rstrip()


def cause_words(cause: Cause) -> str:
    """An effect's parameters in a line."""
    return ", ".join(
        f"{name} = {value_words(value, sd, unit)}"
        for name, (value, sd, unit) in cause.parameters.items()
    )


def headline(found: Diagnosis) -> str:
    """The verdict in one sentence."""
    if found.verdict == "none":
        return "What the simulation does not predict of these drives looks like noise."
    if found.verdict == "unjudged":
        last = found.before.errors[-1]
        size = short(1e3 * last.position.value)
        off = f"the simulation is {size} mm off after {last.seconds:g} s"
        return f"These drives cannot be judged: {off}, and errors as large were learnt as ordinary."
    if found.verdict == "unexplained" or not found.causes:
        return "There is a gap, and none of the known effects explains it."
    names = " and ".join(cause.effect for cause in found.causes)
    what = "; ".join(EFFECTS[cause.effect].summary for cause in found.causes)
    if found.verdict == "partial":
        return f"Part of the gap behaves like {names}: {what}."
    return f"The gap is explained by {names}: {what}."


def ambiguity(cause: Cause) -> str:
    """What is not distinguishable from a cause."""
    here = f"on these drives: {', '.join(cause.ambiguous_with)}" if cause.ambiguous_with else ""
    return "; ".join(filter(None, [here, cause.alias and f"in general: {cause.alias}"]))


def short(value: float) -> str:
    """Two digits, and never an exponent."""
    return f"{value:.2g}" if abs(value) < 99.5 else f"{value:.0f}"


def gap_words(found: Diagnosis) -> Iterator[str]:
    """Position and heading error before and after by lead."""
    for pair in found.leads:
        shown = pair if found.causes else pair[:1]
        away = " → ".join(short(1e3 * lead.position.value) for lead in shown)
        turned = " → ".join(short(degrees(lead.yaw.value)) for lead in shown)
        yield f"{pair[0].seconds:g} s: {away} mm, {turned}°"


def share_words(share: float) -> str:
    """A share in percent; nearly all is not all."""
    return ">99%" if 0.99 < share < 1.0 else f"{share:.0%}"


def shrink_words(found: Diagnosis) -> str:
    """Predicted and measured shrinkage."""
    s, held_out_of = found.shrinkage, found.case.held_out_of
    low, best, high = map(share_words, (s.low, s.predicted, s.high))
    text = f"predicted {best} of the excess error ({low} to {high})"
    if s.before is None:
        return f"{text}; not measured: nothing was held out"
    if s.measured is None:
        return f"{text}; {held_out_of} shows too little of the gap to measure it there"
    return f"{text}, measured {share_words(s.measured)} on {held_out_of}"


def manoeuvre_words(found: Diagnosis) -> str:
    """What to drive next."""
    following = found.next_manoeuvre
    if following is None:
        return TO_DRIVE[found.verdict]
    first, second = following.separates
    return f"to distinguish {first} from {second}: `{following.command}` ({following.name})"


def lane_words(lane: LaneComparison) -> str:
    """The closed loop in a sentence."""
    before, after = lane.distances
    if before is None or after is None:
        return "; ".join(lane.remarks) or (
            f"the lane keeper on {lane.session}, re-run without an effect: e1 profile off by "
            f"{1e3 * before.e1:.2g} mm" if before else "no simulated drive to compare with"
        )  # fmt: skip
    votes = lane.votes
    count = f"in {sum(votes)} of {len(votes)} measures" if any(votes) else "in no measure"
    return (
        f"with the effect the re-run loop is closer to {lane.session} {count}: e1 profile off by "
        f"{1e3 * before.e1:.2g} → {1e3 * after.e1:.2g} mm, e2 by {degrees(before.e2):.2g} → "
        f"{degrees(after.e2):.2g}°, steering spectrum by {before.steer_db:.2g} → "
        f"{after.steer_db:.2g} dB"
    )


def lane_rows(lane: LaneComparison) -> list[list[str]]:
    """A table: figures of the recorded and the simulated drives."""
    found = [None if d is None else figures_of(d) for d in lane.drives.values()]
    rows = [
        ("e1 RMS [mm]", 1e3, "e1_rms"), ("e1 mean [mm]", 1e3, "e1_mean"),
        ("e1 strongest at [Hz]", 1.0, "e1_peak_hz"), ("e2 RMS [°]", DEGREES, "e2_rms"),
        ("e2 mean [°]", DEGREES, "e2_mean"), ("e2 strongest at [Hz]", 1.0, "e2_peak_hz"),
        ("steering RMS [°]", DEGREES, "steer_rms"), ("steering strongest at [Hz]", 1.0,
                                                   "steer_peak_hz"),
    ]  # fmt: skip
    return [
        [label, *("–" if f is None else f"{scale * f[name]:.3g}" for f in found)]
        for label, scale, name in rows
    ]


def residual_words(found: Diagnosis) -> str:
    """What is left, as text."""
    shape, parts = found.shape, []
    if shape.noise_like:
        parts.append("it is white in time and grows with speed: jitter of stamps or lost frames")
    elif shape.prominence > 3.0:
        parts.append(f"its heading error is strongest at {shape.peak_hz:.2g} Hz")
    if shape.dependence:
        name, size = next(iter(shape.dependence.items()))
        trend = "grows" if size > 0 else "falls"
        parts.append(f"it {trend} with {name.replace('_', ' ')} (rank correlation {size:+.2f})")
    return "; ".join(parts) or "no pattern stands out"
