"""A diagnosis in plain sentences, for the terminal and the report alike."""

from collections.abc import Iterator
from math import degrees

from steerd.car_model.effects import EFFECTS
from steerd.sim_gap.diagnosis import Diagnosis
from steerd.sim_gap.lane_comparison import LaneComparison, as_long, figures_of
from steerd.sim_gap.verdict.evidence import Cause
from steerd.sysid.inference.residuals import Gap
from steerd.sysid.report.report import DEGREES, SCALES, with_error

LARGE = 1000.0
"""From here on the larger unit reads better."""


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
        lead, off = found.before.errors[-1][:2]
        return (
            f"These drives cannot be judged: the simulation is {short(1e3 * off)} mm off after "
            f"{lead:g} s, and what was learnt as noise hides why."
        )
    if found.verdict == "unexplained" or not found.causes:
        return "There is a gap, and none of the known effects explains it."
    names = " and ".join(cause.effect for cause in found.causes)
    what = "; ".join(EFFECTS[cause.effect].summary for cause in found.causes)
    if found.verdict == "partial":
        return f"Part of the gap behaves like {names}: {what}."
    return f"The gap is explained by {names}: {what}."


def ambiguity(cause: Cause) -> str:
    """What is not distinguishable from a cause."""
    parts = []
    if cause.ambiguous_with:
        parts.append(f"on these drives: {', '.join(cause.ambiguous_with)}")
    if cause.alias:
        parts.append(f"in general: {cause.alias}")
    return "; ".join(parts)


def short(value: float) -> str:
    """Two digits, and never an exponent."""
    return f"{value:.2g}" if abs(value) < 99.5 else f"{value:.0f}"


def known_leads(gap: Gap) -> list[int]:
    """Which leads have errors: windows may end just before the last."""
    return [i for i, row in enumerate(gap.errors) if row[1] > 0.0]


def gap_words(found: Diagnosis) -> Iterator[str]:
    """Position and heading error before and after by lead."""
    for i in known_leads(found.before):
        before, after = found.before.errors[i], found.after.errors[i]
        if not found.causes:
            yield f"{before[0]:g} s: {short(1e3 * before[1])} mm, {short(degrees(before[2]))}°"
            continue
        yield (
            f"{before[0]:g} s: {short(1e3 * before[1])} → {short(1e3 * after[1])} mm, "
            f"{short(degrees(before[2]))} → {short(degrees(after[2]))}°"
        )


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
    if following is not None:
        first, second = following.separates
        what = f"`{following.command}` ({following.name})"
        return f"to distinguish {first} from {second}: {what}"
    if found.verdict == "none":
        return "nothing; if the car behaves badly elsewhere, record it there"
    if found.verdict == "unjudged":
        return (
            "nothing yet: first `steerd identify`, then `--base` that car, `--healthy` its drives"
        )
    if found.verdict == "unexplained":
        return "`steerd collect --plan mixed`: more kinds of driving identify more of it"
    if found.verdict == "partial":
        return "the same once more, and faster: the remainder must be reproducible to be modelled"
    return "nothing more is needed to name it"


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
    drives = [lane.recorded, lane.without, lane.with_effect]
    if lane.without is not None:
        drives[0] = as_long(lane.recorded, lane.without)
    found = [None if d is None else figures_of(d) for d in drives]
    rows = [
        ("e1 RMS [mm]", 1e3, "e1_rms"), ("e1 mean [mm]", 1e3, "e1_mean"),
        ("e1 strongest at [Hz]", 1.0, "e1_peak_hz"), ("e2 RMS [°]", DEGREES, "e2_rms"),
        ("e2 mean [°]", DEGREES, "e2_mean"), ("e2 strongest at [Hz]", 1.0, "e2_peak_hz"),
        ("steering RMS [°]", DEGREES, "steer_rms"), ("steering strongest at [Hz]", 1.0,
                                                   "steer_peak_hz"),
    ]  # fmt: skip
    return [
        [label, *("–" if f is None else f"{scale * getattr(f, name):.3g}" for f in found)]
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
