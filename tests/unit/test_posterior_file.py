"""What identify knows lies beside the car file, and is not believed of other values."""

import json
import tomllib
from pathlib import Path

import pytest

from steerd.car_model.car_file import Learned, default_car_path, load_car, parse_car, update_car
from steerd.daemon.analysis.car_output import with_known
from steerd.daemon.assembly.build import make_plan
from steerd.daemon.assembly.session_meta import make_attachments, read_session_car
from steerd.daemon.common.written import car_outputs, write_outputs
from steerd.daemon.settings.run_options import RunOptions, decode_options, encode_options
from steerd.posterior_file import ATTACHED, encode_posterior, posterior_path
from steerd.steer_bus.session import SessionWriter
from steerd.steer_bus.session_read import open_session

NOISE, KNOWLEDGE = {"position": 1e-3}, {"names": ["lf", "scrub.drag"], "sd": [0.1, 0.2]}
TABLES = {"noise": NOISE, "knowledge": KNOWLEDGE}
BASE = load_car(default_car_path())
IDENTIFIED = update_car(Path("car.toml"), BASE, {"lf": Learned(0.16, 0.01, "steerd identify: a")})


@pytest.fixture
def saved(tmp_path):
    path = tmp_path / "blue.toml"
    write_outputs(car_outputs(path, with_known(IDENTIFIED, TABLES)))
    return path


def tables_of(car):
    return {name: car.sections[name] for name in ("noise", "knowledge") if name in car.sections}


def test_the_car_file_holds_values_and_editable_settings_and_its_neighbour_the_rest(saved):
    assert posterior_path(saved).name == "blue.posterior.json"
    assert not TABLES.keys() & tomllib.loads(saved.read_text()).keys()
    car = load_car(saved)
    assert (tables_of(car), car.remark) == (TABLES, "")
    saved.write_text(saved.read_text().replace("erpm_max = 23250.0", "erpm_max = 20000.0  # safe"))
    assert tables_of(load_car(saved)) == TABLES


def test_a_car_whose_neighbour_is_gone_says_so_and_one_that_never_had_one_does_not(saved):
    posterior_path(saved).unlink()
    car = load_car(saved)
    assert tables_of(car) == {}
    assert car.remark.startswith("blue.posterior.json is missing: ")
    assert BASE.remark == ""


EDITS = {
    "longer": lambda text: text.replace("lf = 0.16", "lf = 0.161"),
    "with an effect": lambda text: f"{text}\n[effects.steer_delay]\ndelay = 0.02\n",
    "other equations": lambda text: text.replace('= "planar"', '= "single_track"'),
}


@pytest.mark.parametrize("edit", EDITS.values(), ids=EDITS)
def test_an_edited_car_keeps_its_noise_and_loses_the_covariance(saved, edit):
    text = saved.read_text()
    assert edit(text) != text
    saved.write_text(edit(text))
    car = load_car(saved)
    assert tables_of(car) == {"noise": NOISE}
    told = "blue.posterior.json is of other values than the car file has now: it is not used"
    assert car.remark == told


@pytest.mark.parametrize(
    "text", ["{", "[1]", '{"schema": "other/1"}', "[" * 9000, "\xff\xfe", "9" * 5000,
             '{"schema": "steerd.posterior/1", "noise": 3}', " " * 4_000_001],
)  # fmt: skip
def test_a_damaged_neighbour_is_said_and_left_out(saved, text):
    posterior_path(saved).write_bytes(text.encode("latin-1"))
    car = load_car(saved)
    assert tables_of(car) == {}
    assert car.remark == "blue.posterior.json is not what identify writes: it is not used"


def _old_file(numbers):
    of = "".join(f"{name} = {value!r}\n" for name, value in numbers.items())
    names = "names = ['lf', 'scrub.drag']\nsd = [0.1, 0.2]\n"
    return f"{BASE.text}\n[noise]\nposition = 0.001\n\n[knowledge]\n{names}[knowledge.of]\n{of}"


def test_a_car_file_from_before_is_read_and_believed_of_its_own_values():
    numbers = dict(BASE.car._asdict())
    old = parse_car(_old_file(numbers), Path("old.toml"))
    assert old.sections["noise"] == NOISE
    assert old.sections["knowledge"]["names"] == KNOWLEDGE["names"]
    # Nothing is known of a dead time on top of the car's; a drag is among what is known.
    late = parse_car(f"{old.text}[effects.steer_delay]\ndelay = 0.02\n", old.path)
    assert "knowledge" in late.sections
    scrubbed = f"{old.text}[effects.scrub]\ndrag = 0.5\n"
    for edited in (_old_file(numbers | {"lf": 0.2}), scrubbed, _old_file({"lf": "x"})):
        car = parse_car(edited, old.path)
        assert tables_of(car) == {"noise": NOISE}
        assert "edited" in car.remark


def test_what_was_kept_keeps_what_was_known_of_it(saved):
    before = posterior_path(saved).read_text()
    other = update_car(saved, IDENTIFIED, {"lf": Learned(0.17, 0.01, "steerd identify: b")})
    write_outputs(car_outputs(saved, with_known(other, {"noise": NOISE})))
    (kept,) = saved.parent.glob("blue.2*.toml")
    assert posterior_path(kept).read_text() == before
    assert tables_of(load_car(kept)) == TABLES
    assert tables_of(load_car(saved)) == {"noise": NOISE}


def test_a_session_and_its_learner_get_both_files(saved, tmp_path):
    plan = make_plan(RunOptions(str(saved), path="line", simulated=True), design=False)
    texts = make_attachments(plan)
    assert texts[ATTACHED] == posterior_path(saved).read_text()
    again = make_plan(decode_options(encode_options(plan.options)), design=False)
    assert again.settings.file.posterior == texts[ATTACHED]
    files = {name: text.encode() for name, text in texts.items()}
    SessionWriter(tmp_path / "a.mcap", {}, {}, files).finish({})
    inside = read_session_car(open_session(tmp_path / "a.mcap"))
    assert (inside.car, tables_of(inside), inside.remark) == (IDENTIFIED.car, TABLES, "")


def test_what_is_known_of_nothing_is_no_missing_file_and_numbers_name_all_that_it_is_of():
    text = encode_posterior(IDENTIFIED.numbers, {})
    assert json.loads(text)["schema"] == "steerd.posterior/1"
    assert parse_car(IDENTIFIED.text, Path("car.toml"), text).remark == ""
    car = parse_car(BASE.text + "[effects.steer_delay]\ndelay = 0.02\n", BASE.path)
    assert (car.numbers["steer_delay.delay"], car.numbers["chassis"]) == (0.02, "planar")
    assert BASE.numbers.keys() < car.numbers.keys()
