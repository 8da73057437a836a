"""The completion script, asked as bash asks it."""

import shutil
import subprocess

import pytest

from steerd.daemon.cli.main import COMMANDS, guarded

BASH = shutil.which("bash")
pytestmark = pytest.mark.skipif(BASH is None, reason="no bash on this machine")


@pytest.fixture(scope="module")
def script(tmp_path_factory):
    import contextlib
    import io

    out = io.StringIO()
    with contextlib.redirect_stdout(out):
        assert guarded(["completion", "bash"]) == 0
    path = tmp_path_factory.mktemp("completion") / "steerd.bash"
    path.write_text(out.getvalue())
    return path


def complete(script, *words):
    line = " ".join(f'"{word}"' for word in words)
    ask = (
        f"source {script}; COMP_WORDS=({line}); COMP_CWORD={len(words) - 1}; _steerd; "
        'printf "%s\\n" "${COMPREPLY[@]}"'
    )
    done = subprocess.run([str(BASH), "-c", ask], capture_output=True, text=True, check=True)
    assert done.stderr == ""
    return done.stdout.split()


def test_commands(script):
    assert set(COMMANDS) <= set(complete(script, "steerd", ""))
    assert complete(script, "steerd", "prob") == ["probe"]


def test_options_of_every_command(script):
    for name in COMMANDS:
        assert "--help" in complete(script, "steerd", name, "--h")
    assert complete(script, "steerd", "run", "--auto") == ["--auto-arm"]
    assert "--closed" in complete(script, "steerd", "collect", "--clo")


def test_values_and_words(script, tmp_path):
    assert complete(script, "steerd", "run", "--controller", "") == ["lane", "zenoh"]
    assert complete(script, "steerd", "mocap", "cal") == ["calibrate"]
    (tmp_path / "drive.mcap").touch()
    assert complete(script, "steerd", "info", f"{tmp_path}/dri") == [f"{tmp_path}/drive.mcap"]


def test_zsh_gets_its_bridge(capsys):
    assert guarded(["completion", "zsh"]) == 0
    assert "bashcompinit" in capsys.readouterr().out
