"""Drives with a hidden effect: what a diagnosis finds, writes, and holds out."""

import contextlib
import hashlib
import io
import json
import re
from pathlib import Path

import pytest

from steerd.car_model.car_file import default_car_path, load_car
from steerd.car_model.params import DEFAULT_CAR
from steerd.daemon.analysis.diagnosis import DiagnoseOptions, Diagnosis, make_case
from steerd.daemon.analysis.gap_closed_loop import try_lane
from steerd.daemon.analysis.options import Watch, read_arguments
from steerd.daemon.cli.main import run_cli
from steerd.daemon.common.errors import SteerdError
from steerd.daemon.common.screen import WIDTH
from steerd.steer_bus.session_read import open_session
from tests.contract.command_page import make_parser
from tests.csv_logs import import_log, make_noisy_rows
from tests.e2e.conftest import make_drive_plan

pytestmark = pytest.mark.slow
LANE = "--path figure8 --speed 1.8"
DELAY = 0.05


def quietly(*argv):
    screen, error = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(screen), contextlib.redirect_stderr(error):
        code = run_cli([str(word) for word in argv])
    assert code == 0, error.getvalue()
    return screen.getvalue(), error.getvalue()


@pytest.fixture(scope="module")
def late(tmp_path_factory):
    """A lane drive of a car whose steering is late, and everything that a diagnosis writes."""
    folder = tmp_path_factory.mktemp("late")
    session = folder / "late.mcap"
    quietly("run", "--sim", "--fast", *LANE.split(), "--duration", 24, "--record", session,
            "--effect", f"steer_delay={DELAY}")  # fmt: skip
    opened, whole = [], Path.open

    def note(path, *args, **kwargs):
        opened.append(path)
        return whole(path, *args, **kwargs)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Path, "open", note)
        said = quietly("diagnose", session, "--no-pairs", "--json", folder / "gap.json",
                       "--report", folder / "gap.html", "-o", folder / "car.toml",
                       "--prediction", folder / "prediction.json")  # fmt: skip
    assert opened.count(session) == 1
    return folder, said, json.loads((folder / "gap.json").read_text())


def test_late_steering_is_found_from_a_lane_drive(late):
    """On so smooth a lane dead time and lag look alike; then both names are there."""
    folder, (screen, _), told = late
    cause = told["causes"][0]
    named = {cause["effect"], *cause["ambiguous_with"]}
    assert "steer_delay" in named
    assert cause["effect"] in ("steer_delay", "steer_lag")
    assert len(named) <= 3
    (found,) = cause["parameters"].values()
    assert abs(found["value"] - DELAY) < max(0.2 * DELAY, 3.0 * found["sd"])
    assert told["where"]["equation"][0]["name"] == "steer"
    assert "base: the car file inside the session" in screen
    assert len(screen.splitlines()) <= (26 if cause["ambiguous_with"] else 24) < Diagnosis.SCREEN
    assert "\nnext " in screen
    said = [line for line in screen.splitlines() if not re.search(rf"`steerd |{folder}", line)]
    assert max(map(len, said)) <= WIDTH, "but for what is to be copied"


def test_json_has_exactly_the_shape_of_the_schema(late):
    told = late[2]
    assert list(told) == [
        "schema", "verdict", "gap", "where", "causes", "candidates", "something_else",
        "next_manoeuvre", "residual",
    ]  # fmt: skip
    assert told["schema"] == "steerd.gap/1"
    assert told["verdict"] in ("explained", "partial")
    assert set(told["gap"]) == {"before", "after"}
    where = {"stage", "equation", "channels", "windows", "regimes", "sentence"}
    assert set(told["where"]) == where
    assert all({"t0", "t1", "share"} <= set(each) for each in told["where"]["windows"])
    regime = {"variable", "low", "high", "ratio", "share"}
    assert all(regime <= set(each) for each in told["where"]["regimes"])
    cause = told["causes"][0]
    assert set(cause) == {
        "effect", "stage", "family", "parameters", "confidence", "shrink", "ambiguous_with"
    }  # fmt: skip
    assert set(cause["shrink"]) == {"predicted", "measured", "low", "high"}
    assert all(each["unit"] == "s" for each in cause["parameters"].values())
    assert all(set(each) == {"effect", "probability", "gain"} for each in told["candidates"])
    assert not any("tyre_saturation" in each["effect"] for each in told["candidates"])
    named = sum(each["probability"] for each in told["candidates"])
    assert named + told["something_else"] == pytest.approx(1.0)


def test_the_prediction_is_written_and_hashed_before_it_is_measured(late):
    folder, (screen, error), told = late
    prediction = (folder / "prediction.json").read_bytes()
    digest = hashlib.sha256(prediction).hexdigest()
    assert f"predicted before measuring: sha256 {digest[:16]}…" in error
    assert digest[:16] in screen
    assert digest not in screen, "once in full is enough"
    assert told["residual"]["prediction"].encode() == prediction
    assert told["residual"]["prediction_sha256"] == digest
    assert digest in (folder / "gap.html").read_text()
    shrink = told["causes"][0]["shrink"]
    assert shrink["measured"] > 0.7
    assert json.loads(prediction)["predicted"] == shrink["predicted"]


def test_the_lane_driven_again_resembles_the_recording_more_with_the_effect(late):
    _, (screen, _), told = late
    loop = told["residual"]["closed_loop"]
    assert loop["nearer"] is True
    before, after = loop["distance"]["without"], loop["distance"]["with_effect"]
    assert after["e1"] < 0.3 * before["e1"]
    assert after["e2"] < before["e2"]
    recorded, again = loop["drives"]["recorded"], loop["drives"]["with_effect"]
    assert again["e1_rms"] == pytest.approx(recorded["e1_rms"], rel=0.3)
    assert "closer to late.mcap in" in " ".join(screen.split())


def test_the_last_line_can_be_typed_and_a_controller_designed_from_the_new_car_file(late, tmp_path):
    folder, (screen, _), _ = late
    words = re.search(r"steerd (run --sim.*)", screen)[1].split()
    words[words.index("--duration") + 1] = "2"
    assert str(folder / "car.toml") in words
    quietly(*words, "--record", tmp_path / "again.mcap")
    plans = (make_drive_plan(f"{LANE} {more}") for more in ("", f"--car {folder / 'car.toml'}"))
    old, new = (plan.controller.report.timing for plan in plans)
    assert new.delay_s + new.lag_s > old.delay_s + old.lag_s + 0.03


def test_steps_of_steering_tell_dead_time_by_its_name(tmp_path):
    session = tmp_path / "steps.mcap"
    quietly("collect", "--plan", "steps", "--box", 14, "--sim", "--fast", "--duration", 20,
            "--record", session, "--effect", f"steer_delay={DELAY}")  # fmt: skip
    told = json.loads(quietly("diagnose", session, "--no-pairs", "--json")[0])
    cause = told["causes"][0]
    assert cause["effect"] == "steer_delay"
    assert cause["parameters"]["delay"]["value"] == pytest.approx(DELAY, rel=0.1)
    assert cause["confidence"] > 0.7
    assert told["residual"]["closed_loop"] is None
    assert any("excitation plan" in note for note in told["residual"]["notes"])


def test_too_short_a_lane_drive_is_said(tmp_path):
    session = tmp_path / "short.mcap"
    quietly("run", "--sim", "--fast", "--path", "line", "--duration", 3, "--record", session)
    told, why = try_lane([open_session(session)], load_car(default_car_path()), {})
    assert told is None
    assert "less than 9 s" in why


# --- what is looked at and what is held out
def case_of(*words):
    args = make_parser("diagnose").parse_args([str(word) for word in words])
    options = read_arguments(DiagnoseOptions, args)
    return make_case([Path(p) for p in args.sessions], options, Watch())[1]


@pytest.fixture(scope="module")
def four(tmp_path_factory):
    """A drive as four imported logs."""
    folder = tmp_path_factory.mktemp("four")
    car = DEFAULT_CAR._replace(steer_delay=DEFAULT_CAR.steer_delay + DELAY)
    rows = make_noisy_rows(car, 26.0, 2.1)
    return [import_log(folder, rows[i * 650 : (i + 1) * 650], f"run{i}") for i in range(4)]


def test_the_prediction_stands_before_a_reserved_session_is_opened(four, tmp_path, capsys):
    broken, told = tmp_path / "broken.mcap", tmp_path / "prediction.json"
    broken.write_bytes(b"nothing")
    words = ["diagnose", str(four[0]), "--held-out", str(broken), "--prediction", str(told),
             "--no-pairs", "--no-closed-loop", "--only", "steer_delay", "--json"]  # fmt: skip
    assert run_cli(words) in (3, 4)
    said = capsys.readouterr()
    assert said.out == ""
    assert hashlib.sha256(told.read_bytes()).hexdigest()[:16] in said.err
    assert "broken.mcap" in said.err.splitlines()[-1]


def test_named_files_are_held_out_even_if_they_are_given_twice(four):
    case = case_of(*four, "--held-out", f"{four[1]},{four[2]}")
    assert set(case.sessions) == {"run0.mcap", "run3.mcap"}
    assert {run.name for run in case.runs} == {"run0.mcap", "run3.mcap"}
    assert {run.name for run in case.later()} == {"run1.mcap", "run2.mcap"}
    assert any("2 sessions, cut into blocks" in note for note in case.notes)


def test_too_few_blocks_for_what_is_asked_are_refused_and_on_demand_nothing_is_held_out(four):
    with pytest.raises(SteerdError, match="to hold every 4th out"):
        case_of(four[0], "--held-out", "4")
    case = case_of(four[0], "--held-out", "0")
    assert case.later is None
    assert any("predicted, not measured" in note for note in case.notes)


def test_healthy_drives_and_the_named_base_are_taken(four, late):
    given = (four[0], "--healthy", f"{four[1]},{four[2]}")
    case = case_of(*given, "--base", late[0] / "car.toml")
    assert {run.name for run in case.healthy} == {"run1.mcap", "run2.mcap"}
    hidden = late[2]["causes"][0]["effect"]
    assert [effect.name for effect in case.base.effects] == ["tyre_saturation", hidden]
    assert not any("the default car is assumed" in note for note in case.notes)
    assert any("the default car is assumed" in note for note in case_of(*given).notes)


def test_effects_go_by_their_aliases_too_and_the_base_by_identifys_word(four, late):
    case = case_of(four[0], "--only", "servo_lag", "--only", "steer_delay", "--without", "mass")
    assert (case.asked.only, case.asked.without) == (("steer_lag", "steer_delay"), ("mass",))
    car = late[0] / "car.toml"
    for word in ("--car", "--base"):
        case = case_of(four[0], four[1], "--held-out", four[1], word, car)
        assert (case.held_out_of, case.base_source) == ("run1.mcap", str(car))
