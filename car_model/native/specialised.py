"""Specialises equations to a range of their inputs, such as speeds above walking pace.

Below walking pace the tyre equations are blended into kinematic ones, which cost as much again and
have no weight above it. Interval arithmetic bounds what is computed from bounded inputs. A select,
min or max that its bounds decide is replaced by the argument it takes, and what is then multiplied
by zero is dropped. The inverse of a product becomes a product of inverses, which are shared:
divisions take the longest.
"""

# Why: docs/decisions/vehicle-model.md#d40

from collections.abc import Mapping, Sequence
from math import inf, isfinite
from typing import NamedTuple

from steerd.car_model.tape import Node, apply, needed

SPECIALISED_SPEED = 0.55
"""Above this speed the kinematic blend has no weight [m/s]; the blend ends at 0.5 m/s."""


class Range(NamedTuple):
    """Bounds of a value."""

    low: float
    high: float


ANY = Range(-inf, inf)


def _add(a: Range, b: Range) -> Range:
    return Range(a.low + b.low, a.high + b.high)


def _multiply(a: Range, b: Range) -> Range:
    if 0.0 < a.low == a.high:
        return Range(a.low * b.low, a.low * b.high)
    if 0.0 < b.low == b.high:
        return _multiply(b, a)
    found = [x * y for x in a for y in b]
    return Range(min(found), max(found)) if all(map(isfinite, found)) else ANY


def _range(op: str, args: Sequence[Range]) -> Range:
    """Bounds of a result."""
    match op:
        case "add":
            return _add(args[0], args[1])
        case "sub":
            return _add(args[0], Range(-args[1].high, -args[1].low))
        case "neg":
            return Range(-args[0].high, -args[0].low)
        case "mul":
            return _multiply(args[0], args[1])
        case "min":
            return Range(min(a.low for a in args), min(a.high for a in args))
        case "max":
            return Range(max(a.low for a in args), max(a.high for a in args))
    return ANY


def _decided(op: str, nodes: Sequence[Node], ranges: Sequence[Range]) -> Node | None:
    """The argument that a select, min or max always takes within the bounds, if there is one."""
    if op == "select":
        return nodes[1] if ranges[0].low > 0.0 else nodes[2] if ranges[0].high <= 0.0 else None
    if op not in ("min", "max"):
        return None
    smaller = 0 if ranges[0].high <= ranges[1].low else 1 if ranges[1].high <= ranges[0].low else 2
    if smaller == 2:
        return None
    return nodes[smaller] if op == "min" else nodes[1 - smaller]


def _apply(op: str, nodes: Sequence[Node]) -> Node:
    """Record the operation, the inverse of a product as a product of inverses."""
    inner = nodes[0].entry
    if op != "inverse" or inner.op != "mul":
        return apply(op, *nodes)
    one, other = (_apply(op, [Node(nodes[0].tape, place)]) for place in inner.args)
    return one * other


def specialise(outputs: Sequence[Node], known: Mapping[int, Range]) -> tuple[Node, ...]:
    """The same outputs under bounds of some inputs (by place), on the same record."""
    tape = outputs[0].tape
    made: dict[int, Node] = {}
    bounds: dict[int, Range] = {}
    for place in needed(outputs):
        entry = tape.entries[place]
        if not entry.args:
            made[place] = Node(tape, place)
            here = known.get(place, ANY)
            bounds[place] = Range(entry.value, entry.value) if entry.op == "const" else here
            continue
        nodes = [made[a] for a in entry.args]
        ranges = [bounds[a] for a in entry.args]
        chosen = _decided(entry.op, nodes, ranges)
        made[place] = _apply(entry.op, nodes) if chosen is None else chosen
        result = made[place].entry
        fixed = result.op == "const"
        bounds[place] = Range(result.value, result.value) if fixed else _range(entry.op, ranges)
    return tuple(made[output.place] for output in outputs)
