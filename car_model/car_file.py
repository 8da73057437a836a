"""Car files: one TOML file that says everything about one car.

`[car]` and `[effects]` belong to this room and are checked to the last key; every other section is
handed on as it stands, for the room that it configures. Writing keeps comments, order and sections.
What identify knows beyond the values lies in a file beside it (`steerd.posterior_file`).
"""

import difflib
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import msgspec
import tomlkit

from steerd.car_model.chassis import Chassis
from steerd.car_model.effect import Effect, EffectParameter
from steerd.car_model.effects import find_effect
from steerd.car_model.model import Model
from steerd.car_model.params import DEFAULT_CAR, PARAMETERS, Car, Parameter
from steerd.car_model.planar import CHASSIS_NAMES, find_chassis
from steerd.car_model.single_track import SINGLE_TRACK
from steerd.posterior_file import TABLES, find_known, posterior_path, read_beside
from steerd.toml_text import TomlError, parse_toml, read_toml

_OWN = ("car", "effects")
IDENTIFIED = "steerd identify"  # begins the source of a value that identify found


class CarFileError(ValueError):
    """A car file that cannot be used."""

    def __init__(self, path: Path, where: str, what: str, hint: str) -> None:
        place = f"{path}: {where}" if where else str(path)
        super().__init__(f"{place}: {what}; try: {hint}")
        self.path = path  # the file
        self.where = where  # the key or line in it, empty for the whole file
        self.what = what  # what is wrong there
        self.hint = hint  # what to try


class Learned(NamedTuple):
    """A new value for one number of a car file."""

    value: float
    sd: float | None = None  # standard error, where it is known
    source: str = ""  # where it comes from: a session, a data sheet


@dataclass(frozen=True)
class CarFile:
    """A car file that was read and found right."""

    path: Path
    name: str
    car: Car[float]
    effects: tuple[Effect, ...] = ()
    values: tuple[tuple[float, ...], ...] = ()
    sd: Mapping[str, float] = field(default_factory=dict)
    """Standard errors by `parameter` or `effect.parameter`."""
    source: Mapping[str, str] = field(default_factory=dict)
    """Where values come from, by `parameter` or `effect.parameter`."""
    sections: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    """All other sections, unchecked; `noise` and `knowledge` from the file beside it."""
    text: str = field(default="", repr=False)
    chassis: Chassis = SINGLE_TRACK  # the equations that `[car] chassis` and `drive` name
    posterior: str = field(default="", repr=False)
    """Text of the file beside it, empty where there is none."""
    remark: str = ""
    """Why what identify knew is not used, as a sentence; empty where it is, or never was."""

    def __repr__(self) -> str:
        return f"<CarFile {self.name!r} of {self.path.name}, {len(self.effects)} effects>"

    @property
    def model(self) -> Model[float]:
        """The car with its effects switched on."""
        return Model(self.car, self.effects, self.values, self.chassis)

    @property
    def numbers(self) -> dict[str, str | float]:
        """Every value by `parameter` or `effect.parameter`, and which equations they are for."""
        found: dict[str, str | float] = {"chassis": self.chassis.name, "drive": self.chassis.drive}
        found |= {name: float(value) for name, value in self.car._asdict().items()}
        for effect, values in zip(self.effects, self.values, strict=True):
            pairs = zip(effect.parameters, values, strict=True)
            found |= {f"{effect.name}.{p.name}": float(value) for p, value in pairs}
        return found


def default_car_path() -> Path:
    """The official F1TENTH car, as it is installed with steerd."""
    return Path(str(files("steerd") / "data" / "f1tenth.toml"))


def load_car(path: Path | str) -> CarFile:
    """Read and check a car file.

    Raises:
        CarFileError: It cannot be read, is no TOML, or says something impossible.
    """
    path = Path(path)
    try:
        return parse_car(read_toml(path), path, read_beside(path))
    except OSError as error:
        hint = "check the path; `steerd config` prints a complete car file"
        raise CarFileError(path, "", f"cannot be read ({error.strerror})", hint) from error
    except TomlError as error:
        raise CarFileError(path, "", str(error), "name a car file: TOML, as UTF-8") from error


def parse_car(text: str, path: Path, posterior: str = "") -> CarFile:
    """Check the text of a car file.

    Args:
        text: of the file.
        path: for messages; it is not opened.
        posterior: text of the file beside it.

    Raises:
        CarFileError: It is no TOML, or says something impossible.
    """
    try:
        tables = parse_toml(text)
    except TomlError as error:
        where, hint = re.search(r"line \d+", str(error)), "write `key = value` under `[section]`"
        raise CarFileError(path, where[0] if where else "", str(error), hint) from error
    for name, table in tables.items():
        if not isinstance(table, dict):
            raise CarFileError(path, name, "is not a section", "put keys under a [section] head")
    if "car" not in tables:
        raise CarFileError(path, "[car]", "is missing", "copy it from `steerd config`")
    numbers = {"c_x": DEFAULT_CAR.c_x, **tables["car"]}  # older files and sessions have none
    own = _checked(path, "car", _table_of(None), numbers)
    try:
        chassis = find_chassis(own.chassis, own.drive)
    except ValueError as error:
        hint = f"chassis = one of {', '.join(CHASSIS_NAMES)}; drive = rear, front or all"
        raise CarFileError(path, "car.chassis", str(error), hint) from error
    car = Car(*(getattr(own, p.name) for p in PARAMETERS))
    sd, source = dict(own.sd), dict(own.source)
    _check_names(path, "car.sd", [*sd, *source], Car._fields)
    effects = tables.get("effects", {}).items()
    settings = [_read_effect(path, name, table, sd, source) for name, table in effects]
    names = [effect.name for effect, _ in settings]
    for name in (each for each in names if names.count(each) > 1):  # under an alias
        raise CarFileError(path, f"effects.{name}", "is given twice", "keep one of the two")
    file = CarFile(
        path=path,
        name=own.name or path.stem,
        car=car,
        effects=tuple(effect for effect, _ in settings),
        values=tuple(values for _, values in settings),
        sd=sd,
        source=source,
        text=text,
        chassis=chassis,
        posterior=posterior,
    )
    beside = posterior_path(path).name
    known, remark = find_known(file.numbers, tables, posterior, beside)
    if not posterior and not known and any(s.startswith(IDENTIFIED) for s in source.values()):
        remark = remark or f"{beside} is missing: what identify knew of this car is not used"
    others = {n: table for n, table in tables.items() if n not in (*_OWN, *TABLES)}
    return replace(file, sections={**others, **known}, remark=remark)


def update_car(path: Path, base: CarFile, updates: Mapping[str, Learned]) -> CarFile:
    """The car file that `base` becomes with new numbers; nothing is written.

    Args:
        path: Where it will lie.
        base: The car file to start from; its comments and every other section are kept.
        updates: New values by `parameter` or `effect.parameter`; an effect that the base does not
            have is added, its other parameters at their nulls.

    Raises:
        CarFileError: The result would not be a right car file.
    """
    document = tomlkit.parse(base.text)
    update_document(document, updates)
    return parse_car(tomlkit.dumps(document), path)


def update_document(document: Any, updates: Mapping[str, Learned]) -> None:
    """Set new numbers in the TOML document of a car file, comments kept; see `update_car`."""
    for name, learned in updates.items():
        owner, dot, parameter = name.rpartition(".")
        if dot:
            table = _effect_table(document, find_effect(owner))
            if table.get("source") != learned.source and learned.source:
                table["source"] = learned.source
        else:
            table = document["car"]
            _note(table, "source", parameter, learned.source or None)
        table[parameter] = float(learned.value)
        _note(table, "sd", parameter, learned.sd)


def _effect_table(document: Any, effect: Effect) -> Any:
    """The effect's table in a TOML document, made where it is absent."""
    effects = document.setdefault("effects", tomlkit.table())
    named = next((n for n in (effect.name, *effect.aliases) if n in effects), effect.name)
    if named not in effects:
        fresh = tomlkit.table()
        for parameter in effect.parameters:
            fresh[parameter.name] = float(parameter.null)
        effects[named] = fresh
    return effects[named]


def _note(table: Any, kind: str, parameter: str, value: float | str | None) -> None:
    """Set or drop one entry of a table's `sd` or `source` sub-table."""
    if value is not None:
        if kind not in table:
            table[kind] = tomlkit.table()
        table[kind][parameter] = value
    elif kind in table:
        table[kind].pop(parameter, None)
        if not table[kind]:
            del table[kind]


@lru_cache(maxsize=256)
def _table_of(effect: Effect | None) -> type[msgspec.Struct]:
    """What an effect's table, or (None) `[car]`, may hold: parameters within their bounds.

    Those of an effect may be absent, which is their null.
    """
    fields: list[Any] = [("sd", dict[str, Annotated[float, msgspec.Meta(ge=0.0)]], _NONE)]
    if effect is None:
        fields += [(p.name, _bounded(p)) for p in PARAMETERS]
        fields += [("name", str, ""), ("chassis", str, SINGLE_TRACK.name), ("drive", str, "all")]
        fields += [("source", dict[str, str], _NONE)]
    else:
        fields += [(p.name, _bounded(p), float(p.null)) for p in effect.parameters]
        fields += [("source", str, "")]
    return msgspec.defstruct("Table", fields, forbid_unknown_fields=True, kw_only=True)


_NONE: Any = msgspec.field(default_factory=dict)


def _bounded(parameter: Parameter | EffectParameter) -> Any:
    """A float within the parameter's bounds, for msgspec."""
    return Annotated[float, msgspec.Meta(ge=float(parameter.low), le=float(parameter.high))]


def _checked(path: Path, where: str, struct: type[msgspec.Struct], table: object) -> Any:
    """The table as the struct.

    Raises:
        CarFileError: It is not one; the message names the key and, where known, its meaning.
    """
    try:
        return msgspec.convert(table, struct)
    except (msgspec.ValidationError, OverflowError) as error:
        what, _, at = str(error).partition(" - at `$")
        key = f"{where}{at.rstrip('`')}"
        missing = re.search(r"field `(\w+)`", what)
        if missing:
            key = f"{where}.{missing[1]}"
        raise CarFileError(path, key, _plain(what), _hint(key)) from error


_KINDS = {"float": "a number", "object": "a table", "str": "text", "bool": "true/false",
          "int": "a whole number"}  # fmt: skip


def _plain(what: str) -> str:
    """A validation message in a user's words."""
    for kind, words in _KINDS.items():
        what = what.replace(f"`{kind}`", words)
    what = re.sub(r"Object missing required field `\w+`", "is missing", what)
    what = re.sub(r"Object contains unknown field `\w+`", "is not known", what)
    return what[:1].lower() + what[1:]


def _hint(key: str) -> str:
    """What to write at a key."""
    name = key.removeprefix("car.")
    near = difflib.get_close_matches(name, [*Car._fields, "name", "chassis", "drive"], n=1)
    if key.startswith("car.") and near and near[0] != name:
        return f"did you mean {near[0]}?"
    for p in PARAMETERS:
        if p.name == name:
            return f"{p.name} = {p.default:g}  # {p.unit}, {p.meaning}; {p.low:g} to {p.high:g}"
    return "compare with `steerd config`" if key.startswith("car") else "see `steerd effects`"


def _read_effect(
    path: Path, name: str, table: object, sd: dict[str, float], source: dict[str, str]
) -> tuple[Effect, tuple[float, ...]]:
    """One table of `[effects]`; what is known about its values goes into `sd` and `source`."""
    where = f"effects.{name}"
    try:
        effect = find_effect(name)
    except ValueError as error:
        raise CarFileError(path, where, str(error), "see `steerd effects`") from error
    own = _checked(path, where, _table_of(effect), table)
    names = [p.name for p in effect.parameters]
    _check_names(path, f"{where}.sd", list(own.sd), names)
    sd.update({f"{effect.name}.{key}": value for key, value in own.sd.items()})
    if own.source:
        source.update({f"{effect.name}.{key}": own.source for key in names})
    return effect, tuple(getattr(own, key) for key in names)


def _check_names(path: Path, where: str, names: list[str], known: Any) -> None:
    """Refuse notes about parameters that do not exist."""
    for name in names:
        if name not in known:
            raise CarFileError(path, where, f"no parameter {name!r}", f"one of {', '.join(known)}")
