"""What people get wrong: one clear line, what to try, an exit code, and nothing left behind."""

import os
import shlex
import shutil
import socket
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest

from steerd.car_model.car_file import default_car_path
from steerd.car_model.params import DEFAULT_CAR
from tests.csv_logs import import_log, make_noisy_rows
from tests.safety.live import free_endpoint

SIM = "run --sim --fast --duration 1"
LIVE = "run --mocap natnet://127.0.0.1/car --port /dev/ttyACM0"
PORT = "--port /dev/vesc --mocap natnet://10.0.0.2/car"
ON_PORT = "run --record {tmp}/drive.mcap --mocap natnet://127.0.0.1/car --port"
MOCAP = "run --record {tmp}/drive.mcap --port {tty} --mocap"

TABLE = [
    # what was perhaps meant
    ("idenify a.mcap", 2, "did you mean identify?"),
    ("frobnicate", 2, "`steerd --help` lists the commands"),
    ("info a.mcap b.mcap c.mcap --xyzzy", 2, "`steerd info --help` shows its options"),
    ("run --sim --sped 2", 2, "did you mean --speed?"),
    ("run --speed 1,5", 2, "--speed: not a number: '1,5'", "try: 1.5"),
    (f"{SIM} --path figur8", 2, "did you mean --path figure8?"),
    (f"{SIM} --path circle:raduis=2", 2, "did you mean --path circle:radius=2?"),
    # drives
    (f"{SIM} --path triangle", 2, "no path called 'triangle'", "circle"),
    (f"{SIM} --path circle:size=2", 2, "circle has no option size"),
    (f"{SIM} --path csv:{{tmp}}/notes.csv", 2, "notes.csv"),
    (f"{SIM} --path circle:radius=0.3", 4, "0.3"),
    (f"{SIM} --car {{tmp}}/broken.toml", 4, "broken.toml"),
    (f"{SIM} --car {{tmp}}/odd.toml", 4, "odd.toml", "mass"),
    (f"{SIM} --car {{tmp}}/pole.toml", 4, "spectral radius", "'pole_placement' refused"),
    (f"{SIM} --effect gravity=3", 2, "gravity", "steerd effects"),
    (f"{SIM} --effect steer_lag=much", 2, "steer_lag", "much"),
    (f"{SIM} --record {{tmp}}/notes.csv", 3, "notes.csv"),
    (f"{SIM} --record {{tmp}}/notes.csv/drive.mcap", 3, "notes.csv", "--record"),
    (f"{SIM} --seed -1", 2, "--seed -1: 0 or more"),
    (f"{SIM} --speed nan", 2, "--speed nan: more than 0 m/s"),
    (f"{SIM} --speed 30", 4, "--speed: speed = 30.0: above 20.0 m/s"),
    (f"{SIM} --rate 5", 2, "--rate 5", "20 to 1000 Hz"),
    (f"{SIM} --rate 1001", 2, "--rate 1001", "20 to 1000 Hz"),
    (f"{SIM} --name 'Car One'", 2, "Car One"),
    ("run --sim --fast", 2, "--duration"),
    ("run --fast", 2, "--sim"),
    ("run --sim --fast --view", 2, "steerd plot"),
    ("run", 2, "--port", "--sim"),
    ("run --sim --port /dev/ttyACM0", 2, "--sim has its own"),
    (f"{LIVE} --auto-arm", 2, "--sim only"),
    ("run --sim --ros-domain 233", 2, "0 to 232"),
    *(
        (f"run --port /dev/vesc --mocap zenoh:pose {of_ros} --lab {{tmp}}", 2, "not those of ROS")
        for of_ros in ("--ros-domain=0", "--mocap=ros2:///pf", "--controller=ros2")
    ),
    *(
        (f"{command} --lab {{tmp}}", 4, "steerd keys")
        for command in ("run --sim", "watch", "status", "arm")
    ),
    ("collect --sim --fast --box 0.5", 2, "needs a box of"),
    # what could not run is not installed
    ("service install --port /dev/vesc", 2, "a car needs --port and --mocap"),
    ("service install --sim --auto-arm", 2, "a service starts disarmed"),
    (f"service install {PORT} --path loop", 2, "no path called 'loop'"),
    (f"service install {PORT} --rate 5", 2, "50 to 1000 Hz"),
    (f"service launch {PORT} --record '$(env HOME).mcap'", 2, "be written in a launch file"),
    # before the first drive
    ("sim --fault volcano", 2, "volcano"),
    ("probe --port /dev/null --mocap optitrack:car", 2, "optitrack:car"),
    ("probe --port /dev/null --seconds 0", 2, "0.5 to 600"),
    ("rtcheck --seconds 0", 2, "out of range"),
    ("mocap check", 2, "name a session or a source"),
    ("mocap calibrate {tmp}/none.mcap", 3, "none.mcap does not exist"),
    ("mocap calibrate {run}", 4, "the car's poses only"),
    ("calibrate servo", 2, "name a session or a port"),
    ("config --check {tmp}", 3, "cannot be read"),
    ("config --from-vesc-yaml {tmp}/no.yaml", 3, "no.yaml does not exist"),
    ("export {tmp}/pole.toml -o {tmp}/car.urdf", 2, "no format of that name"),
    ("keys {tmp}/lab --host ' '", 2, "--host is empty"),
    ("keys {tmp}/lab --host 10.0.0.2 --car 'Car 1'", 2, "Car 1"),
    ("keys {tmp}/lab --host 10.0.0.2 --car ../car", 2, "../car"),
    ("keys {tmp}/lab --host 10.0.0.2 --car ''", 2, "car"),
    ("keys {tmp}/lab --operator new", 3, "lab.toml: No such file or directory"),
    # sessions and logs
    ("info {tmp}/a,b.mcap", 3, "a,b.mcap does not exist"),
    ("replay {tmp}/notes.csv", 3, "notes.csv is not an MCAP file"),
    ("replay {run}", 4, "lacks options"),
    *(
        (f"{command} {{tmp}}", 3, "is a directory\n   try: name a session .mcap file")
        for command in ("info", "replay", "identify", "diagnose")
    ),
    ("plot {run} {run} -o {tmp}/b.svg", 2, "compared on a page"),
    ("import {tmp}/drive.bag", 3, "does not exist"),
    ("import {tmp}/run.db3.zstd", 3, "a ROS 2 bag folder"),
    ("import csv", 2, "takes one log"),
    ("import {tmp}/run.csv", 2, "needs a map"),
    ("import {tmp}/run.csv --erpm-gain 0 --map {tmp}/map.toml -o {tmp}/a.mcap", 2, "4614"),
    ("identify {tmp}/none.mcap --car none.toml", 3, "none.toml does not exist"),  # a car file first
    *(
        (f"{command} {option} {{run}}", 2, "a session is never overwritten")
        for command, options in {
            "identify {run}": "-o --json --report",
            "diagnose {run}": "-o --report --prediction",
            "plot {run}": "-o",
            "mocap calibrate {run}": "-o",
            "calibrate servo {run}": "-o",
            "batch summarise {tmp}": "-o --page",
        }.items()
        for option in options.split()
    ),
    ("identify {run} -o {tmp}/drive.backup", 2, "a session is never overwritten"),
    # many drives
    ("batch summarise {tmp}/empty", 3, "no session"),
    ("batch identify {tmp} --cars {tmp}/none", 3, "does not exist"),
    ("sweep", 2, "a sweep file is needed"),
    ("sweep {tmp}/sweep.toml --again 3", 2, "--again and --record go together"),
    ("sweep {tmp}/sweep.toml --again 9 --record {tmp}/x.mcap", 2, "they are 0 to 3"),
    ("sweep {tmp}/sweep.toml -o {tmp}/none/x.parquet", 3, "there is no folder"),
]
SLOW = [
    ("identify {run} --free lenght", 2, "lenght is no parameter"),
    ("identify {run} --free mass.scale", 2, "mass.scale is no parameter"),
    ("identify {run} --fix mass=heavy", 2, "--fix mass=heavy: not a number"),
    ("identify {run} --fix lenght=3", 2, "lenght is no parameter"),
    ("identify {run} --fix mass=nan", 2, "expected a number >= 0.02"),
    ("identify {run} --fix lf=0.1,lr=0.15 --wheelbase 0.33", 2, "a wheelbase of 0.33 m"),
    ("identify {run} --fix lf=0.4 --wheelbase 0.33", 2, "a wheelbase of 0.33 m"),
    ("identify {run} --wheelbase 324", 2, "in metres"),
    ("identify {run} --held-out 0", 2, "something must validate"),
    ("identify {run} --held-out 1", 2, "2 or more"),
    ("identify {run} --held-out 4 --held-out last.mcap", 2, "not both"),
    ("identify {run} --held-out {run}", 2, "every session is held out"),
    ("identify {run} --held-out {tmp}/drive.backup", 2, "every session is held out"),
    ("identify {run} {run}", 2, "name each drive once"),
    ("identify {run} {tmp}/drive.backup", 2, "name each drive once"),
    ("identify {run} --starts 0", 2, "starts 0: 1 or more"),
    ("identify {run} --jobs 0", 2, "jobs 0: 1 or more"),
    ("identify {run} --iterations 0", 2, "iterations 0: 1 or more"),
    ("identify {run} --seed -1", 2, "seed -1: 0 or more"),
    ("diagnose {run} --only wings", 2, "wings"),
    ("diagnose {run} --without steer_dely", 2, "steer_dely"),
    ("diagnose {run} --only steer_lag --without servo_lag", 2, "leave no effect"),
    ("diagnose {run} --held-out 1", 2, "held out 1"),
    ("diagnose {run} --held-out 4,last.mcap", 2, "not both"),
    ("diagnose {run} --held-out {run}", 2, "every session is held out"),
    ("diagnose {run} --healthy {run}", 2, "its gap would pass for noise"),
    ("diagnose {run} {run}", 2, "named twice"),
    ("diagnose {run} --json drive.mcap", 2, "that is a session"),
    ("diagnose {run} --report {tmp}/nowhere/gap.html", 3, "nowhere"),
    ("diagnose {run} --report {tmp}", 3, "that is a folder"),
    (f"{ON_PORT} {{tmp}}/ttyACM9", 3, "ttyACM9"),
    (f"{ON_PORT} {{tmp}}/notes.csv", 3, "notes.csv"),
    (f"{MOCAP} motive://127.0.0.1/car", 2, "motive://", "natnet://HOST"),
    (f"{MOCAP} ros2://pf", 2, "a topic is like ros2:///pf/pose/odom"),
    (f"{MOCAP} natnet://127.0.0.1", 2, "natnet://127.0.0.1"),
    (f"{MOCAP} vrpn://no.such.host.invalid/car", 3, "no.such.host.invalid"),
    *(
        (f"{command} --connect {{nobody}}", 6, "no steerd answers", "`steerd run` first")
        for command in ("status", "arm", "start", "stop", "disarm")
    ),
    ("control --connect {nobody}", 6, "no steerd answers", "`steerd run --controller zenoh` first"),
]
"""Of what learns, which loads what computes; of hardware, whose core is a process; of the bus."""


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    """A drive as a table with its map, and the session of it."""
    folder = tmp_path_factory.mktemp("log")
    import_log(folder, make_noisy_rows(DEFAULT_CAR, 26.0, 2.1))
    return folder


@pytest.fixture
def place(tmp_path: Path, log: Path) -> Path:
    """Bad files, a log, its session, another copy of that, and a sweep file."""
    text = default_car_path().read_text().replace('design = "lqr" ', 'design = "pole_placement" ')
    unstable = text.replace("[-150.0, 15.0], [-150.0, -15.0]", "[-8.0, 3.0], [-8.0, -3.0]")
    files = {
        "notes.csv": "neither a path nor a session\n", "broken.toml": "[car\nmass = 3\n",
        "odd.toml": "[car]\nmass = 'heavy'\n", "pole.toml": unstable,
        "sweep.toml": 'seeds = 2\nduration = 3.6\n[vary]\n"car.mass" = [3.0, 4.5]',
    }  # fmt: skip
    for name, data in files.items():
        (tmp_path / name).write_text(data)
    for name in ("run.csv", "map.toml", "run.mcap"):
        shutil.copy(log / name, tmp_path)
    shutil.copy(log / "run.mcap", tmp_path / "drive.backup")
    (tmp_path / "run.db3.zstd").write_bytes(b"(\xb5/\xfd")
    (tmp_path / "empty").mkdir()
    return tmp_path


@pytest.fixture
def tty() -> Iterator[str]:
    """A port that opens."""
    ours, theirs = os.openpty()
    yield os.ttyname(theirs)
    os.close(ours)
    os.close(theirs)


def is_clear(said: str, parts: Sequence[str]) -> None:
    lines = said.strip().splitlines()
    assert "Traceback" not in said
    assert lines[0].startswith("steerd: "), said
    assert len(lines) <= 3, said
    for word in parts:
        assert word in said


def content(place: Path) -> list[tuple[Path, int]]:
    return sorted((path, path.stat().st_mtime_ns) for path in place.rglob("*"))


@pytest.mark.parametrize(("line", "code", "parts"), [
    *((line, code, parts) for line, code, *parts in TABLE),
    *(pytest.param(line, code, parts, marks=pytest.mark.slow) for line, code, *parts in SLOW),
])  # fmt: skip
def test_a_mistake_is_reported_in_a_line(line, code, parts, place, log, tty, cli, monkeypatch):
    monkeypatch.setenv("MPLCONFIGDIR", str(log))
    for name in ("STATE_DIRECTORY", "XDG_CONFIG_HOME"):
        monkeypatch.setenv(name, str(place))
    before = content(place)
    places = {"tmp": place, "run": place / "run.mcap", "tty": tty, "nobody": free_endpoint()}
    said = cli(*[word.format(**places) for word in shlex.split(line)], code=code)
    is_clear(said.err, parts)
    assert said.out == ""
    assert content(place) == before


# --- those that only the running processes can meet
@pytest.mark.slow
def test_a_busy_endpoint_is_told_in_a_line(place, steerd):
    before = content(place)
    with socket.create_server(("127.0.0.1", 0)) as server:
        endpoint = f"tcp/127.0.0.1:{server.getsockname()[1]}"
        argv = ("--sim", "--auto-arm", "--listen", endpoint, "--record", place / "drive.mcap")
        run = steerd("run", *argv)
        assert run.wait() == 6, run.text
    is_clear(run.text, [endpoint, "already in use", "another steerd"])
    assert content(place) == before


@pytest.mark.slow
def test_a_second_run_on_the_same_port_is_refused(steerd, tmp_path):
    port, url = steerd.sim(tmp_path)
    argv = ("run", "--port", port, "--mocap", url)
    first = steerd(*argv, "--listen", steerd.endpoint, "--record", tmp_path / "first.mcap")
    first.expect("DISARMED")
    second = steerd(*argv, "--listen", free_endpoint(), "--record", tmp_path / "drive.mcap")
    assert second.wait() == 3, second.text
    is_clear(second.text, [port, "another steerd holds it"])
    assert not (tmp_path / "drive.mcap").exists()
    assert first.process.poll() is None
    first.expect("READY")
