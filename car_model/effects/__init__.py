"""The library of unmodelled effects: one file for each family of causes, found by itself.

Every `Effect` that a module of this folder defines belongs to the library. A new one joins its
family's file or comes in a file of its own: it then appears in `steerd effects`, in `--effect`, in
car files and in the diagnosis.
"""

import difflib
import math
import pkgutil
from collections.abc import Mapping
from importlib import import_module

from steerd.car_model.effect import Effect, EffectParameter

Setting = tuple[Effect, tuple[float, ...]]  # an effect and the values of its parameters


def _discovered() -> dict[str, Effect]:
    """The effects of all modules, by name."""
    names = sorted(f"{__name__}.{info.name}" for info in pkgutil.iter_modules(__path__))
    values = (value for name in names for value in vars(import_module(name)).values())
    return {value.name: value for value in values if isinstance(value, Effect)}


EFFECTS: Mapping[str, Effect] = _discovered()
ALIASES: Mapping[str, str] = {
    alias: effect.name for effect in EFFECTS.values() for alias in effect.aliases
}


def find_effect(name: str) -> Effect:
    """The effect of that name or alias.

    Raises:
        ValueError: There is none; the message names the nearest.
    """
    known = ALIASES.get(name, name)
    if known in EFFECTS:
        return EFFECTS[known]
    near = difflib.get_close_matches(name, [*EFFECTS, *ALIASES], n=1)
    hint = f"did you mean {near[0]!r}?" if near else "`steerd effects` lists them"
    raise ValueError(f"no effect {name!r}; {hint}")


def check_value(effect: Effect, parameter: EffectParameter, value: float) -> float:
    """The value, if the parameter may have it.

    Raises:
        ValueError: It is not finite or outside the parameter's bounds.
    """
    if math.isfinite(value) and parameter.low <= value <= parameter.high:
        return value
    raise ValueError(
        f"{effect.name}: {parameter.name} is {value:g} {parameter.unit}, "
        f"outside {parameter.low:g} to {parameter.high:g}"
    )


def parse_effects(text: str) -> list[Setting]:
    """Effects with their values out of a command line, commas between them.

    `steer_delay=0.03`; several parameters in order, `grip_patch=2,0.5,0.4,0.3`; by name,
    `grip_patch:x=2,drop=0.3`. Parameters that are not given stay at their null, and what has no `=`
    is the next value of the effect before it: `steer_delay=0.03,floor_slope=0.005,0.002`.

    Raises:
        ValueError: The text is not such a list; the message says where.
    """
    groups: list[tuple[Effect, bool, list[str]]] = []
    for piece in text.split(","):
        head, equals, value = (part.strip() for part in piece.partition("="))
        if groups and _continues(groups[-1], head, bool(equals)):
            groups[-1][2].append(piece)
            continue
        name, colon, parameter = head.partition(":")
        if not equals:
            raise ValueError(f"write NAME=VALUE, as in steer_delay=0.03, not {piece.strip()!r}")
        effect = find_effect(name.strip())
        groups.append((effect, bool(colon), [f"{parameter}={value}" if colon else value]))
    return [(effect, _values(effect, pieces)) for effect, _, pieces in groups]


def _continues(group: tuple[Effect, bool, list[str]], head: str, equals: bool) -> bool:
    """Whether a piece belongs to the effect before it."""
    effect, by_name, _ = group
    return (by_name and any(head == p.name for p in effect.parameters)) if equals else not by_name


def _values(effect: Effect, pieces: list[str]) -> tuple[float, ...]:
    """Parameter values from pieces `value` (in order) or `name=value`."""
    values = list(effect.nulls)
    names = [p.name for p in effect.parameters]
    if len(pieces) > len(names):
        raise ValueError(f"{effect.name} takes {', '.join(names)}, not {len(pieces)} values")
    for index, piece in enumerate(pieces):
        name, _, number = piece.rpartition("=")
        name = name.strip() or names[index]
        if name not in names:
            raise ValueError(f"{effect.name} takes {', '.join(names)}, not {name!r}")
        at = names.index(name)
        values[at] = check_value(effect, effect.parameters[at], _number(effect, name, number))
    return tuple(values)


def _number(effect: Effect, name: str, text: str) -> float:
    """The number that a text says."""
    try:
        return float(text)
    except ValueError:
        raise ValueError(f"{effect.name}: {name} must be a number, not {text.strip()!r}") from None
