"""Car files that come out of an identification or a diagnosis."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import floor, isfinite, log10
from pathlib import Path
from typing import Any

import tomlkit

from steerd.car_model.car_file import (
    IDENTIFIED,
    CarFile,
    CarFileError,
    Learned,
    default_car_path,
    parse_car,
    update_document,
)
from steerd.car_model.effect import EffectParameter
from steerd.car_model.effects import find_effect
from steerd.car_model.params import PARAMETERS, Parameter
from steerd.daemon.assembly.session_meta import read_session_car
from steerd.daemon.common.errors import SteerdError, make_car_file_error
from steerd.daemon.settings.car_edit import Values, edit_document
from steerd.daemon.settings.config import make_settings
from steerd.posterior_file import TABLES, encode_posterior
from steerd.steer_bus.session_read import Session, SessionError
from steerd.sysid.data.dataset import Run
from steerd.sysid.data.segments import moving_segments
from steerd.sysid.estimation.outcome import Outcome
from steerd.sysid.estimation.preparation import add_command_history
from steerd.sysid.inference.car_posterior import learn_sections

PUBLISHED = "F1TENTH, published figures"
"""Name of the car file that is installed with steerd; no car that was driven is called so."""
_LEARNT = ("car", "effects", *TABLES)  # sections that are about the car, not about its wiring


def make_car(
    base: CarFile, updates: Mapping[str, Learned], path: Path, wiring: Values | None = None
) -> CarFile:
    """The base with new values by `parameter` or `effect.parameter`, for a file called `path`.

    What was known beyond the old values is left out, and `wiring` (see `find_wiring`) where it is
    of a version whose settings were others: the result counts more. A SteerdError where a value is
    none that a car file may hold.
    """
    document = tomlkit.parse(base.text)
    for name in TABLES:  # of a car file from before they had a file of their own
        document.pop(name, None)
    rounded = {name: _rounded(learned) for name, learned in updates.items()}
    update_document(document, rounded)
    _comment(document, rounded)
    if base.name in (PUBLISHED, ""):
        document["car"]["name"] = path.stem
    edit_document(document, wiring or {})
    try:
        car = parse_car(tomlkit.dumps(document), path)
        if wiring:
            make_settings(car)
        return car
    except (CarFileError, SteerdError) as error:
        if wiring:
            return make_car(base, updates, path)
        raise make_car_file_error(error) if isinstance(error, CarFileError) else error from None


def _rounded(learned: Learned) -> Learned:
    """Two digits of the standard error, and the value to a hundredth of it; no digit says more.

    A hundredth: what the drives know of a combination of values must survive the rounding.
    """
    value, sd, source = learned
    if sd is None or not (isfinite(sd) and sd > 0.0):
        return Learned(float(f"{value:.6g}"), sd, source)
    return Learned(round(value, 2 - floor(log10(sd))), float(f"{sd:.2g}"), source)


def _comment(document: Any, updates: Mapping[str, Learned]) -> None:
    """Comments that belong to the new values: unit, error, meaning, origin."""
    for name, learned in updates.items():
        owner, dot, key = name.rpartition(".")
        table: Any = document["car"]
        of: Sequence[Parameter | EffectParameter] = PARAMETERS
        if dot:
            effect = find_effect(owner)
            named = next(n for n in document["effects"] if find_effect(n) is effect)
            table, of = document["effects"][named], effect.parameters
        about = next(p for p in of if p.name == key)
        unit = about.unit if about.unit != "1" else ""
        sd = f"± {learned.sd:.2g}" if learned.sd else ""
        how = learned.source.partition(":")[0].removeprefix("steerd ")
        value = table[key]
        words = (f"{unit} {sd}".strip(), about.meaning, how)
        value.comment(", ".join(filter(None, words)))
        value.trivia.comment_ws = " " * max(2, 21 - len(f"{key} = {value.as_string()}"))


def find_wiring(base: CarFile, sessions: Sequence[Session]) -> Values:
    """What a car file says beside the car, from drives, where nobody named a car file.

    A drive knows its motor's ERPM per m/s, its mocap body and its limits. A car file with F1TENTH's
    instead would send the driven car off with another car's wiring. Settings that are the base's
    are left out, and all where the drives differ.
    """
    if base.path != default_car_path():
        return {}
    found = [_read_wiring(session) for session in sessions]
    known = _flatten(base.sections)
    same = found[0] if found and all(each == found[0] for each in found) else {}
    return {key: value for key, value in same.items() if known.get(key) != value}


def _read_wiring(session: Session) -> Values:
    """Settings of a session's car file, or what somebody stated of the motor at an import."""
    try:
        return _flatten(read_session_car(session).sections)
    except (SessionError, CarFileError):
        stated = session.info().metadata.get("steerd.scaling", {})
        return {("vesc", key): session.number("steerd.scaling", key, 0.0) for key in stated}


def _flatten(sections: Mapping[str, Mapping[str, Any]]) -> Values:
    return {
        (section, key): value
        for section, table in sections.items()
        if section not in _LEARNT
        for key, value in table.items()
    }


def identified_values(
    outcome: Outcome, base: CarFile, given: Mapping[str, Learned]
) -> dict[str, Learned]:
    """Updates for the base's file: fitted parameters with error and origin, and what is given."""
    # What a stated wheelbase or mass moved, and nothing fitted, is as it was while fitting.
    carried = {
        name: Learned(getattr(outcome.after, name), None, "follows from what was stated")
        for name in ("lf", "lr", "inertia_z")
        if getattr(outcome.after, name) != getattr(base.model.car, name)
    }
    updates, names = {**carried, **given}, ", ".join(outcome.sessions)
    for name, row in outcome.rows.items():
        how, more = "", ""
        if row.free and "." not in name:
            how = f" ({outcome.method})"
            more = "" if row.identifiable else "; not identifiable from these data"
        if name == "steer_delay" and row.free:  # a fitted dead time of the steering contains this
            more += (
                "; half a frame (10 ms) is the mean wait for a pulse of the 50 Hz servo signal"
                if outcome.pulses
                else "; it contains the wait for the servo's next pulse"
            )
        if row.free or row.value != row.start:
            updates[name] = Learned(row.value, row.sd, f"{IDENTIFIED}{how}: {names}{more}")
    return updates


def learn_known(car: CarFile, runs: tuple[Run, ...]) -> Mapping[str, Mapping[str, Any]]:
    """What drives identify beyond a car's values: the size of noise, the joint covariance.

    Other drives of the car are judged by it, cut like these to where the car moves: a standing car
    is quieter. Tables for `with_known`; none where the drives do not identify it.
    """
    try:
        return learn_sections(car, moving_segments(add_command_history(runs, car.model)))
    except (ValueError, FloatingPointError):
        return {}


def with_known(car: CarFile, tables: Mapping[str, Mapping[str, Any]]) -> CarFile:
    """The car with what is known of it beyond its values, for the file beside it."""
    text = encode_posterior(car.numbers, tables)
    return replace(car, sections={**car.sections, **tables}, posterior=text, remark="")
