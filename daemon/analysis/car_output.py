"""Car files that come out of an identification or a diagnosis."""

from math import floor, isfinite, log10
from pathlib import Path
from typing import TYPE_CHECKING, Any

import tomlkit

from steerd.car_model.car_file import (
    CarFile,
    CarFileError,
    Learned,
    default_car_path,
    load_car,
    parse_car,
    update_car,
)
from steerd.car_model.effects import find_effect
from steerd.car_model.params import PARAMETERS
from steerd.daemon.common.translate import make_car_file_error

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from steerd.sim_gap.verdict.evidence import Cause
    from steerd.sysid.data.dataset import Run
    from steerd.sysid.estimation.outcome import Outcome


def make_car(base: CarFile, updates: "Mapping[str, Learned]", path: Path) -> CarFile:
    """The base with new values.

    Args:
        base: as it was.
        updates: new values by `parameter` or `effect.parameter`.
        path: what messages call the new file.

    Raises:
        SteerdError: a value is none that a car file may hold.
    """
    rounded = {name: _rounded(learned) for name, learned in updates.items()}
    try:
        car = update_car(path, base, rounded)
        return parse_car(_with_own_words(car, base, rounded), path)
    except CarFileError as error:
        raise make_car_file_error(error) from None


def _rounded(learned: Learned) -> Learned:
    """Two digits of the standard error, and the value to a hundredth of it; no digit says more.

    A hundredth: what the drives know of a combination of values must survive the rounding.
    """
    value, sd, source = learned
    if sd is None or not (isfinite(sd) and sd > 0.0):
        return Learned(float(f"{value:.6g}"), sd, source)
    return Learned(round(value, 2 - floor(log10(sd))), float(f"{sd:.2g}"), source)


def _with_own_words(car: CarFile, base: CarFile, updates: "Mapping[str, Learned]") -> str:
    """The file's text with comments that belong to the new values, under a name of its own."""
    document = tomlkit.parse(car.text)
    if base.name in (load_car(default_car_path()).name, ""):
        document["car"]["name"] = car.path.stem
    known = {p.name: (p.unit, p.meaning) for p in PARAMETERS}
    for effect in car.effects:
        known |= {f"{effect.name}.{p.name}": (p.unit, p.meaning) for p in effect.parameters}
    for name, learned in updates.items():
        owner, dot, key = name.rpartition(".")
        tables: Any = document["effects"] if dot else document
        named = [n for n in tables if not dot or find_effect(n).name == find_effect(owner).name]
        table = tables[named[0] if dot else "car"]
        unit, meaning = known[name]
        value = table[key]
        value.comment(_comment(unit, meaning, learned))
        value.trivia.comment_ws = " " * max(2, 21 - len(f"{key} = {value.as_string()}"))
    return tomlkit.dumps(document)


def _comment(unit: str, meaning: str, learned: Learned) -> str:
    """What stands beside a value."""
    sd = f" ± {learned.sd:.2g}" if learned.sd else ""
    how = learned.source.partition(":")[0].removeprefix("steerd ")
    return ", ".join(filter(None, (f"{unit}{sd}" if unit != "1" else sd.strip(), meaning, how)))


def identified_values(
    outcome: "Outcome", base: CarFile, given: "Mapping[str, Learned]"
) -> dict[str, Learned]:
    """Updates for the car file: fitted parameters with error and provenance, and what was stated.

    Args:
        outcome: of the identification.
        base: the car before it.
        given: values that the user stated.
    """
    return {**_carried_values(base, outcome), **given, **_fitted_values(outcome)}


def _carried_values(base: CarFile, outcome: "Outcome") -> dict[str, Learned]:
    """What a stated wheelbase or mass moved, and nothing fitted: as it was while fitting."""
    return {
        name: Learned(getattr(outcome.after, name), None, "follows from what was stated")
        for name in ("lf", "lr", "inertia_z")
        if getattr(outcome.after, name) != getattr(base.model.car, name)
    }


def _fitted_values(outcome: "Outcome") -> dict[str, Learned]:
    names = ", ".join(outcome.sessions)
    updates = {}
    for name, row in outcome.rows.items():
        if row.free:
            source = f"steerd identify ({outcome.method}): {names}"
            source += "" if row.identifiable else "; not identifiable from these data"
            source += _servo_wait(outcome) if name == "steer_delay" else ""
            updates[name] = Learned(row.value, row.sd, source)
        elif row.value != row.before:
            updates[name] = Learned(row.value, None, f"steerd identify: {names}")
    effects = {
        name: Learned(row.value, row.sd, f"steerd identify: {names}")
        for name, row in outcome.effect_rows.items()
        if row.free
    }
    return updates | effects


def _servo_wait(outcome: "Outcome") -> str:
    """What a fitted dead time of the steering contains."""
    if outcome.pulses:
        return "; half a frame (10 ms) is the mean wait for a pulse of the 50 Hz servo signal"
    return "; it contains the wait for the servo's next pulse"


def with_knowledge(
    car: CarFile, runs: "tuple[Run, ...]", learnt: "Mapping[str, Mapping[str, Any]] | None" = None
) -> str:
    """The car file's text with what these drives teach `steerd diagnose`: `[noise]`, `[knowledge]`.

    How large what no car explains was, the joint covariance of the base, where the model fails.
    Other drives of the car are judged by it, cut like these to where the car moves: a standing car
    is quieter. The file stays without where the drives do not identify it.

    Args:
        car: the identified car.
        runs: its drives.
        learnt: the tables, where the identification had to learn them itself.
    """
    from steerd.sysid.inference.knowledge import about

    document = tomlkit.parse(car.text)
    try:
        sections = learnt or _learnt(car, runs)
    except (ValueError, FloatingPointError):
        return car.text
    for name, table in about(car, sections).items():
        document[name] = table
    return tomlkit.dumps(document)


def _learnt(car: CarFile, runs: "tuple[Run, ...]") -> "dict[str, dict[str, Any]]":
    from steerd.sysid.data.segments import moving_segments
    from steerd.sysid.estimation.preparation import add_command_history
    from steerd.sysid.inference.car_posterior import learn_sections

    return learn_sections(car, moving_segments(add_command_history(runs, car.model, asked=True)))


def diagnosed_values(causes: "Sequence[Cause]", sessions: "Sequence[Path]") -> dict[str, Learned]:
    """Updates for the car file: every parameter of the found effects."""
    source = f"steerd diagnose: {', '.join(path.name for path in sessions)}"
    return {
        f"{cause.effect}.{name}": Learned(value, sd, source)
        for cause in causes
        for name, (value, sd, _) in cause.parameters.items()
    }
