"""`steerd service`: what starts a drive without a person: systemd, ROS 2, udev."""

import getpass
import os
import shlex
import sys
from argparse import ArgumentParser, Namespace
from collections.abc import Iterable, Sequence
from pathlib import Path
from string import Template
from xml.sax.saxutils import quoteattr

from steerd.daemon.cli.arguments import list_actions, option
from steerd.daemon.cli.commands.run import make_options, run_arguments
from steerd.daemon.common.errors import UsageError, refusing
from steerd.daemon.common.written import write_whole
from steerd.daemon.settings.run_options import HIDDEN


def service_arguments(parser: ArgumentParser) -> None:
    option(parser, "action", None, "", choices=("install", "uninstall", "print", "launch", "udev"))
    whose = parser.add_mutually_exclusive_group()
    option(whose, "--user", "", "your own service manager (default)")
    option(whose, "--system", "", "the machine's; needs root")
    option(parser, "--force", "", "replace a unit that is there")
    run_arguments(parser)


def service(args: Namespace) -> None:
    """Run steerd as a service that starts disarmed: systemd's unit, ROS 2, udev.

    steerd service install --user --port /dev/vesc --mocap natnet://HOST/car
    steerd service print --port /dev/vesc --mocap natnet://HOST/car
    steerd service launch --port /dev/vesc --mocap natnet://HOST/car
    steerd service udev | sudo tee /etc/udev/rules.d/99-vesc.rules

    All options of `steerd run` are accepted and checked before anything is written.
    """
    user = not args.system
    own = Path(os.environ.get("XDG_CONFIG_HOME") or "~/.config", "systemd", "user")
    folder = own.expanduser() if user else Path("/etc/systemd/system")
    path, ctl = folder / "steerd.service", "systemctl --user" if user else "systemctl"
    if args.action == "uninstall":
        with refusing(f"{path}: "):
            path.unlink()
        print(f"{path}: removed\n   next: {ctl} disable --now steerd; {ctl} daemon-reload")
        return
    if args.action == "udev":
        text = _fill("99-vesc.rules")
    elif args.action == "launch":
        command = _make_command(args)
        _expect_writable(command, "launch file", "\n\r\0", "$(")  # which ROS would substitute
        text = _fill("steerd.launch.xml", command=quoteattr(shlex.join(command)))
    else:
        account = "" if user else os.environ.get("SUDO_USER") or getpass.getuser()
        text = make_unit(_make_command(args), args.name, account=account)
    if args.action == "install":
        if path.exists() and path.read_text() != text and not args.force:
            raise UsageError(f"{path} exists already", "--force replaces it")
        with refusing(f"{folder}: "):
            folder.mkdir(parents=True, exist_ok=True)
        write_whole(path, text)
        print(f"{path}: written")
        print(f"   next: {ctl} daemon-reload && {ctl} enable --now steerd")
        print("   then: steerd status; it waits, disarmed, until `steerd arm`")
        print("   once: steerd service udev | sudo tee /etc/udev/rules.d/99-vesc.rules")
        if user:
            print("   once: loginctl enable-linger, so that it starts without a login")
    else:
        print(text, end="")


def _make_command(args: Namespace) -> list[str]:
    """The command line of the run; a SteerdError for options that are wrong or no service's."""
    from steerd.daemon.assembly.build import make_plan

    if args.fast or args.auto_arm:
        what = "a service starts disarmed and runs in real time"
        raise UsageError(what, "leave out --fast and --auto-arm")
    make_plan(make_options(args))
    parser = ArgumentParser()
    run_arguments(parser)
    arguments = [sys.executable, "-m", "steerd", "run"]
    for action in list_actions(parser):
        value = getattr(args, action.dest, action.default)
        if value == action.default or not action.option_strings:
            continue
        name = action.option_strings[0]
        if value is True:
            arguments.append(name)
        elif isinstance(value, list):
            arguments += [part for each in value for part in (name, str(each))]
        else:
            arguments += [name, _absolute(str(value), action.dest)]
    return arguments


def _absolute(text: str, dest: str) -> str:
    if dest in ("car", "lab", "record", "sim_car") and not text.startswith(HIDDEN):
        return str(Path(text).resolve())
    if dest == "path" and text.startswith("csv:"):
        file, comma, rest = text.removeprefix("csv:").partition(",")
        return f"csv:{Path(file).resolve()}{comma}{rest}"
    return text


def make_unit(command: Sequence[str], car: str, *, account: str = "") -> str:
    """The unit file that runs a command; a SteerdError for an argument that it cannot hold.

    `account` is who it runs as under the system's service manager; empty for one's own, which
    cannot change accounts or mounts.
    """
    _expect_writable((*command, car, account), "unit file", "\n\r\0")
    protected = _fill("protected.service", account=account) if account else ""
    wanted = "multi-user.target" if account else "default.target"
    words = " ".join(map(_quote, command))
    return _fill("steerd.service", car=car, command=words, protected=protected, wanted=wanted)


def _expect_writable(words: Iterable[str], file: str, characters: str, *texts: str) -> None:
    for word in words:
        if any(part in word for part in (*characters, *texts)):
            raise UsageError(f"{word!r} cannot be written in a {file}")


def _fill(name: str, **values: str) -> str:
    """A file of `templates/` with its values."""
    text = Path(__file__).with_name("templates").joinpath(name).read_text(encoding="utf-8")
    return Template(text).substitute(values)


def _quote(part: str) -> str:
    """An argument in systemd's syntax: `%` and `$` are special, and escapes hold in all quotes."""
    plain = part.replace("%", "%%").replace("$", "$$")
    if shlex.quote(plain) == plain:
        return plain
    escaped = plain.replace("\\", "\\\\").replace('"', '\\"')
    return f'"{escaped}"'
