"""`steerd run` and `steerd collect`: a drive, in real or in virtual time."""

import contextlib
import secrets
import signal
import sys
import threading
from argparse import ArgumentParser, Namespace
from collections.abc import Iterator
from dataclasses import fields, replace
from importlib import import_module
from pathlib import Path
from sys import float_info
from typing import TYPE_CHECKING

from steerd.daemon.assembly.plans import NAMES, make_closed_path, parse_box
from steerd.daemon.cli.arguments import missing_car, missing_lane, option
from steerd.daemon.common.errors import ExitCode, UsageError, refusing
from steerd.daemon.process.child import CORE, Child
from steerd.daemon.process.view_job import DEFAULT_PORT, check_view
from steerd.daemon.settings.run_options import ControllerKind, RunOptions

if TYPE_CHECKING:
    from steerd.daemon.assembly.build import RunPlan


_FIRST = (
    "--port", "--mocap", "--sim", "--fast", "--car", "--path", "--speed", "--duration", "--record",
    "--page",
)  # fmt: skip
FIRST_OPTIONS = {"run": _FIRST, "collect": ("--plan", "--closed", "--box", *_FIRST)}
"""What `--help` shows, by command; `--help-all` shows the rest too."""
PLAN_SPEED = 2.5  # highest speed of a plan unless said otherwise [m/s]


def run_arguments(parser: ArgumentParser) -> None:
    where = parser.add_argument_group("hardware")
    option(where, "--port", "DEV", "serial port of the VESC, e.g. /dev/ttyACM0")
    text = "natnet://HOST[:PORT]/BODY[?up=y|z], vrpn://HOST[:PORT]/BODY, ros2:///TOPIC or zenoh:KEY"
    option(where, "--mocap", "URL", text)
    option(where, "--sim", "", "simulated hardware on a pty and sockets")
    option(where, "--fast", "", "with --sim: virtual time, repeatable")
    text = "the simulated car, where it is not --car's: a file, or one that the seed hides"
    option(where, "--sim-car", "FILE.toml|hidden:SEED", text, missing_car)
    add_drive_arguments(parser)
    run = parser.add_argument_group("run")
    option(run, "--record", "PATH", "session file (default: dated, in the data folder)")
    text = "of the simulated hardware's noise"
    option(run, "--seed", None, text, type=int, default=RunOptions.seed)
    text = "unmodelled effect of the simulated car (`steerd effects` lists them)"
    option(run, "--effect", "NAME=VALUE,…", text, action="append")
    option(run, "--auto-arm", "", "simulation: arm and start by itself")
    text = "zenoh: apply the commands of `steerd control`; ros2: those of a ROS node's /drive"
    kinds = [kind.value for kind in ControllerKind]
    option(run, "--controller", None, text, choices=kinds, default="lane")
    option(run, "--listen", "ENDPOINT", f"of zenoh (default {RunOptions.listen})")
    option(run, "--lab", "DIR", "the car's folder of `steerd keys`: mutual TLS", type=Path)
    option(run, "--insecure-lan", "", "allow plain zenoh beyond loopback")
    text = "show the car to ROS 2 nodes of this domain that use rmw_zenoh"
    option(run, "--ros-domain", "N", text, type=int)
    option(run, "--learn", "", "learn the car while it drives, and say when it changed")
    text = "with --learn: the lane keeper follows the learnt car, checked at each step"
    option(run, "--adapt", "", text)
    text = "show it live in Foxglove or Lichtblick, at the address that is printed"
    option(run, "--view", "[HOST:]PORT", text, nargs="?", const=str(DEFAULT_PORT))
    text = "with --view on loopback: live parameters may be set in Foxglove"
    option(run, "--view-sets", "", text)
    text = "a live page in a browser on this machine, with a stop button"
    option(run, "--page", "PORT", text, nargs="?", type=int, const=0)


def add_drive_arguments(parser: ArgumentParser) -> None:
    """What to drive; shared with `steerd control`."""
    drive = parser.add_argument_group("drive")
    option(drive, "--car", "FILE.toml", "car file (default: F1TENTH's figures)", missing_car)
    option(drive, "--name", None, "the car's name on the bus and in files", default=RunOptions.car)
    text = "line, circle:radius=2, figure8[:radius=…], csv:FILE (TUM or F1TENTH centreline)"
    option(drive, "--path", None, text, missing_lane, default=RunOptions.path)
    option(drive, "--speed", "M/S", "on straights", type=float, default=RunOptions.speed)
    option(drive, "--duration", "S", "end after this drive time", type=float)
    option(drive, "--rate", "HZ", "of the loop", type=float, default=RunOptions.rate_hz)


def make_options(args: Namespace) -> RunOptions:
    """Typed options from the command line; a SteerdError where a combination makes no sense."""
    for wrong, what, hint in _list_conflicts(args):
        if wrong:
            raise UsageError(what, hint)
    if args.view:
        check_view(args.view, args.insecure_lan, sets=args.view_sets)
    given = {f.name: getattr(args, f.name) for f in fields(RunOptions) if f.name in args}
    given |= {"car_file": args.car or "", "car": args.name, "duration_s": args.duration}
    given |= {"rate_hz": args.rate, "simulated": args.sim, "auto_arm": args.auto_arm or args.fast}
    given |= {"effects": tuple(args.effect), "controller": ControllerKind(args.controller)}
    given |= {"listen": args.listen or RunOptions.listen, "lab": ""}
    if args.lab is not None:
        given |= {"listen": _find_endpoint(args), "lab": str(args.lab.resolve())}
    given |= {"view": args.view or "", "sim_car": args.sim_car or ""}
    return RunOptions(**given)


def _list_conflicts(args: Namespace) -> Iterator[tuple[bool, str, str]]:
    """What makes no sense: whether it was given, what it is, and what to try."""
    from steerd.steer_bus.topics import DOMAIN_MAX

    sim, real = args.sim, args.port or args.mocap
    yield args.fast and not sim, "--fast drives in virtual time, on simulated hardware", "add --sim"
    yield sim and real, "--sim has its own port and mocap", "drop --sim, or --port and --mocap"
    hint = "steerd run --port /dev/ttyACM0 --mocap natnet://HOST/BODY, or steerd run --sim"
    yield not sim and not (args.port and args.mocap), "a car needs --port and --mocap", hint
    wrong = not sim and (args.auto_arm or args.effect)
    yield wrong, "--auto-arm and --effect are for --sim only", ""
    yield not sim and args.sim_car, "--sim-car is the simulated car", "add --sim"
    for name, unit, most in (("duration", "s", 86400.0), ("speed", "m/s", float_info.max)):
        value = getattr(args, name)
        wrong = value is not None and not 0.0 < value <= most
        yield wrong, f"--{name} {value or 0:g}: more than 0 {unit}", ""
    yield args.seed < 0, f"--seed {args.seed}: 0 or more", ""
    yield args.view_sets and not args.view, "--view-sets is about the viewer", "add --view"
    hint = "drop --fast; open the session in Foxglove, or with `steerd plot`"
    yield args.view and args.fast, "--view shows a drive as it happens", hint
    page = args.page is not None
    yield page and args.fast, "--page shows a drive as it happens", "drop --fast"
    yield page and not 0 <= args.page < 65536, f"--page {args.page}: a port, 0 to 65535", ""
    what = "--page: in a lab the page runs where the operator sits"
    yield page and args.lab is not None, what, "steerd page --lab DIR, with an operator's folder"
    domain = args.ros_domain
    wrong = domain is not None and not 0 <= domain <= DOMAIN_MAX
    yield wrong, f"--ros-domain {domain}: 0 to {DOMAIN_MAX}", ""
    what = "the hub of a lab passes steerd's own topics only, not those of ROS"
    ros = domain is not None or "ros2" in (args.controller, str(args.mocap).partition(":")[0])
    yield ros and args.lab is not None, what, "drop --lab, or --ros-domain and what is ros2"
    yield args.adapt and not args.learn, "--adapt follows what is learnt", "add --learn"
    what = "--adapt is about the lane keeper, and another program drives"
    lane = args.controller == ControllerKind.LANE
    yield args.adapt and not lane, what, "drop --adapt or --controller"


def _find_endpoint(args: Namespace) -> str:
    from steerd.daemon.process.bus_operator import read_lab

    lab = read_lab(args.lab)
    if lab.car != args.name:
        what = f"the certificates in {args.lab} are for {lab.car!r}, not {args.name!r}"
        raise UsageError(what, f"--name {lab.car}")
    endpoint = str(args.listen or lab.endpoint)
    if not endpoint.startswith("tls/"):
        raise UsageError(f"--lab uses TLS, not {endpoint}", "drop --listen")
    return endpoint


def run(args: Namespace) -> int:
    """Drive a car (--port, --mocap) or simulated hardware (--sim).

    On a car it starts disarmed. Arm and start it with the keys shown, or from
    another terminal with `steerd arm` and `steerd start`.
    """
    return drive(make_options(args), fast=args.fast)


def collect_arguments(parser: ArgumentParser) -> None:
    what = parser.add_argument_group("plan")
    option(what, "--plan", None, "what to drive", choices=NAMES, default="mixed")
    text = "add the plan to the lane keeper's commands, along --path (default: open loop)"
    option(what, "--closed", "", text)
    text = "where the car must stay [m]; start in the middle, heading along x"
    option(what, "--box", "SIDE|X0,Y0,X1,Y1", text)
    run_arguments(parser)
    parser.set_defaults(speed=PLAN_SPEED, path=None)


def collect(args: Namespace) -> int:
    """Drive an excitation plan and record it: a session that identifies the car.

    steerd collect --sim --fast --plan mixed --record mixed.mcap
    steerd collect --plan circles --box 6 --port /dev/vesc --mocap natnet://HOST/car

    Plans: circles (the paper's: 8 left, 8 right, steering at its limit, 1 m/s),
    slalom, chirp, steps, ramp (speed grows to the limit), speeds (steps of speed),
    mixed (several of them at several speeds: start with it).
    Supervisor, watchdogs and limits are those of `steerd run`; a box is a fence.
    """
    if args.controller != "lane":
        raise UsageError("a plan is driven by the daemon itself", "drop --controller")
    parts = [args.plan, "closed" if args.closed else f"speed={args.speed:g}"]
    if args.box:
        parts.append(f"box={args.box}")
    if not args.path and args.closed:
        with refusing():
            args.path = make_closed_path(parse_box(args.box) if args.box else None)
    args.path = args.path or "line"  # which is not followed in open loop
    return drive(replace(make_options(args), drill=";".join(parts)), fast=args.fast)


def drive(options: RunOptions, *, fast: bool) -> int:
    """Drive; the core's process loads for a second, in which this one makes the plan."""
    if fast:
        from steerd.daemon.assembly.build import make_plan
        from steerd.daemon.offline.fast import run_fast

        return run_fast(make_plan(options))
    with contextlib.closing(Child(CORE)) as core:
        from steerd.daemon.assembly.build import make_plan

        plan = make_plan(options, design=False)
        return _run_simulated(plan, core) if plan.options.simulated else _run_live(plan, core)[0]


def _run_simulated(plan: "RunPlan", core: Child) -> int:
    from steerd.daemon.assembly.build import make_world_config
    from steerd.sim_hw.real_time.links import spawn_sim

    signal.signal(signal.SIGINT, signal.default_int_handler)
    # While the simulated hardware starts, this process loads what it needs next.
    threading.Thread(target=import_module, args=(_LIVE,), daemon=True).start()
    with spawn_sim(make_world_config(plan)) as sim:
        linked = replace(plan.options, port=sim.port, mocap=sim.mocap_url)
        code, reason = _run_live(replace(plan, options=linked), core)
    options = plan.options
    # Whoever opened a page or a viewer wants to see it drive, not to wait for a drive without one.
    watched = options.page is not None or options.view
    alone = options.auto_arm and options.duration_s is not None and not options.effects
    if code != ExitCode.STOPPED or watched or not alone or not reason.startswith(_BUSY):
        return code
    from steerd.daemon.offline.fast import run_fast

    print("this machine was too busy for real time: the same drive again, in virtual time")
    named = str(Path(options.record).with_suffix(".fast.mcap")) if options.record else None
    return run_fast(replace(plan, options=replace(options, record=named)))


_LIVE = "steerd.daemon.terminal.terminal"  # what a drive in real time loads first
_BUSY = ("W1 ", "W7 ", "W8 ", "W9 ", "W15 ", "W16 ")  # watchdogs that a busy machine trips


def _run_live(plan: "RunPlan", core: Child) -> tuple[int, str]:
    """Drive in real time; the exit code, and why the car was stopped."""
    from steerd.daemon.assembly.build import RunId
    from steerd.daemon.assembly.session_meta import session_path
    from steerd.daemon.process.bus_operator import Operator
    from steerd.daemon.process.children import start_processes
    from steerd.daemon.terminal.dashboard import Dashboard, closing_lines
    from steerd.daemon.terminal.terminal import Terminal
    from steerd.steer_bus.clock import MonotonicClock

    clock, boot_id = MonotonicClock(), secrets.randbits(63)
    epoch_ns = clock.realtime_ns() - clock.now_ns()
    session = session_path(plan.options, clock.realtime_ns(), boot_id)
    leased = plan.settings.deadman and not plan.options.simulated
    plan = replace(plan, real=RunId(boot_id, epoch_ns, leased))
    processes = start_processes(plan, session, core)
    for line in processes.reports["core"].get("realtime", ()):
        print(f"note: {line}", file=sys.stderr)
    if "viewer" in processes.reports:
        url = processes.reports["viewer"]["url"]
        print(f"view: {url} (Foxglove or Lichtblick: Open connection)")
    if "page" in processes.reports:
        print(f"page: {processes.reports['page']['url']} (in a browser on this machine)")
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
