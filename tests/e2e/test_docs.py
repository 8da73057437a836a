"""Every command line of README and docs is run, or at least read by the parser that it is for.

`kind_of` sorts them: run as they stand, run against simulated hardware, parsed, or mere names. Of
drives that differ only in values, or by options left out, the longest is driven and the others
are planned: parsed, their addresses read, path and controller made.
"""

import re
import shlex
import signal
import subprocess
import sys
from contextlib import closing
from itertools import pairwise
from pathlib import Path

import pytest

from steerd.daemon.assembly.build import make_plan
from steerd.daemon.cli.commands.run import make_options
from steerd.daemon.cli.main import COMMANDS, run_cli
from steerd.daemon.common.errors import ExitCode
from steerd.daemon.settings.car_edit import make_vesc_yaml
from steerd.mocap_link.mocap_url import parse_mocap_url
from steerd.vesc_link.scaling import F1TENTH
from tests.contract.command_page import make_parser
from tests.e2e.conftest import STEERD, Launcher
from tests.safety.live import free_port

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
PLACEHOLDER = re.compile(r"…|\b(COMMAND|SESSION|NAME|DEV|DIR|URL|MAP\.toml|FILE\.toml)\b")
HARDWARE = re.compile(r"/dev/tty|/dev/vesc|natnet://|vrpn://|zenoh:")
OWN_EFFECT = re.compile(r"effects --(add|remove)|speed_pull")
"""Run by test_wheel.py, on an installation of its own."""
OPERATOR = re.compile("arm|start|stop|disarm|clear|estop|status|control|watch|page|teleop")
LONG = ("identify", "diagnose", "collect", "sweep", "batch")
"""Held by tests of their own, minutes long; here they are read by their parsers."""


def blocks(text):
    fenced = False
    for line in text.splitlines():
        if line.startswith("```"):
            fenced = not fenced
        elif fenced or line.startswith("    "):
            yield line.strip()


def command_lines():
    found = {}
    for page in PAGES:
        text = page.read_text()
        lines = [line for line in blocks(text) if line.startswith("steerd ")]
        inline = re.findall(r"`(steerd [a-z]+ [^`]*)`", text)
        lines += [line for line in inline if not re.fullmatch(r"[a-z ]+", line)]
        for line in lines:
            command = line.partition("  #")[0].strip()
            found.setdefault(command, page.name)
    return [pytest.param(command, id=f"{page}: {command}") for command, page in found.items()]


def arguments_of(command):
    """A command's arguments without pipes and redirections; placeholders stay."""
    return shlex.split(re.split(r"\s[|>]", command)[0])[1:]


def parse(arguments):
    return make_parser(arguments[0]).parse_args(arguments[1:])


driven = pytest.fixture(lambda: {}, scope="module")
"""The one recorded drive, once it was needed."""


@pytest.fixture
def workplace(tmp_path, monkeypatch, drive_fast, driven):
    """A folder with what the pages speak of: sessions, a car file, a vesc.yaml, examples."""
    monkeypatch.chdir(tmp_path)

    def prepare(arguments):
        for before, word in zip(["", *arguments], arguments, strict=False):
            if word.endswith(".mcap") and before not in ("-o", "--record"):
                if not driven:
                    session = drive_fast("--path figure8 --speed 1 --duration 16").session
                    driven["session"] = session.read_bytes()
                Path(word).write_bytes(driven["session"])
        cars = [word for before, word in pairwise(arguments) if before == "--car"]
        for name in ("car.toml", *cars):
            Path(name).write_bytes((ROOT / "config" / "f1tenth.toml").read_bytes())
        Path("vesc.yaml").write_text(make_vesc_yaml(F1TENTH))
        Path("examples").symlink_to(ROOT / "examples")

    return prepare


def shortened(arguments):
    """Drives of at most 3 s, and a second of `rtcheck`: the pages' lengths are for people."""
    return [
        "3" if before == "--duration" and float(word) > 3 else word
        for before, word in zip(["", *arguments], arguments, strict=False)
    ] + ["--seconds", "1"] * (arguments[0] == "rtcheck")


def kind_of(command):
    """How a command line is looked at."""
    arguments = arguments_of(command)
    if PLACEHOLDER.search(command):  # a name of a command rather than a line to type
        return "prose"
    if OPERATOR.fullmatch(arguments[0]) or arguments[0] in LONG:
        return "parsed"
    if arguments[0] == "import" or ".partial" in command or OWN_EFFECT.search(command):
        return "parsed"
    live = arguments[0] in ("sim", "probe") or (arguments[0] == "run" and "--fast" not in arguments)
    return "hardware" if live or HARDWARE.search(command) else "run"


def options_of(command):
    """The command and its options, without their values; mocap addresses by their protocol."""
    arguments = arguments_of(command)
    schemes = re.findall(r"\b(natnet|vrpn|zenoh|ros2):", command)
    return frozenset([arguments[0], *schemes, *(w for w in arguments if w.startswith("--"))])


def chosen(commands):
    """The lines to drive: none whose options all occur in another one that is driven."""
    found = []
    for command in sorted(commands, key=lambda c: -len(options_of(c))):
        if not any(options_of(command) <= options_of(other) for other in found):
            found.append(command)
    return found


def lines_of(kind):
    return [p.values[0] for p in command_lines() if kind_of(p.values[0]) == kind]


HARDWARE_LINES, RUN_LINES = lines_of("hardware"), lines_of("run")
ELSEWHERE = [c for c in HARDWARE_LINES if re.search("vrpn:|zenoh|ros2", c)]
"""Driven by test_live.py and test_ros.py, with programs beside them that the pages do not show."""
DRIVEN = chosen([c for c in HARDWARE_LINES if c not in ELSEWHERE])
FAST = [c for c in RUN_LINES if c.startswith("steerd run ")]
RUN = [*chosen(FAST), *(c for c in RUN_LINES if c not in FAST)]  # `@last` is one of the first


def test_pages_hold_commands():
    assert len(command_lines()) > 30
    assert all((RUN, DRIVEN, lines_of("parsed")))


@pytest.mark.parametrize("command", command_lines())
def test_every_command_line_is_understood(command):
    arguments = arguments_of(command)
    assert arguments[0] in COMMANDS, command
    if kind_of(command) != "prose":
        parse(arguments)


# Of lines that differ in the names of sessions alone, one is run.
@pytest.mark.parametrize("command", {re.sub(r"\w+\.mcap", "", c): c for c in RUN}.values())
def test_what_needs_no_hardware_runs(command, workplace, capsys):
    arguments = shortened(arguments_of(command))
    workplace(arguments)
    if arguments[0] == "rtcheck":  # its process is in real time from then on
        command_line = [sys.executable, *STEERD, *arguments]
        done = subprocess.run(command_line, capture_output=True, text=True, check=False)
        code, out, err = done.returncode, done.stdout, done.stderr
    else:
        code, (out, err) = run_cli(arguments), capsys.readouterr()
    if arguments[:2] == ["rtcheck", "--under-load"] and code == ExitCode.STOPPED:
        # That this machine does not keep time beside a load is the answer; it must be given.
        assert "stalled by its host" in out or "too slow" in out
        assert re.search(r"later than 25 ms, which stops a car: \d+", out)
    else:
        assert code == ExitCode.OK, err
    is_read = ">" not in command  # a file for a shell may be as long as it likes
    assert not is_read or len(out.splitlines()) < 140


@pytest.mark.parametrize("command", [c for c in HARDWARE_LINES + FAST if c not in DRIVEN + RUN])
def test_what_is_driven_with_the_same_options_elsewhere_is_planned(command, workplace):
    arguments = arguments_of(command)
    workplace(arguments)
    args = parse(arguments)
    if getattr(args, "mocap", None) and "://" in args.mocap:
        parse_mocap_url(args.mocap)
    if arguments[0] == "run":
        assert make_plan(make_options(args)).controller is not None


@pytest.fixture(scope="module")
def hardware(tmp_path_factory):
    with closing(Launcher()) as launcher:
        yield launcher.sim(tmp_path_factory.mktemp("hardware"))


@pytest.mark.realtime
@pytest.mark.parametrize("command", DRIVEN)
def test_what_needs_hardware_runs_against_simulated_hardware(
    command, steerd, hardware, workplace, tmp_path, monkeypatch
):
    arguments = arguments_of(command)
    workplace(arguments)
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    if arguments[0] == "service":
        assert run_cli(arguments) == ExitCode.OK
        return
    if "--sim" not in arguments and arguments[0] != "sim":
        port, url = hardware
        arguments = [port if word.startswith("/dev/") else word for word in arguments]
        arguments = [url if re.match(r"(natnet|vrpn)://", word) else word for word in arguments]
    code, said = ExitCode.OK, ""
    match arguments[0]:
        case "sim":
            program = steerd(*arguments)
            program.expect("mocap: ")
            program.send(signal.SIGINT)
        case "run":
            view = ("--view", free_port()) if "--view" in arguments else ()
            program = steerd(*shortened(arguments), "--listen", steerd.endpoint, *view)
            program.expect("RUNNING" if "--auto-arm" in arguments else "DISARMED|READY")
            program.send(signal.SIGINT)
        case "setup":  # nobody answers
            program, code, said = steerd(*arguments), ExitCode.INTERRUPTED, "--from 1"
        case "calibrate":
            program, code, said = steerd(*arguments), ExitCode.USAGE, "keys need a terminal"
        case "mocap":  # nobody pushes
            program = steerd(*arguments, "--seconds", 1)
            code, said = ExitCode.STOPPED, "push the car"
        case _:
            program = steerd(*arguments)
    assert program.wait() == code, program.text
    assert said in program.text


def test_every_exit_code_is_explained():
    text = (ROOT / "docs" / "how-to" / "troubleshooting.md").read_text()
    explained = {int(code) for code in re.findall(r"^\| (\d+) \|", text, re.MULTILINE)}
    assert explained == {int(code) for code in ExitCode}
