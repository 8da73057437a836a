"""A car file that a command wrote and `steerd run` would refuse is said to be so at once."""

import pytest

from steerd.car_model.car_file import default_car_path, load_car
from steerd.daemon.assembly.car_check import report_refusal
from steerd.daemon.cli.main import run_cli
from steerd.daemon.common.errors import ExitCode

DEFAULT = default_car_path().read_text()
LAGS = "\n[effects.rolling_drag]\ndrag = 3.0\n"


@pytest.mark.parametrize(
    ("more", "said"), [("", ""), (LAGS, "behind its orders"), ("\n[limitss]\n", "limits")]
)
def test_what_run_refuses_is_said_by_whoever_wrote_it(tmp_path, capsys, more, said):
    path = tmp_path / "car.toml"
    path.write_text(DEFAULT + more)
    report_refusal(load_car(path))
    noted = capsys.readouterr().err
    assert noted.startswith("note: `steerd run` refuses this file: ") is bool(said)
    assert said in noted
    refused = run_cli(["config", "--check", str(path)]) == ExitCode.INVALID
    assert refused is bool(said), "the note and the check agree"
