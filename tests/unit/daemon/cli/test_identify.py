"""`steerd identify` on imported logs: good ones, and every kind that no fit should see."""

import contextlib
import io
import json
import signal
import tomllib
from types import SimpleNamespace

import numpy as np
import pytest

from steerd.car_model.car_file import default_car_path, load_car
from steerd.car_model.params import DEFAULT_CAR
from steerd.daemon.analysis import identification
from steerd.daemon.cli.main import run_cli as main
from steerd.daemon.common.errors import SteerdError
from steerd.steer_bus.session import SessionWriter
from tests.csv_logs import import_log, make_noisy_rows

pytestmark = pytest.mark.slow

TRUE = DEFAULT_CAR._replace(steer_gain=0.93, speed_lag=0.14, c_sf=4.3)

rows = pytest.fixture(lambda: make_noisy_rows(TRUE, 26.0, 0.9), scope="module")


@pytest.fixture(scope="module")
def session(rows, tmp_path_factory):
    """The session of all rows."""
    return import_log(tmp_path_factory.mktemp("whole"), rows)


def _outputs(folder):
    named = {"-o": "car.toml", "--json": "o.json", "--report": "r.html"}
    return [word for flag, name in named.items() for word in (flag, str(folder / name))]


FREE = ["--free", "c_sf,c_sr,steer_gain,steer_lag,speed_lag"]


@pytest.fixture(scope="module")
def fitted(session, tmp_path_factory):
    """A folder with all that the command writes of a session, its screen, and what was fitted."""
    folder, screen, found = tmp_path_factory.mktemp("fitted"), io.StringIO(), []
    learn = identification.learn
    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(screen):
        patch.setattr(identification, "learn", lambda *of: found.append(learn(*of)) or found[0])
        given = ["--fix", "mass=3.2"]
        assert main(["identify", str(session), *FREE, *given, *_outputs(folder)]) == 0
    return folder, screen.getvalue(), found[0]


def test_a_drive_becomes_a_car_file_json_and_report(fitted):
    folder, screen, _ = fitted
    assert "next        steerd run --sim --fast --duration 20 --car" in screen
    car = load_car(folder / "car.toml")
    assert not {"noise", "knowledge"} & tomllib.loads(car.text).keys()
    assert {"noise", "knowledge"} <= car.sections.keys()
    assert car.car.steer_gain == pytest.approx(TRUE.steer_gain, rel=0.02)
    assert car.car.c_sf == pytest.approx(TRUE.c_sf, rel=0.1)
    assert car.sd["steer_gain"] > 0.0
    assert "run.mcap" in car.source["steer_gain"]
    assert (car.car.mass, car.car.cog_height) == (3.2, DEFAULT_CAR.cog_height)
    result = json.loads((folder / "o.json").read_text())
    last = result["held_out"]["horizons"][-1]
    assert last["position"] < 0.5 * last["position_before"]
    assert "<svg" in (folder / "r.html").read_text()


@pytest.mark.filterwarnings("ignore")
def test_processes_give_the_same_answer(rows, tmp_path):
    session, out = import_log(tmp_path, rows[:1800]), tmp_path / "o.json"
    search = "--method paper --starts 2 --iterations 2 --held-out 3"

    def answer(more=""):
        code = main(f"identify {session} {search} --json {out} {more}".split())
        return code, json.loads(out.read_text())

    assert answer("--jobs 2") == answer()


@pytest.mark.parametrize("fixed", ["lf=0.15", "lf=0.15,lr=0.18"])
def test_the_car_that_is_written_has_the_axles_that_were_fitted(fixed, session, tmp_path, capsys):
    args = ["--fix", fixed, "--wheelbase", "0.33", "--free", "lf,lr,steer_gain,steer_lag"]
    assert main(["identify", str(session), *args, "-o", str(tmp_path / "car.toml")]) == 0
    car = load_car(tmp_path / "car.toml").car
    assert (car.lf, car.lr) == (0.15, pytest.approx(0.18))
    assert car.inertia_z == pytest.approx(DEFAULT_CAR.inertia_z * (0.33 / 0.3302) ** 2)


def interrupted(*_):
    signal.raise_signal(signal.SIGINT)


def test_a_wrong_sign_is_a_warning_before_a_fit_which_interrupted_writes_nothing(
    rows, tmp_path, monkeypatch, cli
):
    session = import_log(tmp_path, rows * [1.0, 1.0, 1.0, 1.0, -1.0, 1.0])
    monkeypatch.setattr(identification, "learn", interrupted)
    error = cli("identify", session, "-o", tmp_path / "car.toml", code=130).err
    assert "warning: run.mcap:" in error
    assert "left positive" in error
    assert error.endswith("\ninterrupted: nothing is written\n")


def put(columns, value):
    """Rows with this in some of their columns."""

    def spoil(rows):
        spoilt = rows.copy()
        spoilt[:, columns] = value(rows) if callable(value) else value
        return spoilt

    return spoil


BROKEN = {
    "millimetres": (put([1, 2], lambda rows: 1e3 * rows[:, 1:3]), "millimetres"),
    "clock": (put(0, lambda r: r[:, 0] + 3.0 * (np.arange(len(r)) >= 1200)), "clock"),
    "degrees": (put(4, lambda rows: np.degrees(rows[:, 4])), "is it in degrees?"),
    "standing": (put([1, 2, 3], lambda rows: rows[0, 1:4]), "never moved"),
    "constant": (put(4, 0.1), "steering is one constant"),
    "crawling": (put(5, 0.1), "m/s"),
    "short": (lambda rows: rows[:60], "of driving"),
}
NOT_OF = {"identify": {"crawling"}, "diagnose": {"degrees", "constant"}}
"""What the other command alone refuses."""
BAD = [(command, kind) for command in NOT_OF for kind in BROKEN if kind not in NOT_OF[command]]


@pytest.mark.parametrize(("command", "kind"), BAD)
def test_bad_content_is_one_line_and_leaves_nothing(command, kind, rows, tmp_path, cli):
    spoil, words = BROKEN[kind]
    session = import_log(tmp_path, spoil(rows))
    before = set(tmp_path.iterdir())
    error = cli(command, session, *_outputs(tmp_path), code=4).err
    assert words in error
    assert error.count("\n") <= 2
    assert set(tmp_path.iterdir()) == before


def test_of_a_folder_the_held_out_session_is_not_fitted(rows, tmp_path, cli):
    halves = {"one": rows[:1500], "two": rows[1500:]}
    one, two = (import_log(tmp_path, half, name) for name, half in halves.items())
    base = ["--base", default_car_path()]  # another spelling of --car
    screen = cli("identify", one, two, "--held-out", two, *FREE, *base).out
    assert "prediction  of two.mcap" in screen
    assert "two.mcap" not in screen.partition("prediction ")[0]


def test_an_interrupt_leaves_what_is_on_the_screen(session, fitted, tmp_path, monkeypatch, capsys):
    out = tmp_path / "out"
    out.mkdir()

    def look(found, car):
        said = capsys.readouterr().out
        assert "steer_gain " in said
        assert str(out / "car.toml") in said
        interrupted()

    capsys.readouterr()
    monkeypatch.setattr(identification, "learn", lambda *_: fitted[2])
    monkeypatch.setattr(identification.Identification, "learn_known", look)
    assert main(["identify", str(session), *FREE, *_outputs(out)]) == 130
    assert {path.name for path in out.iterdir()} == {"car.toml", "o.json", "r.html"}
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("interrupted: ")
    assert line.endswith(f"are written, {out / 'car.posterior.json'} is not")
    assert "car.posterior.json is missing" in load_car(out / "car.toml").remark


def test_a_value_where_no_car_is_spoils_the_car_file_alone(monkeypatch, tmp_path, cli):
    def refuse(path):
        raise SteerdError(f"{path}: car.lf: expected a number >= 0.02", "lf = 0.15")

    found = SimpleNamespace(
        to_json=dict, make_car=refuse, render_report=lambda: "<html>", improved=False,
        describe=lambda *written: "TABLE", learn_known=lambda car: car,
    )  # fmt: skip
    session = tmp_path / "a.mcap"
    SessionWriter(session, {}, {}).finish({})
    monkeypatch.setattr(identification, "run_identify", lambda *_: found)
    car, page = tmp_path / "car.toml", tmp_path / "page.html"
    said = cli("identify", session, "-o", car, "--report", page, code=5)
    assert said.out == "TABLE\n"
    assert f"{car} is not written: car.lf: expected a number >= 0.02" in said.err
    assert page.read_text() == "<html>"
    assert not car.exists()
