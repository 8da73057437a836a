"""Simulated drives with a hidden effect: recorded, diagnosed by the command line, driven again."""

import contextlib
import hashlib
import io
import json
import re
from pathlib import Path

import pytest

from steerd.car_model.car_file import default_car_path, load_car
from steerd.daemon.analysis.gap_closed_loop import try_lane
from steerd.daemon.cli.main import run_cli
from steerd.steer_bus.session_read import open_session
from tests.e2e.conftest import make_drive_plan

LANE = "--path figure8 --speed 1.8"
DELAY = 0.05


def quietly(*argv):
    screen, error = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(screen), contextlib.redirect_stderr(error):
        code = run_cli([str(word) for word in argv])
    assert code == 0, error.getvalue()
    return screen.getvalue()


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
        screen = quietly("diagnose", session, "--no-pairs", "--json", folder / "gap.json",
                         "--report", folder / "gap.html", "-o", folder / "car.toml")  # fmt: skip
    assert opened.count(session) == 1
    return folder, screen, json.loads((folder / "gap.json").read_text())


def test_late_steering_is_found_from_a_lane_drive(late):
    """On so smooth a lane dead time and lag look alike; then both names are there."""
    _, screen, told = late
    cause = told["causes"][0]
    named = {cause["effect"], *cause["ambiguous_with"]}
    assert "steer_delay" in named
    assert cause["effect"] in ("steer_delay", "steer_lag")
    assert len(named) <= 3
    (found,) = cause["parameters"].values()
    assert abs(found["value"] - DELAY) < max(0.2 * DELAY, 3.0 * found["sd"])
    assert told["where"]["equation"][0]["name"] == "steer"
    assert "base: the car file inside the session" in screen
    assert len(screen.splitlines()) <= (26 if cause["ambiguous_with"] else 24)


def test_the_lane_driven_again_resembles_the_recording_more_with_the_effect(late):
    _, screen, told = late
    loop = told["residual"]["closed_loop"]
    assert loop["nearer"] is True
    before, after = loop["distance"]["without"], loop["distance"]["with_effect"]
    assert after["e1"] < 0.3 * before["e1"]
    assert after["e2"] < before["e2"]
    recorded, again = loop["drives"]["recorded"], loop["drives"]["with_effect"]
    assert again["e1_rms"] == pytest.approx(recorded["e1_rms"], rel=0.3)
    assert "closer to late.mcap in" in " ".join(screen.split())


def test_the_last_line_can_be_typed(late, tmp_path):
    folder, screen, _ = late
    words = re.search(r"steerd (run --sim.*)", screen)[1].split()
    words[words.index("--duration") + 1] = "2"
    assert str(folder / "car.toml") in words
    quietly(*words, "--record", tmp_path / "again.mcap")


def test_a_controller_is_designed_from_the_new_car_file(late):
    old, new = (
        make_drive_plan(f"{LANE} {more}").controller.report.timing
        for more in ("", f"--car {late[0] / 'car.toml'}")
    )
    assert new.delay_s + new.lag_s > old.delay_s + old.lag_s + 0.03


def test_steps_of_steering_tell_dead_time_by_its_name(tmp_path):
    session = tmp_path / "steps.mcap"
    quietly("collect", "--plan", "steps", "--box", 14, "--sim", "--fast", "--duration", 20,
            "--record", session, "--effect", f"steer_delay={DELAY}")  # fmt: skip
    told = json.loads(quietly("diagnose", session, "--no-pairs", "--json"))
    cause = told["causes"][0]
    assert cause["effect"] == "steer_delay"
    assert cause["parameters"]["delay"]["value"] == pytest.approx(DELAY, rel=0.1)
    assert cause["confidence"] > 0.7
    assert told["residual"]["closed_loop"] is None
    assert any("excitation plan" in note for note in told["residual"]["notes"])


def test_the_prediction_stands_before_a_reserved_session_is_opened(late, tmp_path, capsys):
    broken, told = tmp_path / "broken.mcap", tmp_path / "prediction.json"
    broken.write_bytes(b"nothing")
    session = str(late[0] / "late.mcap")
    words = ["diagnose", session, "--held-out", str(broken), "--prediction", str(told),
             "--no-pairs", "--no-closed-loop", "--only", "steer_delay", "--json"]  # fmt: skip
    assert run_cli(words) in (3, 4)
    said = capsys.readouterr()
    assert said.out == ""
    assert hashlib.sha256(told.read_bytes()).hexdigest()[:16] in said.err
    assert "broken.mcap" in said.err.splitlines()[-1]


def test_too_short_a_lane_drive_is_said(tmp_path):
    session = tmp_path / "short.mcap"
    quietly("run", "--sim", "--fast", "--path", "line", "--duration", 3, "--record", session)
    told, why = try_lane([open_session(session)], load_car(default_car_path()), {})
    assert told is None
    assert "less than 9 s" in why
