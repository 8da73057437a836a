"""One session of a batch, in a worker: its row of the table."""

import tempfile
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from math import isfinite
from pathlib import Path
from typing import Any

from steerd.car_model.car_file import CarFile
from steerd.car_model.params import wheelbase
from steerd.daemon.assembly.session_meta import is_virtual
from steerd.daemon.common.errors import SteerdError
from steerd.daemon.common.screen import clean
from steerd.daemon.many.batch.sources import Question, UnitTask
from steerd.daemon.sessions.info import load_session
from steerd.steer_bus.session_read import SessionInfo

_EARLIEST_NS = 946_684_800_000_000_000
"""The year 2000 [UNIX ns]: a log whose clock began at zero has no date of its own."""
_CAR_MAX = 24
"""Characters of a car's name that are kept."""


def run_unit(task: UnitTask) -> dict[str, Any]:
    """The row of one session.

    Raises:
        SteerdError: the session cannot be used for what is asked.
    """
    if task.content is None:
        return _answer(task.path, task)
    with tempfile.TemporaryDirectory(prefix="steerd-") as folder:
        path = Path(folder) / task.path.name
        path.write_bytes(task.content)
        try:
            return _answer(path, task)
        except SteerdError as error:  # its reader knows the copy alone
            what = error.what.replace(str(path), str(task.path))
            raise SteerdError(what, error.hint, error.code) from None


def _answer(path: Path, task: UnitTask) -> dict[str, Any]:
    info = load_session(path).info()
    car = clean(info.metadata.get("steerd.session", {}).get("car", ""), _CAR_MAX)
    row = {"car": car, "start": find_start(info, task.changed_ns) * 1e-9}
    return row | _ANSWERS[task.question.kind](path, car, task.question)


def find_start(info: SessionInfo, changed_ns: int) -> int:
    """When a drive was driven [UNIX ns]: its own date, else that of the file's last change.

    Drives in virtual time all begin on one date, and logs whose clock began at zero have none.
    """
    virtual = is_virtual(info)
    return changed_ns if virtual or info.start_ns < _EARLIEST_NS else info.start_ns


def day_of(start: float) -> str:
    """The day of a time [UNIX s], in UTC."""
    return f"{datetime.fromtimestamp(start, UTC):%Y-%m-%d}"


def _summarise(path: Path, car: str, question: Question) -> dict[str, Any]:
    from steerd.daemon.sessions.catalogue import summarise

    entry = summarise(path)
    if entry.verdict.startswith("unreadable"):
        raise SteerdError(entry.verdict)
    return {
        "lane": entry.lane,
        "mode": entry.mode,
        "verdict": entry.verdict,
        "seconds": entry.seconds,
        "metres": entry.metres,
        "e1_rms": entry.e1_rms,
        "e1_max": entry.e1_max,
    }


def _identify(path: Path, car: str, question: Question) -> dict[str, Any]:
    from steerd.daemon.analysis.identification import identify
    from steerd.daemon.analysis.options import read_car

    start = _find_car(question, car) or read_car(None)
    # A ruler's length: one drive does not decide a car's scale.
    found = identify(path, car=start, wheelbase=wheelbase(start.car))
    said = found.to_json()
    horizons = said["held_out"]["horizons"]
    row: dict[str, Any] = {
        "verdict": "improved" if found.improved else "no better than the start",
        "prediction": next((h["position"] for h in horizons if h["horizon"] == 1.0), None),
    }
    for name, value in said["parameters"].items():
        if value["sd"] is not None:
            row |= {name: value["value"], f"{name}_sd": value["sd"]}
    return row


def _diagnose(path: Path, car: str, question: Question) -> dict[str, Any]:
    from steerd.daemon.analysis.diagnosis import diagnose

    said = diagnose(path, base=_find_car(question, car), closed_loop=False).to_json()
    row: dict[str, Any] = {
        "verdict": said["verdict"],
        "causes": ", ".join(sorted(cause["effect"] for cause in said["causes"])),
        "gap": said["gap"]["before"]["whitened"],
        "gap_after": said["gap"]["after"]["whitened"],
    }
    for cause in said["causes"]:
        for name, value in cause["parameters"].items():
            if value["sd"] is not None and isfinite(value["value"]):
                column = f"{cause['effect']}.{name}"
                row |= {column: value["value"], f"{column}_sd": value["sd"]}
    return row


def _find_car(question: Question, car: str) -> CarFile | None:
    """The car file of a car; None where the batch names none for it."""
    return question.cars.get(car, question.cars.get(""))


_ANSWERS: Mapping[str, Callable[[Path, str, Question], dict[str, Any]]] = {
    "summarise": _summarise,
    "identify": _identify,
    "diagnose": _diagnose,
}
