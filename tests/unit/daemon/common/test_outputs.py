"""Where commands may write: never over a session, nothing before the work that cannot be kept."""

import pytest

from steerd.daemon.cli.main import run_cli
from steerd.daemon.common.errors import SteerdError
from steerd.daemon.common.written import check_outputs
from steerd.steer_bus.mcap_records import MAGIC


@pytest.fixture
def session(tmp_path):
    path = tmp_path / "drive.mcap"
    path.write_bytes(MAGIC + bytes(100))
    return path


COMMANDS = [
    ("identify", "{drive}", "-o", "{kept}"),
    ("identify", "{drive}", "--json", "{kept}"),
    ("identify", "{drive}", "--report", "{kept}"),
    ("diagnose", "{drive}", "-o", "{kept}"),
    ("diagnose", "{drive}", "--report", "{kept}"),
    ("diagnose", "{drive}", "--prediction", "{kept}"),
    ("mocap", "calibrate", "{drive}", "-o", "{kept}"),
    ("calibrate", "servo", "{drive}", "-o", "{kept}"),
]


@pytest.mark.parametrize("argv", COMMANDS, ids=" ".join)
@pytest.mark.parametrize("name", ["drive.mcap", "drive.backup"])
def test_a_session_is_never_written_over(argv, name, session, tmp_path, capsys):
    kept = tmp_path / name
    kept.write_bytes(session.read_bytes())
    arguments = [word.format(drive=session, kept=kept) for word in argv]
    assert run_cli(arguments) == 2
    assert "a session is never overwritten" in capsys.readouterr().err
    assert kept.read_bytes() == MAGIC + bytes(100)


@pytest.mark.parametrize(
    ("name", "code", "text"),
    [("", 3, "that is a folder"), ("none/car.toml", 3, "there is no folder")],
)
def test_what_cannot_be_written_is_reported_before_the_work(
    name, code, text, session, tmp_path, capsys
):
    argv = ["identify", str(session), "-o", str(tmp_path / name)]
    assert run_cli(argv) == code, "only the work itself would find the session cut short"
    assert text in capsys.readouterr().err


def test_a_folder_without_permission(tmp_path, monkeypatch):
    monkeypatch.setattr("os.access", lambda path, mode: False)
    with pytest.raises(SteerdError, match="cannot be written"):
        check_outputs({"-o": tmp_path / "car.toml"})


def test_two_outputs_are_two_files(tmp_path):
    (tmp_path / "inner").mkdir()
    again = tmp_path / "inner" / ".." / "x"
    with pytest.raises(SteerdError, match="-o and --json name the same file"):
        check_outputs({"-o": tmp_path / "x", "--json": again, "--report": None})


def test_files_of_other_kinds_may_be_written_anew(tmp_path):
    (tmp_path / "car.toml").write_text("[car]\n")
    check_outputs({"-o": tmp_path / "car.toml", "--json": tmp_path / "new.json", "--report": None})
