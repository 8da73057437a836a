"""Commands on a car file, and on the effects that it may name."""

import re
from argparse import ArgumentParser, Namespace
from dataclasses import replace
from math import degrees
from pathlib import Path

from steerd.daemon.cli.arguments import missing_car, missing_file, option
from steerd.daemon.common.errors import ExitCode, SteerdError, UsageError, load_car_file
from steerd.daemon.common.screen import NBSP, clean, show_progress, wrap
from steerd.daemon.common.written import check_outputs, write_outputs
from steerd.daemon.settings import car_edit
from steerd.daemon.settings.config import Settings, load_settings
from steerd.vesc_link.scaling import steer_limits


def config_arguments(parser: ArgumentParser) -> None:
    option(parser, "--check", "FILE.toml", "check this car file", missing_car, type=Path)
    text = "print a car file with its gains"
    option(parser, "--from-vesc-yaml", "FILE", text, missing_file, type=Path)
    option(parser, "--to-vesc-yaml", "FILE", "write the gains there, or make the file", type=Path)


def config(args: Namespace) -> None:
    """The car file: print a default, check one, convert gains of F1TENTH's vesc.yaml.

    steerd config > car.toml
    steerd config --check car.toml
    steerd config --from-vesc-yaml vesc.yaml > car.toml
    steerd config --check car.toml --to-vesc-yaml vesc.yaml
    """
    if args.from_vesc_yaml:
        base = load_settings(args.check)
        scaling = car_edit.read_vesc_yaml(_read(args.from_vesc_yaml), base.scaling)
        print(car_edit.edit_car(base.file, car_edit.make_car_values(scaling)).text, end="")
    elif args.to_vesc_yaml:
        settings, out = load_settings(args.check), args.to_vesc_yaml
        text = car_edit.make_vesc_yaml(settings.scaling, _read(out) if out.exists() else "")
        write_outputs({out: text})
        print(f"{out}: gains of {settings.file.name}")
    elif args.check:
        from steerd.daemon.assembly.build import plan_car

        plan = plan_car(load_car_file(args.check))
        print("\n".join(_describe(plan.settings)))
        label = "  controller  "
        about = re.sub(r"(?<=\d) (?=[mH])", NBSP, plan.controller.report.describe())  # its unit
        print("\n".join(wrap(about, label, " " * len(label))))
    else:
        print(load_settings(None).file.text, end="")


def _describe(settings: Settings) -> list[str]:
    car, scaling, limits = settings.file.car, settings.scaling, settings.limits
    right, left = steer_limits(scaling)
    effects = ", ".join(effect.name for effect in settings.file.effects) or "none"
    return [
        f"{settings.file.path}: {settings.file.name}",
        f"  car         wheelbase {car.lf + car.lr:.4f} m, mass {car.mass:g} kg, grip {car.mu:g}",
        f"  steering    {degrees(limits.steer_left_max):.1f}° left, "
        f"{degrees(limits.steer_right_max):.1f}° right"
        f" (the servo reaches {degrees(left):.1f}° and {degrees(-right):.1f}°)",
        f"  speed       {settings.controller.speed:g} m/s, at most {limits.speed_max:g} m/s; "
        f"{scaling.erpm_gain:g} ERPM per m/s",
        f"  stop        {settings.brakes.brake_current_a:g} A brake current",
        f"  effects     {effects}",
    ]


def _read(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        why = getattr(error, "strerror", None) or "not a text file"
        hint = "name F1TENTH's vesc.yaml"
        raise SteerdError(f"{path}: {why}", hint, ExitCode.UNREADABLE) from None


def export_arguments(parser: ArgumentParser) -> None:
    option(parser, "car", "CAR.toml", "a car file", missing_car, type=Path)
    text = "FILE.yaml for f1tenth_gym, FILE.xml for MuJoCo"
    option(parser, "-o --output", "FILE", text, type=Path, required=True)


def export(args: Namespace) -> None:
    """A car file for other simulators: f1tenth_gym's parameters, or a MuJoCo model.

    steerd export car.toml -o f1tenth.yaml   # the params of f1tenth_gym
    steerd export car.toml -o car.xml        # a MuJoCo model (MJCF)

    Both hold less than the car file: what is lost is printed, and is in the file.
    """
    from steerd.daemon.setup.car_export import make_gym_yaml, make_mjcf

    kind = args.output.suffix.lower()
    if kind not in (".yaml", ".yml", ".xml"):
        what = f"-o {args.output}: no format of that name"
        raise UsageError(what, "name it .yaml for f1tenth_gym, .xml for MuJoCo")
    check_outputs({"-o": args.output})
    settings = load_settings(args.car)
    file = replace(settings.file, name=clean(settings.file.name))
    if kind == ".xml":
        made = make_mjcf(file, settings.controller.speed)
    else:
        made = make_gym_yaml(file, settings.limits.speed_max)
    write_outputs({args.output: made.text})
    print(f"{args.output}: written. What is lost:")
    for sentence in made.lost:
        print("\n".join(wrap(sentence, "  - ", "    ")))


def effects_arguments(parser: ArgumentParser) -> None:
    option(parser, "name", "NAME", "one effect, or an alias of it", nargs="?")
    option(parser, "--json", "", "the same for programs")
    option(parser, "--page", "", "the same as a Markdown page")
    own = parser.add_argument_group("effects of your own").add_mutually_exclusive_group()
    option(own, "--add", "FILE.py", "add those of a file", missing_file, type=Path)
    option(own, "--remove", "NAME.py", "take them away again", type=Path)


def effects(args: Namespace) -> None:
    """The effects that can be simulated and diagnosed, with their equations.

    steerd effects
    steerd effects steer_backlash
    steerd effects --add my_effect.py       # build one of your own into the library

    An effect that was added is simulated, identified and named like any other, in
    every command, car file and notebook of this installation. Building takes a
    minute and a C compiler (`pip install ziglang`).
    """
    if args.add or args.remove:
        from steerd.daemon.setup.own_effect import add_effect, remove_effect

        with show_progress("compiling the equations", 1.0):
            names = add_effect(args.add) if args.add else remove_effect(args.remove)
        print(f"added: {', '.join(names)}; try: steerd effects {names[0]}" if names else "removed")
        return
    from steerd.car_model.effects import EFFECTS
    from steerd.daemon.analysis import effects_text
    from steerd.daemon.analysis.options import read_effects

    named = [EFFECTS[name] for name in read_effects([args.name] if args.name else [])]
    if args.json:
        import json

        print(json.dumps(effects_text.make_json(named or EFFECTS.values()), indent=1))
    elif args.page:
        print(effects_text.make_page(), end="")
    else:
        print(effects_text.format_effect(named[0]) if named else effects_text.format_table())
