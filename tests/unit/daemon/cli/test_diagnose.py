"""`steerd diagnose` on an imported log: what it finds and writes, and what it refuses in a line."""

import contextlib
import hashlib
import io
import json
from pathlib import Path

import pytest

from steerd.car_model.params import DEFAULT_CAR
from steerd.daemon.analysis.diagnosis import DiagnoseOptions, Diagnosis, make_case
from steerd.daemon.analysis.options import Watch, read_arguments
from steerd.daemon.cli.main import run_cli as main
from steerd.daemon.common.errors import SteerdError
from steerd.daemon.common.screen import WIDTH
from tests.contract.command_page import make_parser
from tests.csv_logs import import_log, make_noisy_rows

pytestmark = pytest.mark.slow

TRUE = DEFAULT_CAR._replace(steer_delay=DEFAULT_CAR.steer_delay + 0.05)


@pytest.fixture(scope="module")
def rows():
    return make_noisy_rows(TRUE, 26.0, 2.1)


@pytest.fixture(scope="module")
def diagnosed(rows, tmp_path_factory):
    """One diagnosis with every output, shared by the tests."""
    folder = tmp_path_factory.mktemp("diagnose")
    session = import_log(folder, rows, "run")
    names = {
        "--json": "gap.json", "--report": "gap.html", "-o": "car.toml",
        "--prediction": "prediction.json",
    }  # fmt: skip
    outputs = [arg for flag, name in names.items() for arg in (flag, str(folder / name))]
    screen, error = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(screen), contextlib.redirect_stderr(error):
        code = main(["diagnose", str(session), *outputs, "--no-pairs"])
    assert code == 0, error.getvalue()
    return folder, screen.getvalue(), error.getvalue()


def test_the_screen_names_the_cause_on_one_screen(diagnosed):
    _, screen, _ = diagnosed
    lines = screen.splitlines()
    assert len(lines) <= Diagnosis.SCREEN
    assert max(map(len, lines[:-1])) <= WIDTH
    assert "steer_delay: delay = " in screen
    assert "the default car is assumed" in screen
    assert "cut into blocks of 6.5 s or more" in screen
    assert lines[-1].startswith("next ")
    assert "steerd run --sim --fast --duration 20 --car" in lines[-1]


def test_json_has_exactly_the_shape_of_the_schema(diagnosed):
    data = json.loads((diagnosed[0] / "gap.json").read_text())
    assert list(data) == [
        "schema", "verdict", "gap", "where", "causes", "candidates", "something_else",
        "next_manoeuvre", "residual",
    ]  # fmt: skip
    assert data["schema"] == "steerd.gap/1"
    assert data["verdict"] in ("explained", "partial")
    assert set(data["gap"]) == {"before", "after"}
    assert set(data["where"]) == {
        "stage", "equation", "channels", "windows", "regimes", "sentence"
    }  # fmt: skip
    assert all({"t0", "t1", "share"} <= set(each) for each in data["where"]["windows"])
    assert all(
        {"variable", "low", "high", "ratio", "share"} <= set(r) for r in data["where"]["regimes"]
    )
    cause = data["causes"][0]
    assert set(cause) == {
        "effect", "stage", "family", "parameters", "confidence", "shrink", "ambiguous_with"
    }  # fmt: skip
    assert set(cause["shrink"]) == {"predicted", "measured", "low", "high"}
    assert cause["effect"] == "steer_delay"
    delay = cause["parameters"]["delay"]
    assert delay["value"] == pytest.approx(0.05, abs=0.006)
    assert delay["unit"] == "s"
    assert all(set(each) == {"effect", "probability", "gain"} for each in data["candidates"])
    assert data["residual"]["closed_loop"] is None
    assert any("closed loop not compared" in note for note in data["residual"]["notes"])


def test_the_prediction_is_written_and_hashed_before_it_is_measured(diagnosed):
    folder, screen, error = diagnosed
    prediction = (folder / "prediction.json").read_bytes()
    digest = hashlib.sha256(prediction).hexdigest()
    assert f"predicted before measuring: sha256 {digest[:16]}…" in error
    assert digest[:16] in screen
    assert digest not in screen, "once in full is enough"
    residual = json.loads((folder / "gap.json").read_text())["residual"]
    assert residual["prediction"].encode() == prediction
    assert residual["prediction_sha256"] == digest
    assert digest in (folder / "gap.html").read_text()
    shrink = json.loads((folder / "gap.json").read_text())["causes"][0]["shrink"]
    assert shrink["measured"] > 0.7
    assert json.loads(prediction)["predicted"] == shrink["predicted"]


# --- what is refused


OPTIONS = [
    (["--only", "wings"], 2, "wings"),
    (["--without", "steer_dely"], 2, "steer_dely"),
    (["--only", "steer_lag", "--without", "servo_lag"], 2, "leave no effect"),
    (["--held-out", "1"], 2, "held out 1"),
    (["--held-out", "4,last.mcap"], 2, "not both"),
    (["--report", "nowhere/gap.html"], 3, "nowhere"),
    (["--json", "drive.mcap"], 2, "that is a session"),
    (["--runs-held-out", "{run}"], 2, "every session is held out"),
    (["--healthy", "{run}"], 2, "its gap would pass for noise"),
    (["{run}"], 2, "named twice"),
    (["--report", "."], 3, "that is a folder"),
]


@pytest.mark.parametrize(("options", "code", "words"), OPTIONS, ids=lambda v: str(v)[:40])
def test_options_that_make_no_sense(options, code, words, diagnosed, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    session = str(diagnosed[0] / "run.mcap")
    given = [option.format(run=session) for option in options]
    assert main(["diagnose", session, *given]) == code
    error = capsys.readouterr().err
    assert error.startswith("steerd: ")
    assert words in error
    assert list(tmp_path.iterdir()) == []


# --- what is looked at and what is held out


def case_of(*words):
    args = make_parser("diagnose").parse_args([str(word) for word in words])
    options = read_arguments(DiagnoseOptions, args)
    return make_case([Path(p) for p in args.sessions], options, Watch())[1]


@pytest.fixture(scope="module")
def four(rows, tmp_path_factory):
    folder = tmp_path_factory.mktemp("four")
    return [import_log(folder, rows[i * 650 : (i + 1) * 650], f"run{i}") for i in range(4)]


def test_named_files_are_held_out_even_if_they_are_given_twice(four):
    case = case_of(*four, "--held-out", f"{four[1]},{four[2]}")
    assert set(case.sessions) == {"run0.mcap", "run3.mcap"}
    assert {run.name for run in case.runs} == {"run0.mcap", "run3.mcap"}
    assert {run.name for run in case.later()} == {"run1.mcap", "run2.mcap"}
    assert any("2 sessions, cut into blocks" in note for note in case.notes)


def test_too_few_blocks_for_what_is_asked_are_refused(diagnosed):
    with pytest.raises(SteerdError, match="to hold every 4th out"):
        case_of(diagnosed[0] / "run.mcap", "--held-out", "4")


def test_nothing_is_held_out_on_demand(diagnosed):
    case = case_of(diagnosed[0] / "run.mcap", "--held-out", "0")
    assert case.later is None
    assert any("predicted, not measured" in note for note in case.notes)


def test_healthy_drives_and_the_named_base_are_taken(four, diagnosed):
    case = case_of(
        four[0], "--healthy", f"{four[1]},{four[2]}", "--base", diagnosed[0] / "car.toml"
    )
    assert {run.name for run in case.healthy} == {"run1.mcap", "run2.mcap"}
    assert [effect.name for effect in case.base.effects] == ["steer_delay"]
    assert not any("default car" in note for note in case.notes)


def test_effects_go_by_their_aliases_too(four):
    case = case_of(four[0], "--only", "servo_lag", "--only", "steer_delay", "--without", "mass")
    assert case.asked.only == ("steer_lag", "steer_delay")
    assert case.asked.without == ("mass",)


def test_old_spellings_mean_the_same(four, diagnosed):
    car = diagnosed[0] / "car.toml"
    old = case_of(four[0], four[1], "--runs-held-out", four[1], "--car", car)
    new = case_of(four[0], four[1], "--held-out", four[1], "--base", car)
    assert old.held_out_of == new.held_out_of == "run1.mcap"
    assert old.base_source == new.base_source == str(car)
