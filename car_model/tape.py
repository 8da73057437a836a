"""The equations as straight-line programs: `Ops` over nodes of a graph, with exact derivatives.

Running the generic equations over `Node`s records every operation once (equal operations share a
node). From the record come the compiled library (`steerd.car_model.native`) and, by the chain rule
over the record in reverse, exact Jacobians: no derivative is written by hand and none is
approximated. Compared with a computer-algebra system the formulas are never expanded, so the
printed code costs what the equations cost, and a derivative about three times that. Divisions
become products with shared inverses, and what a zero makes superfluous goes.

Source of the method: Griewank and Walther, Evaluating Derivatives (reverse accumulation).
"""

# Why: docs/decisions/rooms-and-code.md#d3

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from steerd.car_model.ops import FLOAT, Ops


class Entry(NamedTuple):
    """One operation: its name and the places of its arguments, or a constant's value.

    An input is identified by its name; a constant's name is its text, so that -0.0 is not 0.0.
    """

    op: str
    args: tuple[int, ...]
    value: float = 0.0
    name: str = ""


@dataclass
class Tape:
    """A record of operations; a node is a place in it."""

    entries: list[Entry] = field(default_factory=list)  # the operations, each after its arguments
    _places: dict[Entry, int] = field(default_factory=dict)

    def place(self, entry: Entry) -> int:
        """The place of this operation, recorded if it is new."""
        found = self._places.get(entry)
        if found is None:
            found = self._places[entry] = len(self.entries)
            self.entries.append(entry)
        return found

    def constant(self, value: float) -> "Node":
        """A number."""
        return Node(self, self.place(Entry("const", (), float(value), repr(float(value)))))

    def symbol(self, name: str) -> "Node":
        """An input of the program."""
        return Node(self, self.place(Entry("input", (), name=name)))

    def node(self, value: Any) -> "Node":
        """The value itself if it is recorded already, else a constant."""
        return value if isinstance(value, Node) else self.constant(value)


@dataclass(frozen=True, eq=False)
class Node:
    """A number that will be computed; arithmetic on it is recorded."""

    tape: Tape
    place: int

    def __add__(self, other: Any, /) -> "Node":
        return apply("add", self, other)

    __radd__ = __add__

    def __sub__(self, other: Any, /) -> "Node":
        return apply("sub", self, other)

    def __rsub__(self, other: Any, /) -> "Node":
        return apply("sub", self.tape.node(other), self)

    def __mul__(self, other: Any, /) -> "Node":
        return apply("mul", self, other)

    __rmul__ = __mul__

    def __truediv__(self, other: Any, /) -> "Node":
        # As a product with the inverse: inverses are shared, and hoisted out of loops.
        return self * apply("inverse", self.tape.node(other))

    def __rtruediv__(self, other: Any, /) -> "Node":
        return self.tape.node(other) / self

    def __neg__(self) -> "Node":
        return apply("neg", self)

    def __bool__(self) -> bool:
        raise TypeError("a recorded number has no value to branch on")

    @property
    def entry(self) -> Entry:
        """The recorded operation."""
        return self.tape.entries[self.place]


_FOLD: dict[str, Any] = {
    "add": lambda a, b: a + b,
    "sub": lambda a, b: a - b,
    "mul": lambda a, b: a * b,
    "inverse": lambda a: 1.0 / a if a else math.inf,
    "neg": lambda a: -a,
    "min": FLOAT.minimum,
    "max": FLOAT.maximum,
    "select": FLOAT.where_positive,
    "abs": math.fabs,
    **{n: getattr(math, n) for n in ("sin", "cos", "tan", "atan", "tanh", "exp", "sqrt")},
}


def apply(op: str, first: Node, *others: Any) -> Node:
    """Record an operation, or its result where that is plain: of constants; zeros, ones."""
    tape = first.tape
    nodes = (first, *(tape.node(other) for other in others))
    entries = [node.entry for node in nodes]
    if all(entry.op == "const" for entry in entries):
        return tape.constant(_FOLD[op](*(entry.value for entry in entries)))
    plain = _plain(op, nodes, entries)
    if plain is not None:
        return plain
    places = tuple(node.place for node in nodes)
    if op in ("add", "mul"):
        places = tuple(sorted(places))
    return Node(tape, tape.place(Entry(op, places)))


def is_number(entry: Entry, value: float) -> bool:
    """Whether it is this constant."""
    return entry.op == "const" and entry.value == value


def _plain(op: str, nodes: Sequence[Node], entries: Sequence[Entry]) -> Node | None:
    """The result of an operation that need not be computed, or None."""
    if op in ("add", "mul"):
        return _plain_commutative(op, nodes, entries)
    if op == "sub":
        if nodes[0].place == nodes[1].place:
            return nodes[0].tape.constant(0.0)
        if is_number(entries[0], 0.0):
            return -nodes[1]
        return nodes[0] if is_number(entries[1], 0.0) else None
    if op == "neg" and entries[0].op == "neg":
        return Node(nodes[0].tape, entries[0].args[0])
    if op == "select" and nodes[1].place == nodes[2].place:
        return nodes[1]
    return None


def _plain_commutative(op: str, nodes: Sequence[Node], entries: Sequence[Entry]) -> Node | None:
    neutral = 0.0 if op == "add" else 1.0
    for one, other in ((0, 1), (1, 0)):
        if is_number(entries[one], neutral):
            return nodes[other]
        if op == "mul" and is_number(entries[one], 0.0):
            return nodes[one]
        if op == "mul" and is_number(entries[one], -1.0):
            return -nodes[other]
    return None


def _recorded(op: str) -> Callable[..., Node]:
    def record(a: Node, /, *others: Node | float) -> Node:
        return apply(op, a, *others)

    return staticmethod(record)


class TapeOps:
    """`Ops` over recorded numbers."""

    sin, cos, tan, atan = map(_recorded, ("sin", "cos", "tan", "atan"))
    tanh, exp, sqrt, absolute = map(_recorded, ("tanh", "exp", "sqrt", "abs"))
    minimum, maximum, where_positive = map(_recorded, ("min", "max", "select"))

    def clip(self, a: Node, low: Node | float, high: Node | float, /) -> Node:
        """Record `a` kept within [low, high]."""
        return apply("min", apply("max", a, low), high)


TAPE: Ops[Node] = TapeOps()


def contributions(node: Node, bar: Node) -> tuple[Node | None, ...]:
    """What a node with derivative `bar` adds to the derivative of each of its arguments."""
    entry = node.entry
    a, *rest = (Node(node.tape, place) for place in entry.args)
    b = rest[0] if rest else a
    match entry.op:
        case "add":
            return bar, bar
        case "sub":
            return bar, -bar
        case "mul":
            return bar * b, bar * a
        case "min":
            return _chosen(b - a, bar)
        case "max":
            return _chosen(a - b, bar)
        case "select":
            return (None, *_chosen(a, bar))
    return (_through_function(node, a, bar),)


def _chosen(condition: Node, bar: Node) -> tuple[Node, Node]:
    zero = bar.tape.constant(0.0)
    return apply("select", condition, bar, zero), apply("select", condition, zero, bar)


def _through_function(node: Node, a: Node, bar: Node) -> Node:
    match node.entry.op:
        case "neg":
            return -bar
        case "inverse":
            return -(bar * (node * node))
        case "abs":
            return apply("select", a, bar, -bar)
        case "sin":
            return bar * apply("cos", a)
        case "cos":
            return -(bar * apply("sin", a))
        case "tan":
            return bar * (node * node + 1.0)
        case "atan":
            return bar / (a * a + 1.0)
        case "tanh":
            return bar * (1.0 - node * node)
        case "exp":
            return bar * node
        case "sqrt":
            return bar * (0.5 / node)
    raise ValueError(f"no derivative for {node.entry.op}")


def gradient(seeds: Iterable[tuple[Node, Node | float]], by: Sequence[Node]) -> list[Node]:
    """Sum of the outputs' derivatives, each weighted by its seed, with respect to `by`."""
    pairs = list(seeds)
    tape = by[0].tape
    bars: dict[int, Node] = {}
    for output, seed in pairs:
        weight = tape.node(seed)
        bars[output.place] = bars[output.place] + weight if output.place in bars else weight
    for place in range(max((output.place for output, _ in pairs), default=-1), -1, -1):
        bar = bars.get(place)
        if bar is None or not tape.entries[place].args:
            continue
        node = Node(tape, place)
        for argument, term in zip(node.entry.args, contributions(node, bar), strict=True):
            if term is None:
                continue
            bars[argument] = bars[argument] + term if argument in bars else term
    return [bars.get(node.place, tape.constant(0.0)) for node in by]


def jacobian(outputs: Iterable[Node], by: Sequence[Node]) -> list[list[Node]]:
    """Derivatives of each output (rows) with respect to each of `by` (columns)."""
    return [gradient([(output, 1.0)], by) for output in outputs]


def needed(targets: Iterable[Node]) -> list[int]:
    """Places that the targets depend on, in the order of computation."""
    seen: set[int] = set()
    stack = list(targets)
    tape = stack[0].tape if stack else Tape()
    todo = [node.place for node in stack]
    while todo:
        place = todo.pop()
        if place not in seen:
            seen.add(place)
            todo.extend(tape.entries[place].args)
    return sorted(seen)


def program(inputs: Sequence[Node], outputs: Sequence[Node]) -> Callable[..., tuple[float, ...]]:
    """The record as a function of the inputs' values, evaluated number by number.

    For tests and references; what must be fast is printed (`steerd.car_model.native`).
    """
    entries = outputs[0].tape.entries if outputs else []
    todo = [(place, entries[place]) for place in needed(outputs)]

    def run(*numbers: float) -> tuple[float, ...]:
        values = dict(zip((node.place for node in inputs), numbers, strict=True))
        for place, entry in todo:
            if entry.args:
                values[place] = _FOLD[entry.op](*(values[a] for a in entry.args))
            elif entry.op == "const":
                values[place] = entry.value
        return tuple(values[node.place] for node in outputs)

    return run
