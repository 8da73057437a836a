"""The command line's last resorts: a bug, a reader that is gone, a key pressed in the middle."""

import contextlib
import errno
import io
import os
import shutil
import subprocess
import sys
import warnings
from argparse import Namespace
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import Mock

import pytest

from steerd.car_model.native.library import load_library
from steerd.daemon.cli import main
from steerd.daemon.cli.commands.learning import present
from steerd.daemon.cli.main import COMMANDS, run_cli
from steerd.daemon.common.errors import ExitCode, SteerdError

EFFECTS = "steerd.daemon.cli.commands.car_files.effects"


def test_the_page_is_written_though_nobody_reads_the_screen(monkeypatch):
    ours, theirs = os.pipe()
    os.close(ours)
    found = SimpleNamespace(to_json=dict, describe=lambda *_: "", render_report=lambda: "page")
    args, written = Namespace(output=None, json=None, report=Path("a.html")), {}
    with contextlib.suppress(BrokenPipeError), os.fdopen(theirs, "w") as screen:
        monkeypatch.setattr(sys, "stdout", screen)
        present(found, args, lambda path, text: written.update({path: text}))
    assert written[args.report] == "page"


@pytest.mark.parametrize(("raised", "code", "what", "last"), [
    (ZeroDivisionError("in a command"), 70, "ZeroDivisionError: in a command",
     "steerd: this is a bug in steerd; please report the lines above"),
    *((OSError(number, os.strerror(number), "/srv/cache"), 3,
       f"steerd: /srv/cache: {os.strerror(number)}",
       "   try: look at its owner, its rights and its mount")
      for number in (errno.EROFS, errno.EACCES, errno.ENOTDIR)),
], ids=lambda v: str(v)[:30])  # fmt: skip
def test_what_goes_wrong_is_told_as_what_it_is(raised, code, what, last, monkeypatch, cli):
    monkeypatch.setattr(EFFECTS, Mock(side_effect=raised))
    assert cli("effects", code=code).err.splitlines()[-2:] == [what, last]


def test_equations_that_were_not_compiled_are_a_line_with_the_command(monkeypatch, cli):
    monkeypatch.setattr(EFFECTS, lambda args: load_library(Path("/none.so")))
    (line,) = cli("effects", code=ExitCode.UNREADABLE).err.splitlines()
    assert line.startswith("steerd: the compiled equations")
    assert line.endswith("build them with: python -m steerd.car_model.native.build")


def test_own_warnings_are_told_as_errors_are_and_others_with_their_place(monkeypatch, cli):
    ours = type("Told", (UserWarning,), {"__module__": "steerd.somewhere"})

    def warned(args):
        with warnings.catch_warnings():
            warnings.simplefilter("always")
            warnings.showwarning = main.show_warning
            warnings.warn("/srv/cache: full", ours, stacklevel=1)
            warnings.warn("of a library", RuntimeWarning, stacklevel=1)
        return 0

    monkeypatch.setattr(EFFECTS, warned)
    first, second, *_ = cli("effects").err.splitlines()
    assert first == "steerd: /srv/cache: full"
    assert "test_main.py" in second
    assert second.endswith("RuntimeWarning: of a library")


@pytest.mark.parametrize("name", ["", *COMMANDS])
def test_help_fits_80_columns(name, monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "80")
    with pytest.raises(SystemExit) as ended:
        run_cli([*name.split(), "--help"])
    assert ended.value.code == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith(f"usage: steerd {name}")
    assert [line for line in lines if len(line) > 80] == []
    assert name or set(COMMANDS) <= {line.split()[0] for line in lines if line.startswith("  ")}


def test_an_error_is_wrapped_on_a_terminal_and_is_one_line_in_a_pipe(monkeypatch, capsys):
    what, hint = "the car file says something impossible " * 4, "change it"
    failing = Mock(side_effect=SteerdError(what.strip(), hint, ExitCode.INVALID))
    monkeypatch.setattr(EFFECTS, failing)
    monkeypatch.setenv("COLUMNS", "80")
    assert run_cli(["effects"]) == ExitCode.INVALID
    assert capsys.readouterr().err == f"steerd: {what.strip()}\n   try: change it\n"
    terminal = io.StringIO()
    terminal.isatty = lambda: True
    monkeypatch.setattr(sys, "stderr", terminal)
    assert run_cli(["effects"]) == ExitCode.INVALID
    lines = terminal.getvalue().splitlines()
    assert max(map(len, lines)) <= 80
    assert len(lines) == 4
    assert lines[1].startswith("        ")


def test_help_shows_the_first_options_with_defaults_and_help_all_the_rest(capsys):
    texts = []
    for option in ("--help", "--help-all"):
        with pytest.raises(SystemExit):
            run_cli(["run", option])
        texts.append(" ".join(capsys.readouterr().out.split()))
    short, whole = texts
    assert "--path" in short
    assert "(default: figure8)" in short
    assert "--ros-domain" not in short
    assert "`steerd run --help-all` shows " in short
    assert "--ros-domain" in whole


# The completion scripts; bash's is run as bash runs it.
BASH = shutil.which("bash")


@pytest.fixture(scope="module")
def script(tmp_path_factory):
    path = tmp_path_factory.mktemp("completion") / "steerd.bash"
    with path.open("w") as file, contextlib.redirect_stdout(file):
        assert run_cli(["completion", "bash"]) == 0
    return path


def complete(script, *typed):
    line = " ".join(f'"{word}"' for word in typed)
    call = (
        f"source {script}; COMP_WORDS=({line}); COMP_CWORD={len(typed) - 1}; "
        '_shtab_steerd steerd "${COMP_WORDS[COMP_CWORD]}" "${COMP_WORDS[COMP_CWORD-1]}"; '
        'printf "%s\\n" "${COMPREPLY[@]}"'
    )
    done = subprocess.run([str(BASH), "-c", call], capture_output=True, text=True, check=True)
    assert done.stderr == ""
    return done.stdout.split()


@pytest.mark.skipif(BASH is None, reason="no bash on this machine")
def test_bash_completes_commands_options_and_files_where_one_is_wanted(script, tmp_path):
    assert set(COMMANDS) <= set(complete(script, "steerd", ""))
    assert complete(script, "steerd", "run", "--auto") == ["--auto-arm"]
    (tmp_path / "drive.mcap").touch()
    (tmp_path / "lab").mkdir()
    for typed in (("info",), ("run", "--car"), ("run", "--record"), ("plot", "-o")):
        assert complete(script, "steerd", *typed, f"{tmp_path}/dri") == [f"{tmp_path}/drive.mcap"]
    assert complete(script, "steerd", "run", "--lab", f"{tmp_path}/") == [f"{tmp_path}/lab"]


@pytest.mark.parametrize(("shell", "part"), [
    ("zsh", "#compdef steerd"), ("tcsh", "complete steerd"), ("fish", "complete -c steerd"),
])  # fmt: skip
def test_other_shells_get_their_own_script(shell, part, cli):
    text = cli("completion", shell).out
    assert part in text
    assert "rtcheck" in text
