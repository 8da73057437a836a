"""`steerd setup`: steps that are commands that parse, and their page in a browser."""

import json
import os
import sys
import urllib.request
from io import StringIO
from pathlib import Path

import pytest
from websockets.sync.client import connect  # noqa: TID251

from steerd.daemon.cli.commands.setup import Step, guide, list_steps, run_step
from steerd.daemon.cli.main import run_cli
from steerd.daemon.process.guide_page import GuidePage, plain_text
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
    ran, typed, results = [], iter(answers), iter(codes)

    def do(step):
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


# The page: a browser sees the steps and answers; the terminal still does.
ABC = [Step(name, f"before {name}", (name,)) for name in "abc"]


@pytest.fixture
def typed():
    """A page, and the end of a pipe that is its terminal's keyboard."""
    read, write = os.pipe()
    with os.fdopen(read) as terminal:
        shown = [{"title": s.title, "before": s.before, "command": s.typed} for s in ABC]
        page = GuidePage(shown, terminal)
        page.open(0)
        yield page, write
        os.close(write)


def until(socket, there):
    """What the page shows once something is there."""
    while not there(seen := json.loads(socket.recv(timeout=20.0))):
        pass
    return seen


def test_buttons_and_keys_both_answer(typed):
    page, keyboard = typed
    with urllib.request.urlopen(page.url) as answer:
        assert b"steerd setup" in answer.read()
    live, origin = page.url.replace("http", "ws") + "live", f"http://{page.url.split('/')[2]}"
    with connect(live, origin=origin) as socket:
        done = []

        def ask(question):
            if page.shown()["at"] == 1:  # the second step is answered on the keyboard
                os.write(keyboard, b"\n")
            else:
                until(socket, lambda seen: bool(seen["asked"]))
                socket.send(f"{page.shown()['at']} do")
            return page.ask(question)

        assert guide(ABC, 0, ask, lambda step: done.append(step.title) or 0, page.stand) == 3
        assert done == ["a", "b", "c"]
        seen = until(socket, lambda seen: seen["steps"][2]["state"] == "done")
        assert [step["state"] for step in seen["steps"]] == ["done", "done", "done"]


@pytest.mark.parametrize("word", ["0 do", "2 skip", "1 rm", "", "1", "do 1"])
def test_a_word_of_another_step_or_of_no_button_answers_nothing(typed, word):
    page, keyboard = typed
    page.stand(1, "asked")
    page.press(word)
    os.write(keyboard, b"s\n")
    assert page.ask("") == "s\n"


def test_nothing_is_answered_while_a_step_runs_and_the_end_of_the_terminal_quits(typed):
    page, keyboard = typed
    page.stand(1, "runs")
    page.press("1 do")
    page.stand(1, "asked")
    page.press("1 skip")
    page.press("1 quit")  # pressed twice: the first counts
    assert page.ask("") == "s"
    os.write(keyboard, b"b\n")
    assert page.ask("") == "b\n"
    page, keyboard = typed
    os.write(keyboard, b"")
    os.dup2(os.open(os.devnull, os.O_WRONLY), keyboard)  # the only writer goes
    assert page.ask("") == "q"


def test_what_a_step_says_is_shown(typed, capfd):
    page, _ = typed
    page.stand(0, "runs")
    script = "import os; print('one\\rtwo', os.get_terminal_size().columns); raise SystemExit(4)"
    assert page.run([sys.executable, "-c", f"print(end='x', flush=True); {script}"]) == 4
    assert "two" in capfd.readouterr().out
    assert page.shown()["steps"][0]["output"].splitlines()[0].startswith("two")


@pytest.mark.parametrize(("output", "shown"), [
    ("a\r\nb\n", "a\nb\n"), ("10 %\r20 %\r\n", "20 %\n"), ("\x1b[32mgreen\x1b[0m", "green"),
    ("one\ntwo\n\x1b[2A\rthree\n", "three\n"), ("\x1b[9A\x1b[?25lx", "x"), ("", ""),
])  # fmt: skip
def test_text_as_the_terminal_shows_it(output, shown):
    assert plain_text(output) == shown


def test_a_port_that_is_taken_is_said(typed):
    port = int(typed[0].url.split(":")[2].split("/")[0])
    with pytest.raises(OSError, match="address"):
        GuidePage([]).open(port)
