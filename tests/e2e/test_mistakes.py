"""What people get wrong: one clear line, what to try, an exit code, and nothing left behind."""

import os
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from steerd.car_model.car_file import default_car_path
from steerd.daemon.cli.main import run_cli
from tests.safety.live import free_endpoint

SIM = ("run", "--sim", "--fast", "--duration", "1")
LIVE = ("run", "--listen", "", "--mocap", "natnet://127.0.0.1/car")

TABLE = [
    ((*SIM, "--path", "triangle"), 2, ["no path called 'triangle'", "circle"]),
    ((*SIM, "--path", "circle:size=2"), 2, ["circle has no option size"]),
    ((*SIM, "--path", "csv:{tmp}/notes.csv"), 2, ["notes.csv"]),
    ((*SIM, "--path", "circle:radius=0.3"), 4, ["0.3"]),
    ((*SIM, "--car", "{tmp}/broken.toml"), 4, ["broken.toml"]),
    ((*SIM, "--car", "{tmp}/odd.toml"), 4, ["odd.toml", "mass"]),
    ((*SIM, "--car", "{tmp}/pole.toml"), 4, ["spectral radius", "'pole_placement' refused"]),
    ((*SIM, "--effect", "gravity=3"), 2, ["gravity", "steerd effects"]),
    ((*SIM, "--effect", "steer_lag=much"), 2, ["steer_lag", "much"]),
    ((*SIM, "--record", "{tmp}/notes.csv"), 3, ["notes.csv"]),
    ((*SIM, "--record", "{tmp}/notes.csv/drive.mcap"), 3, ["notes.csv", "--record"]),
    ((*SIM, "--seed", "-1"), 2, ["--seed -1: 0 or more"]),
    ((*SIM, "--speed", "-1"), 2, ["--speed -1: more than 0 m/s"]),
    ((*SIM, "--speed", "nan"), 2, ["--speed nan: more than 0 m/s"]),
    ((*SIM, "--rate", "5"), 2, ["--rate 5", "20 to 1000 Hz"]),
    ((*SIM, "--name", "Car One"), 2, ["Car One"]),
    (("run", "--sim", "--fast"), 2, ["--duration"]),
    (("run", "--fast"), 2, ["--sim"]),
    (("run",), 2, ["--port", "--sim"]),
    (("run", "--sim", "--port", "/dev/ttyACM0"), 2, ["--sim has its own"]),
    ((*LIVE, "--port", "/dev/ttyACM0", "--auto-arm"), 2, ["--sim only"]),
    (("run", "--sim", "--ros-domain", "233"), 2, ["0 to 232"]),
    *(
        (("run", "--port", "/dev/ttyACM0", "--mocap", "zenoh:pose", of_ros, "--lab", "{tmp}"), 2,
         ["not those of ROS"])
        for of_ros in ("--ros-domain=0", "--mocap=ros2:///pf", "--controller=ros2")
    ),
    (("replay", "{tmp}/notes.csv"), 3, ["notes.csv is not an MCAP file"]),
    (("info", "{tmp}"), 3, ["is a directory"]),
    (("sim", "--fault", "volcano"), 2, ["volcano"]),
]  # fmt: skip


@pytest.fixture
def place(tmp_path: Path) -> Path:
    (tmp_path / "notes.csv").write_text("neither a path nor a session\n")
    (tmp_path / "broken.toml").write_text("[car\nmass = 3\n")
    (tmp_path / "odd.toml").write_text("[car]\nmass = 'heavy'\n")
    text = default_car_path().read_text().replace('design = "lqr" ', 'design = "pole_placement" ')
    unstable = text.replace("[-150.0, 15.0], [-150.0, -15.0]", "[-8.0, 3.0], [-8.0, -3.0]")
    (tmp_path / "pole.toml").write_text(unstable)
    return tmp_path


def is_clear(said: str, parts: list[str]) -> None:
    lines = said.strip().splitlines()
    assert "Traceback" not in said
    assert lines[0].startswith("steerd: "), said
    assert len(lines) <= 3, said
    for word in parts:
        assert word in said


@pytest.mark.parametrize(
    ("argv", "code", "parts"),
    TABLE,
    ids=lambda v: " ".join(map(str, v))[:60] if isinstance(v, tuple) else "",
)
def test_a_mistake_is_reported_in_a_line(argv, code, parts, place, capsys, monkeypatch):
    monkeypatch.setenv("STATE_DIRECTORY", str(place))
    before = sorted(place.rglob("*"))
    assert run_cli([text.format(tmp=place) for text in argv]) == code
    is_clear(capsys.readouterr().err, parts)
    assert sorted(place.rglob("*")) == before


# --- those that only the running processes can meet


def run_live(place, *argv, **options):
    """`steerd run` at hardware that is not there: its exit code and text."""
    record = str(place / "drive.mcap")
    full = [sys.executable, "-m", "steerd.daemon.cli.main", "run", "--record", record, *argv]
    done = subprocess.run(full, capture_output=True, text=True, timeout=60, check=False, **options)
    return done.returncode, done.stderr


@pytest.mark.slow
@pytest.mark.parametrize(
    ("port", "mocap", "code", "parts"),
    [
        ("{tmp}/ttyACM9", "natnet://127.0.0.1/car", 3, ["ttyACM9"]),
        ("{tmp}/notes.csv", "natnet://127.0.0.1/car", 3, ["notes.csv"]),
        ("{tty}", "motive://127.0.0.1/car", 2, ["motive://", "natnet://HOST"]),
        ("{tty}", "ros2://pf", 2, ["a topic is like ros2:///pf/pose/odom"]),
        ("{tty}", "natnet://127.0.0.1", 2, ["natnet://127.0.0.1"]),
        ("{tty}", "vrpn://no.such.host.invalid/car", 3, ["no.such.host.invalid"]),
    ],
)
def test_wrong_hardware_is_reported_in_a_line(port, mocap, code, parts, place):
    ours, theirs = os.openpty()
    before = sorted(place.iterdir())
    argv = ("--port", port.format(tmp=place, tty=os.ttyname(theirs)), "--mocap", mocap)
    got, said = run_live(place, *argv, "--listen", free_endpoint())
    os.close(ours)
    os.close(theirs)
    assert got == code, said
    is_clear(said, parts)
    assert sorted(place.iterdir()) == before


@pytest.mark.slow
def test_a_busy_endpoint_is_told_in_a_line(place):
    before = sorted(place.iterdir())
    with socket.create_server(("127.0.0.1", 0)) as server:
        endpoint = f"tcp/127.0.0.1:{server.getsockname()[1]}"
        argv = ("--sim", "--auto-arm", "--duration", "1", "--listen", endpoint)
        code, said = run_live(place, *argv)
    assert code == 6, said
    is_clear(said, [endpoint, "already in use", "another steerd"])
    assert sorted(place.iterdir()) == before


@pytest.mark.slow
def test_nobody_answers(capsys):
    for command in ("status", "arm", "start", "stop", "disarm", "control"):
        assert run_cli([command, "--connect", free_endpoint()]) == 6
        said = capsys.readouterr().err
        is_clear(said, ["no steerd answers", "steerd run"])
        assert ("run --controller zenoh" in said) == (command == "control"), "what it needs"


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
