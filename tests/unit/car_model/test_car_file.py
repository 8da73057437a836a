"""Car files: read strictly, errors in plain words, written with care."""

import re
import tomllib
from pathlib import Path

import pytest

from steerd.car_model import car_file
from steerd.car_model.car_file import CarFileError, Learned, default_car_path, load_car, parse_car
from steerd.car_model.effects import EFFECTS
from steerd.car_model.params import DEFAULT_CAR, PARAMETERS
from steerd.car_model.planar import make_planar
from steerd.car_model.single_track import SINGLE_TRACK

HERE = Path("car.toml")
TEXT = default_car_path().read_text(encoding="utf-8")


def edited(old: str, new: str) -> str:
    """The default file with the first line that starts with `old` replaced."""
    text, count = re.subn(rf"(?m)^{re.escape(old)}.*$", lambda _: new, TEXT, count=1)
    assert count == 1
    return text


def error(text: str) -> CarFileError:
    with pytest.raises(CarFileError) as caught:
        parse_car(text, HERE)
    said = str(caught.value)
    assert said.startswith("car.toml: ")
    assert "; try: " in said
    assert "\n" not in said
    assert len(said) < 700
    return caught.value


def test_the_shipped_file_is_the_default_car_with_every_section():
    file = load_car(default_car_path())
    assert file.car == DEFAULT_CAR
    assert file.model[1:] == ((EFFECTS["tyre_saturation"],), ((1.0, 0.0),), make_planar("all"))
    assert set(file.sections) == {
        "vesc", "mocap", "limits", "controller", "estimator", "record", "safety",
    }  # fmt: skip
    assert file.name == "F1TENTH, published figures"
    official = {
        "erpm_gain": 4614.0, "erpm_offset": 0.0, "erpm_max": 23250.0, "servo_gain": -1.2135,
        "servo_offset": 0.5304, "servo_min": 0.15, "servo_max": 0.85,
    }  # fmt: skip
    assert official.items() <= file.sections["vesc"].items()


def test_effects_and_notes_are_read():
    text = TEXT + (
        '\n[car.sd]\nlf = 0.001\n[car.source]\nlf = "tape"\n'
        '[effects.backlash]\nplay = 0.02\nsd = { play = 0.003 }\nsource = "diagnose"\n'
        "[effects.floor_slope]\ny = 0.01\n"
    )
    file = parse_car(text, HERE)
    assert [e.name for e in file.effects] == ["tyre_saturation", "steer_backlash", "floor_slope"]
    assert file.values == ((1.0, 0.0), (0.02,), (0.0, 0.01, 0.0))
    assert file.sd == {"lf": 0.001, "steer_backlash.play": 0.003}
    assert file.source == {"lf": "tape", "steer_backlash.play": "diagnose"}


@pytest.mark.parametrize("p", PARAMETERS, ids=lambda p: p.name)
def test_every_parameter_must_be_there_within_bounds(p):
    if p.name != "c_x":  # which older files and sessions have not
        assert error(edited(f"{p.name} ", "")).where == f"car.{p.name}"
    for value in (p.high * 1.01 + 0.01, p.low - 0.01 - abs(p.low), float("nan"), float("inf")):
        found = error(edited(f"{p.name} ", f"{p.name} = {value}"))
        assert found.where == f"car.{p.name}"
        assert p.meaning in found.hint
    for ok in (p.low, p.high):
        assert getattr(parse_car(edited(f"{p.name} ", f"{p.name} = {ok}"), HERE).car, p.name) == ok


@pytest.mark.parametrize(("text", "where", "what"), [
    ("", "[car]", "is missing"), ("[vesc]\nerpm_gain = 1\n", "[car]", "is missing"),
    ("[car]\n", "car.lf", "is missing"), ("car = 3\n", "car", "is not a section"),
    ("x = 3\n" + TEXT, "x", "is not a section"), ("[[car]]\n", "car", "is not a section"),
    ("[car\n", "line 1", "Expected"), (TEXT + "[car]\n", "line", "Cannot declare"),
    (edited("lf ", "lf = true"), "car.lf", "expected a number, got true/false"),
    (edited("lf ", "lf = 'wide'"), "car.lf", "expected a number, got text"),
    (edited("lf ", "lf = []"), "car.lf", "expected a number"),
    (edited("lf ", "lf = 1979-05-27"), "car.lf", "expected a number"),
    (edited("lf ", "lf = " + "9" * 400), "car.lf", ""),
    (edited("lf ", "lf = 0.1\nlz = 0.1"), "car.lz", "is not known"),
    (edited("name ", "name = 3"), "car.name", "expected text"),
    (edited("chassis ", "chassis = 2"), "car.chassis", "expected text"),
    (edited("chassis ", 'chassis = "bicycle"'), "car.chassis", "no chassis 'bicycle'"),
    (TEXT.replace('drive = "all"', 'drive = "left"', 1), "car.chassis", "drive is 'left'"),
    (TEXT + "[car.sd]\nlz = 1\n", "car.sd", "no parameter 'lz'"),
    (TEXT + "[car.sd]\nlf = -1\n", "car.sd", "expected a number >= 0"),
    (TEXT + "[effects]\nx = 1\n", "effects.x", "no effect 'x'"),
    (TEXT + "[effects]\nmass = 1\n", "effects.mass", "expected a table"),
    (TEXT + "[effects.mass]\npayload = 99\n", "effects.mass.payload", "expected a number <= 5"),
    (TEXT + "[effects.mass]\nload = 1\n", "effects.mass.load", "is not known"),
    (TEXT + "[effects.mass]\n[effects.payload]\n", "effects.mass", "is given twice"),
    (TEXT + "[effects.mass.sd]\nload = 1\n", "effects.mass.sd", "no parameter"),
    (TEXT + "\nx = " + "[" * 50_000, "", "nested too deeply"), ("\0", "line 1", ""),
])  # fmt: skip
def test_a_wrong_file_is_refused_with_place_and_reason(text, where, what):
    found = error(text)
    assert where in found.where
    assert what in found.what


@pytest.mark.parametrize(("content", "what"), [
    (None, "cannot be read"),
    (b"\xff\xfe[car]", "not UTF-8"),
    (b"#" * 1_000_001, "larger than 1 MB"),
])  # fmt: skip
def test_unreadable_files(tmp_path, content, what):
    path = tmp_path / "car.toml"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(CarFileError, match=what):
        load_car(path)
    with pytest.raises(CarFileError, match="cannot be read"):
        load_car(tmp_path)


def test_saving_keeps_comments_sections_and_order(tmp_path):
    base = load_car(default_car_path())
    assert car_file.update_car(base.path, base, {}).text == TEXT
    path = tmp_path / "learned.toml"
    learned = {"c_sf": Learned(5.1, 0.02, "session a")}
    learned["steer_delay.delay"] = Learned(0.03, 0.001, "diagnose")
    new = car_file.update_car(path, base, learned)
    path.write_text(new.text, encoding="utf-8")
    assert new == load_car(path)
    assert new.car == DEFAULT_CAR._replace(c_sf=5.1)
    assert new.effects == (*base.effects, EFFECTS["steer_delay"])
    assert new.values == (*base.values, (0.03,))
    assert new.sd == {"c_sf": 0.02, "steer_delay.delay": 0.001}
    assert new.source == {"c_sf": "session a", "steer_delay.delay": "diagnose"}
    assert new.sections == base.sections
    comments = [line.partition("#")[2] for line in TEXT.splitlines() if "#" in line]
    assert [c for c in comments if c not in new.text] == []


def test_saving_again_replaces_notes_and_effects(tmp_path):
    path = tmp_path / "car.toml"
    path.write_text(TEXT + "[effects.backlash]\nplay = 0.01\n", encoding="utf-8")
    learned = {"lf": Learned(0.16, 0.01, "tape"), "steer_backlash.play": Learned(0.02)}
    first = car_file.update_car(path, load_car(path), learned)
    last = car_file.update_car(path, first, {"lf": Learned(0.161)})
    assert (last.car.lf, last.values) == (0.161, ((1.0, 0.0), (0.02,)))
    assert not last.sd | last.source
    told = tomllib.loads(last.text)["effects"]
    assert told == {"tyre_saturation": {"q": 1.0}, "backlash": {"play": 0.02}}


def test_an_update_is_checked_as_a_car_file_is(tmp_path):
    path, base = tmp_path / "a.toml", load_car(default_car_path())
    for name, value, said in (("lf", 99.0, "lf"), ("lf", float("nan"), "lf"), ("lz", 1.0, "lz"),
                              ("nothing.x", 1.0, "no effect 'nothing'")):  # fmt: skip
        with pytest.raises(ValueError, match=said):
            car_file.update_car(path, base, {name: Learned(value)})
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("drive", ["rear", "front", "all"])
def test_the_chassis_is_the_one_that_the_file_names(drive):
    found = parse_car(TEXT.replace('drive = "all"', f'drive = "{drive}"', 1), HERE)
    assert found.chassis is make_planar(drive)
    assert found.model.chassis is found.chassis
    assert parse_car(edited("chassis ", ""), HERE).chassis is SINGLE_TRACK
