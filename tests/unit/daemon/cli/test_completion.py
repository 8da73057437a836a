"""The completion scripts; bash's is run as bash runs it."""

import shutil
import subprocess

import pytest

from steerd.daemon.cli.main import COMMANDS, run_cli

BASH = shutil.which("bash")
needs_bash = pytest.mark.skipif(BASH is None, reason="no bash on this machine")


@pytest.fixture(scope="module")
def script(tmp_path_factory):
    import contextlib
    import io

    out = io.StringIO()
    with contextlib.redirect_stdout(out):
        assert run_cli(["completion", "bash"]) == 0
    path = tmp_path_factory.mktemp("completion") / "steerd.bash"
    path.write_text(out.getvalue())
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


@needs_bash
def test_commands(script):
    assert set(COMMANDS) <= set(complete(script, "steerd", ""))
    assert complete(script, "steerd", "prob") == ["probe"]


@needs_bash
def test_options_of_every_command(script):
    for name in COMMANDS:
        assert "--help" in complete(script, "steerd", name, "--h")
    assert complete(script, "steerd", "run", "--auto") == ["--auto-arm"]
    assert "--closed" in complete(script, "steerd", "collect", "--clo")


@needs_bash
def test_values_of_options_and_kinds_of_commands(script):
    assert complete(script, "steerd", "run", "--controller", "") == ["lane", "zenoh"]
    assert complete(script, "steerd", "mocap", "cal") == ["calibrate"]


@needs_bash
def test_files_where_a_file_is_wanted(script, tmp_path):
    (tmp_path / "drive.mcap").touch()
    (tmp_path / "lab").mkdir()
    for typed in (("info",), ("run", "--car"), ("run", "--record"), ("plot", "-o")):
        assert complete(script, "steerd", *typed, f"{tmp_path}/dri") == [f"{tmp_path}/drive.mcap"]
    assert complete(script, "steerd", "run", "--lab", f"{tmp_path}/") == [f"{tmp_path}/lab"]


@pytest.mark.parametrize(
    ("shell", "start", "part"),
    [
        ("zsh", "#compdef steerd", "--auto-arm"),
        ("tcsh", "# AUTOMATICALLY GENERATED", "complete steerd"),
        ("fish", "# AUTOMATICALLY GENERATED", "complete -c steerd"),
    ],
)
def test_other_shells_get_their_own_script(shell, start, part, capsys):
    assert run_cli(["completion", shell]) == 0
    text = capsys.readouterr().out
    assert text.startswith(start)
    assert part in text
    assert "rtcheck" in text
