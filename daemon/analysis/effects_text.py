"""The library of effects: table, single effect, JSON and the page `docs/reference/effects.md`."""

import shutil
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from steerd.car_model.effect import Effect, Stage
from steerd.car_model.effects import EFFECTS
from steerd.daemon.common.screen import wrap, wrap_command
from steerd.sysid.report.page import render_page

_STAGES = {
    Stage.COMMAND: "from the command to the actuators' aim",
    Stage.ACTUATOR: "servo, linkage, motor and wheels",
    Stage.FORCES: "tyres, loads, mass and floor",
    Stage.OBSERVE: "what mocap and wheel speed show",
}
_NAME, _PARAMETERS = 30, 36


def by_stage() -> dict[Stage, list[Effect]]:
    """Effects by stage, in the order of the chain, then by name."""
    ordered = sorted(EFFECTS.values(), key=lambda effect: effect.name)
    return {stage: [e for e in ordered if e.stage is stage] for stage in Stage}


def format_table() -> str:
    """All effects, one line each, with their equations where the terminal is wide enough."""
    width = shutil.get_terminal_size().columns if sys.stdout.isatty() else 1000
    equations = width >= _NAME + _PARAMETERS + max(len(e.equation) for e in EFFECTS.values())
    head = f"{'effect':<{_NAME}}{'parameters: null (range) unit':<{_PARAMETERS}}"
    lines = [f"{head}{'equation' if equations else ''}".rstrip()]
    for stage, effects in by_stage().items():
        lines.append(f"{stage}: {_STAGES[stage]}")
        for effect in effects:
            parameters = ", ".join(p.name for p in effect.parameters)
            if len(effect.parameters) == 1:  # the others' ranges are elsewhere
                (p,) = effect.parameters
                unit = "" if p.unit == "1" else p.unit
                parameters = f"{p.name} {p.null:g} ({p.low:g} to {p.high:g}) {unit}".rstrip()
            line = f"  {effect.name:<{_NAME - 2}}{parameters:<{_PARAMETERS}}"
            lines.append((line + effect.equation if equations else line).rstrip())
    lines += ["`steerd effects NAME` shows one and its equation;"]
    lines += ["`--effect NAME=VALUE` switches one on in a simulation."]
    return "\n".join(lines)


def format_effect(effect: Effect) -> str:
    """One effect in detail."""
    rest = " " * 12
    lines = [
        *wrap(f"{effect.name}: {effect.summary}", rest="  "),
        f"  stage     {effect.stage} ({_STAGES[effect.stage]})",
        f"  family    {effect.family}",
        *wrap(effect.equation, "  equation  ", rest),
        *wrap(", ".join(effect.aliases) or "none", "  aliases   ", rest),
        "",
        f"  {'parameter':<12}{'null':>6}{'low':>7}{'high':>7}{'usual':>7}  unit     meaning",
    ]
    for p in effect.parameters:
        numbers = f"{p.null:>6g}{p.low:>7g}{p.high:>7g}{p.scale:>7g}"
        head = f"  {p.name:<12}{numbers}  {p.unit:<7}  "
        lines += wrap(p.meaning, head, " " * len(head))
    moved = [min(max(p.null + p.scale, p.low), p.high) for p in effect.parameters]
    for i, p in enumerate(effect.parameters):
        moved[i] = moved[i] if moved[i] != p.null else p.null - p.scale
    values = ",".join(f"{value:g}" for value in moved)
    example = f"steerd run --sim --fast --duration 20 --effect {effect.name}={values}"
    return "\n".join([*lines, "", *wrap_command(example, "  try: ", "       ")])


def make_json(effects: Iterable[Effect]) -> dict[str, Any]:
    """The effects as JSON values."""
    keys = ("name", "stage", "family", "summary", "equation")
    described = [
        {
            **{key: getattr(effect, key) for key in keys},
            "aliases": list(effect.aliases),
            "parameters": [
                {key: each for key, each in p._asdict().items() if key != "role"}
                for p in effect.parameters
            ],
        }
        for effect in effects
    ]
    return {"schema": "steerd.effects/1", "effects": described}


def make_page() -> str:
    """The page `docs/reference/effects.md`."""
    page = Path(__file__).with_name("effects.md.jinja")
    return render_page(page, stages=by_stage(), words=_STAGES)
