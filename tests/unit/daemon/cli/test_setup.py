"""`steerd setup`: its steps are commands that parse, and go on only when they succeed."""

from io import StringIO
from pathlib import Path

import pytest

from steerd.daemon.cli.commands.setup import Step, guide, list_steps, run_step
from steerd.daemon.cli.main import run_cli
from tests.contract.command_page import make_parser

STEPS = list_steps("/dev/ttyACM0", "natnet://h/car", Path("made here"))


@pytest.mark.parametrize("step", STEPS, ids=lambda step: step.title)
def test_every_step_is_a_command_as_a_user_would_type_it(step):
    make_parser(step.words[0]).parse_args(step.words[1:])


@pytest.mark.parametrize(("answers", "codes", "done", "ended"), [
    (["", "", ""], [0, 0, 0], "abc", 3),
    (["", "", "", ""], [0, 4, 0, 0], "abbc", 3),  # what failed is offered again
    (["s", "", "b", "", "q"], [0, 0], "bb", 2), (["", "q"], [0], "a", 1),
    (["what", "", "q"], [0], "a", 1),  # an unknown key does nothing
])  # fmt: skip
def test_steps_go_on_when_they_succeeded(answers, codes, done, ended):
    ran: list[str] = []
    typed, results = iter(answers), iter(codes)

    def do(step: Step) -> int:
        ran.append(step.title)
        return next(results)

    steps = [Step(name, "", (name,)) for name in "abc"]
    assert guide(steps, 0, lambda question: next(typed), do) == ended
    assert "".join(ran) == done


def test_the_end_of_standard_input_quits_and_says_where_to_go_on(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("sys.stdin", StringIO())
    words = ["setup", "--port", "/dev/vesc", "--mocap", "vrpn://h/car", "--folder", str(tmp_path)]
    assert run_cli([*words, "--from", "3"]) != 0
    assert "--from 3" in capsys.readouterr().out
    assert run_cli([*words, "--from", "30"]) != 0


def test_a_drive_that_is_repeated_keeps_the_one_before(tmp_path):
    (drive := tmp_path / "slow.mcap").write_text("before")
    run_step(Step("", "", ("effects", "--record", f"{drive}")))
    assert [path.read_text() for path in tmp_path.iterdir() if path != drive] == ["before"]


def test_a_car_file_that_is_there_stays(tmp_path):
    config = next(step for step in list_steps("p", "m", tmp_path) if step.makes)
    assert run_step(config) == 0
    assert "lf" in (tmp_path / "car.toml").read_text()
    (tmp_path / "car.toml").write_text("mine")
    assert run_step(config) == 0
    assert (tmp_path / "car.toml").read_text() == "mine"
    failing = config._replace(words=("config", "--check", "x.toml"), makes=tmp_path / "x.toml")
    assert run_step(failing) != 0
    assert not (tmp_path / "x.toml").exists()
