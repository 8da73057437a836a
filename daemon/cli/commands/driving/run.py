"""Drive a car (--port, --mocap) or simulated hardware (--sim).

On a car it starts disarmed. Arm and start it with the keys shown, or from
another terminal with `steerd arm` and `steerd start`.
"""

import argparse
import secrets
import signal
import sys
import threading
from collections.abc import Callable
from importlib import import_module
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING

from steerd.daemon.cli.inputs import reads_car, reads_lane
from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.daemon.process.child import CORE, Prepared, prepared
from steerd.daemon.process.view_job import DEFAULT_PORT, check_view
from steerd.daemon.settings.run_options import ControllerKind, RunOptions

if TYPE_CHECKING:
    from steerd.daemon.assembly.build import RunPlan


FIRST_OPTIONS = (
    "--port", "--mocap", "--sim", "--fast", "--car", "--path", "--speed", "--duration", "--record",
    "--page",
)  # fmt: skip
"""What `--help` shows; `--help-all` shows the rest too."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `steerd run`."""
    where = parser.add_argument_group("hardware")
    where.add_argument("--port", metavar="DEV", help="serial port of the VESC, e.g. /dev/ttyACM0")
    where.add_argument(
        "--mocap",
        metavar="URL",
        help="natnet://HOST[:PORT]/BODY[?up=y|z], vrpn://HOST[:PORT]/BODY, ros2:///TOPIC or "
        "zenoh:KEY",
    )
    where.add_argument("--sim", action="store_true", help="simulated hardware on a pty and sockets")
    where.add_argument("--fast", action="store_true", help="with --sim: virtual time, repeatable")
    reads_car(where.add_argument(
        "--sim-car", metavar="FILE.toml|hidden:SEED",
        help="the simulated car, where it is not --car's: a file, or one that the seed hides",
    ))  # fmt: skip
    add_drive_arguments(parser)
    run = parser.add_argument_group("run")
    run.add_argument(
        "--record", metavar="PATH", help="session file (default: dated, in the data folder)"
    )
    run.add_argument("--seed", type=int, default=0, help="of the simulated hardware's noise")
    run.add_argument(
        "--effect",
        action="append",
        default=[],
        metavar="NAME=VALUE,…",
        help="unmodelled effect of the simulated car (`steerd effects` lists them)",
    )
    run.add_argument("--auto-arm", action="store_true", help="simulation: arm and start by itself")
    run.add_argument(
        "--controller",
        choices=[kind.value for kind in ControllerKind],
        default="lane",
        help="zenoh: apply the commands of `steerd control`; ros2: those of a ROS node's /drive",
    )
    _add_network_arguments(run)


def _add_network_arguments(run: argparse._ArgumentGroup) -> None:
    """The bus, and who else may see the car."""
    run.add_argument("--listen", metavar="ENDPOINT", help="of zenoh (default tcp/127.0.0.1:7447)")
    run.add_argument(
        "--lab", type=Path, metavar="DIR", help="the car's folder of `steerd keys`: mutual TLS"
    )
    run.add_argument(
        "--insecure-lan", action="store_true", help="allow plain zenoh beyond loopback"
    )
    run.add_argument(
        "--ros-domain",
        type=int,
        metavar="N",
        help="show the car to ROS 2 nodes of this domain that use rmw_zenoh",
    )
    run.add_argument(
        "--learn",
        action="store_true",
        help="learn the car while it drives, and say when it changed",
    )
    run.add_argument(
        "--adapt",
        action="store_true",
        help="with --learn: the lane keeper follows the learnt car, checked at each step",
    )
    run.add_argument(
        "--view",
        nargs="?",
        const=str(DEFAULT_PORT),
        metavar="[HOST:]PORT",
        help="show it live in Foxglove or Lichtblick, at the address that is printed",
    )
    run.add_argument(
        "--view-sets",
        action="store_true",
        help="with --view on loopback: live parameters may be set in Foxglove",
    )
    run.add_argument(
        "--page",
        nargs="?",
        type=int,
        const=0,
        metavar="PORT",
        help="a live page in a browser on this machine, with a stop button",
    )


def add_drive_arguments(parser: argparse.ArgumentParser) -> None:
    """What to drive; shared with `steerd control`."""
    drive = parser.add_argument_group("drive")
    reads_car(drive.add_argument(
        "--car", metavar="FILE.toml", help="car file (default: F1TENTH's figures)"
    ))  # fmt: skip
    drive.add_argument("--name", default="car1", help="the car's name on the bus and in files")
    reads_lane(drive.add_argument(
        "--path", default="figure8",
        help="line, circle:radius=2, figure8[:radius=…], csv:FILE (TUM or F1TENTH centreline)",
    ))  # fmt: skip
    drive.add_argument("--speed", type=float, default=1.0, metavar="M/S", help="on straights")
    drive.add_argument("--duration", type=float, metavar="S", help="end after this drive time")
    drive.add_argument("--rate", type=float, default=100.0, metavar="HZ", help="of the loop")


def make_options(args: argparse.Namespace) -> RunOptions:
    """Typed options from the command line.

    Raises:
        SteerdError: a combination makes no sense.
    """
    _check_hardware(args)
    if args.duration is not None and not 0.0 < args.duration <= 86400.0:
        raise SteerdError(f"--duration {args.duration:g}: more than 0 s", "", ExitCode.USAGE)
    if args.speed is not None and not 0.0 < args.speed < inf:
        raise SteerdError(f"--speed {args.speed:g}: more than 0 m/s", "", ExitCode.USAGE)
    if args.seed < 0:
        raise SteerdError(f"--seed {args.seed}: 0 or more", "", ExitCode.USAGE)
    if args.view or args.view_sets:
        _check_view(args)
    if args.page is not None:
        _check_page(args)
    ros = args.controller == ControllerKind.ROS2 or str(args.mocap).startswith("ros2:")
    if ros or args.ros_domain is not None:
        _check_ros(args)
    if args.adapt:
        _check_adapt(args)
    listen = _choose_endpoint(args)
    return RunOptions(
        car_file=args.car or "",
        car=args.name,
        port=args.port,
        mocap=args.mocap,
        path=args.path,
        speed=args.speed,
        duration_s=args.duration,
        record=args.record,
        seed=args.seed,
        rate_hz=args.rate,
        controller=ControllerKind(args.controller),
        simulated=args.sim,
        auto_arm=args.auto_arm or args.fast,
        effects=tuple(args.effect),
        listen=listen,
        lab=str(args.lab.resolve()) if args.lab else "",
        insecure_lan=args.insecure_lan,
        view=args.view or "",
        ros_domain=args.ros_domain,
        sim_car=args.sim_car or "",
        page=args.page,
        view_sets=args.view_sets,
        learn=args.learn,
        adapt=args.adapt,
    )


def _check_hardware(args: argparse.Namespace) -> None:
    if args.fast and not args.sim:
        raise SteerdError(
            "--fast drives in virtual time, on simulated hardware", "add --sim", ExitCode.USAGE
        )
    if args.sim and (args.port or args.mocap):
        raise SteerdError(
            "--sim has its own port and mocap", "drop --sim, or --port and --mocap", ExitCode.USAGE
        )
    if not args.sim and not (args.port and args.mocap):
        hint = "steerd run --port /dev/ttyACM0 --mocap natnet://HOST/BODY, or steerd run --sim"
        raise SteerdError("a car needs --port and --mocap", hint, ExitCode.USAGE)
    if not args.sim and (args.auto_arm or args.effect):
        raise SteerdError("--auto-arm and --effect are for --sim only", "", ExitCode.USAGE)
    if not args.sim and args.sim_car:
        raise SteerdError("--sim-car is the simulated car", "add --sim", ExitCode.USAGE)


def _check_adapt(args: argparse.Namespace) -> None:
    if not args.learn:
        raise SteerdError("--adapt follows what is learnt", "add --learn", ExitCode.USAGE)
    if args.controller != ControllerKind.LANE:
        what = "--adapt is about the lane keeper, and another program drives"
        raise SteerdError(what, "drop --adapt or --controller", ExitCode.USAGE)


def _choose_endpoint(args: argparse.Namespace) -> str:
    if args.lab is None:
        return args.listen or RunOptions.listen
    from steerd.daemon.ipc.operator import read_lab

    lab = read_lab(args.lab)
    if lab.car != args.name:
        what = f"the certificates in {args.lab} are for {lab.car!r}, not {args.name!r}"
        raise SteerdError(what, f"--name {lab.car}", ExitCode.USAGE)
    endpoint = str(args.listen or lab.endpoint)
    if not endpoint.startswith("tls/"):
        raise SteerdError(f"--lab uses TLS, not {endpoint}", "drop --listen", ExitCode.USAGE)
    return endpoint


def _check_ros(args: argparse.Namespace) -> None:
    from steerd.steer_bus.ros_keys import DOMAIN_MAX

    if not 0 <= (args.ros_domain or 0) <= DOMAIN_MAX:
        what = f"--ros-domain {args.ros_domain}: 0 to {DOMAIN_MAX}"
        raise SteerdError(what, "", ExitCode.USAGE)
    if args.lab is not None:
        what = "the hub of a lab passes steerd's own topics only, not those of ROS"
        raise SteerdError(what, "drop --lab, or --ros-domain and what is ros2", ExitCode.USAGE)


def _check_view(args: argparse.Namespace) -> None:
    if not args.view:
        raise SteerdError("--view-sets is about the viewer", "add --view", ExitCode.USAGE)
    if args.fast:
        hint = "drop --fast; open the session in Foxglove, or with `steerd plot`"
        raise SteerdError("--view shows a drive as it happens", hint, ExitCode.USAGE)
    check_view(args.view, args.insecure_lan, sets=args.view_sets)


def _check_page(args: argparse.Namespace) -> None:
    from steerd.daemon.process.page_job import check_page

    if args.fast:
        raise SteerdError("--page shows a drive as it happens", "drop --fast", ExitCode.USAGE)
    if not 0 <= args.page < 65536:
        raise SteerdError(f"--page {args.page}: a port, 0 to 65535", "", ExitCode.USAGE)
    check_page(str(args.lab or ""), "" if args.listen == "" else "bus")


def run(args: argparse.Namespace) -> int:
    """Run the command."""
    options = make_options(args)

    def make() -> "RunPlan":
        from steerd.daemon.assembly.build import make_plan

        return make_plan(options, design=args.fast)

    return drive(make, fast=args.fast)


def drive(make: Callable[[], "RunPlan"], *, fast: bool) -> int:
    """Drive a plan: in virtual time, on simulated hardware or on a car.

    The control core's process loads for a second; meanwhile this one makes the plan.
    """
    if fast:
        from steerd.daemon.offline.fast import run_fast

        return run_fast(make())
    with prepared(CORE) as core:
        plan = make()
        return _run_simulated(plan, core) if plan.options.simulated else _run_live(plan, core)[0]


def _run_simulated(plan: "RunPlan", core: Prepared) -> int:
    from dataclasses import replace

    from steerd.daemon.assembly.build import make_world_config
    from steerd.sim_hw.real_time.links import spawn_sim

    signal.signal(signal.SIGINT, signal.default_int_handler)
    # While the simulated hardware starts, this process loads what it needs next.
    threading.Thread(target=import_module, args=(_LIVE,), daemon=True).start()
    with spawn_sim(make_world_config(plan)) as sim:
        options = replace(plan.options, port=sim.port, mocap=sim.mocap_url)
        code, reason = _run_live(replace(plan, options=options), core)
    if code == ExitCode.STOPPED and _was_busy(plan, reason):
        return _fall_back(plan)
    return code


_LIVE = "steerd.daemon.terminal.terminal"
"""What a drive in real time loads first."""
_BUSY = ("W1 ", "W7 ", "W8 ", "W9 ", "W15 ", "W16 ")
"""Watchdogs that a machine without time for simulated hardware trips."""


def _was_busy(plan: "RunPlan", reason: str) -> bool:
    """Whether a drive by itself was ended by its machine, and may be driven in virtual time."""
    options = plan.options
    # Whoever opened a page or a viewer wants to see it drive, not to wait for a drive without one.
    watched = options.page is not None or options.view
    alone = options.auto_arm and options.duration_s is not None and not options.effects
    return alone and not watched and reason.startswith(_BUSY)


def _fall_back(plan: "RunPlan") -> int:
    """Drive the plan again in virtual time, into a session of its own."""
    from dataclasses import replace

    from steerd.daemon.offline.fast import run_fast

    print("this machine was too busy for real time: the same drive again, in virtual time")
    record = plan.options.record
    named = str(Path(record).with_suffix(".fast.mcap")) if record else None
    return run_fast(replace(plan, options=replace(plan.options, record=named)))


def _run_live(plan: "RunPlan", core: Prepared) -> tuple[int, str]:
    """Drive in real time; the exit code, and why the car was stopped."""
    from steerd.daemon.assembly.session_meta import default_session_path
    from steerd.daemon.ipc.operator import Operator
    from steerd.daemon.process.children import start_processes
    from steerd.daemon.terminal.closing import closing_lines
    from steerd.daemon.terminal.dashboard import Dashboard
    from steerd.daemon.terminal.terminal import Terminal
    from steerd.steer_bus.clock import MonotonicClock

    clock, boot_id = MonotonicClock(), secrets.randbits(63)
    epoch_ns = clock.realtime_ns() - clock.now_ns()
    record = plan.options.record
    session = (
        Path(record)
        if record
        else default_session_path(plan.options.car, clock.realtime_ns(), boot_id)
    )
    leased = plan.settings.deadman and not plan.options.simulated
    processes = start_processes(plan, session, boot_id, epoch_ns, leased, core)
    for line in processes.core_report.get("realtime", ()):
        print(f"note: {line}", file=sys.stderr)
    if processes.view_url:
        print(f"view: {processes.view_url} (Foxglove or Lichtblick: Open connection)")
    if processes.page is not None:
        print(f"page: {processes.page.url} (in a browser on this machine)")
    where = "simulated hardware" if plan.options.simulated else str(plan.options.port)
    board = Dashboard(f"steerd · {plan.options.car} on {where} · {plan.path.name}")
    operator = Operator(boot_id, secrets.randbits(62) + 1, "terminal")
    Terminal(processes, board, operator, clock).run()
    code = processes.end()
    summary, *where_to = closing_lines(plan, board.tally, session)
    print(summary)
    if code == ExitCode.STOPPED and board.stop:
        print(f"stopped: {board.stop}")
    print("\n".join(where_to))
    return code, board.stop
