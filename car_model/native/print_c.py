"""From recorded equations to C with vectors of eight windows: values, derivatives, products.

Each piece of a model is printed three times: `name` computes its outputs for eight windows side by
side, `name_jac` their derivatives as well, `name_push` multiplies one direction of eight windows by
the derivatives by inputs, `name_pull` is its transpose. Derivatives by a parameter are
computed where some direction moves the parameter (`moved`). What depends on parameters and step
alone is computed once per call, in `constants`. `march.h` has the loops around the pieces.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from math import inf
from typing import NamedTuple

from steerd.car_model import prediction
from steerd.car_model.chassis import Chassis
from steerd.car_model.native.specialised import SPECIALISED_SPEED, Range, specialise
from steerd.car_model.native.trace import CHASSIS, Piece, Traced
from steerd.car_model.params import Car
from steerd.car_model.state import State
from steerd.car_model.tape import Entry, Node, Tape, gradient, is_number, needed

ALWAYS = -1
"""Stands for a parameter that is always moved: what outputs and derivatives by inputs need."""
ROWS = "const vec *restrict in, vec *restrict out"
NUMBERS = "const double *restrict p, const double *restrict q, double h"
"""Arguments of the printed functions: rows of windows, then what is the same for all."""
_INFIX = {"add": "+", "sub": "-", "mul": "*"}


class Slope(NamedTuple):
    """A derivative that is not zero everywhere: of an output by a source.

    Sources are inputs, then parameters; a formula for each form of the piece.
    """

    output: int
    source: int
    formulas: tuple[Node, ...]


@dataclass
class Printer:
    """Prints pieces of one record."""

    tape: Tape  # the record
    symbols: tuple[Node, ...]  # the parameters
    h: Node  # the step
    prefix: str  # of every name
    timeless: frozenset[int] = frozenset()  # inputs by which no derivative is taken
    lines: list[str] = field(default_factory=list)  # what is printed
    hoisted: dict[int, int] = field(default_factory=dict)  # places among the constants

    def __post_init__(self) -> None:
        self.entries: list[Entry] = self.tape.entries
        self.fixed = {node.place for node in (*self.symbols, self.h)}

    # -- what is a number, what a row ----------------------------------------------------------

    def numbers(self, places: Iterable[int]) -> set[int]:
        """Places that depend on parameters and step alone."""
        known = set(self.fixed)
        for place in places:
            entry = self.entries[place]
            if entry.op == "const" or (entry.args and all(a in known for a in entry.args)):
                known.add(place)
        return known

    def operation(self, place: int, row: bool, numbers: set[int]) -> str:
        """C of one operation, on rows or on numbers."""
        entry = self.entries[place]
        args = [f"v{a}" for a in entry.args]
        match entry.op:
            case "add" | "sub" | "mul":
                return f"{args[0]} {_INFIX[entry.op]} {args[1]}"
            case "neg":
                return f"-{args[0]}"
            case "inverse":
                return f"1.0 / {args[0]}"
        wide = [
            f"all({text})" if a in numbers else text
            for text, a in zip(args, entry.args, strict=True)
        ]
        called = f"{entry.op}8({', '.join(wide)})"
        return called if row else f"{called}[0]"

    def slot(self, place: int) -> int:
        """The place among the constants of what is computed once per call."""
        return self.hoisted.setdefault(place, len(self.hoisted))

    # -- functions -------------------------------------------------------------------------------

    def block(
        self, head: str, inputs: Sequence[Node], targets: Sequence[tuple[str, Node, int]]
    ) -> None:
        """A function that computes targets: (place to write, formula, parameter it is by)."""
        need: dict[int, set[int]] = {}
        for _, node, by in targets:
            for place in needed([node]):
                need.setdefault(place, set()).add(by)
        places = sorted(need)
        numbers = self.numbers(places)
        rows = [p for p in places if p not in numbers and self.entries[p].args]
        used = {a for p in rows for a in self.entries[p].args} | {n.place for _, n, _ in targets}
        self.lines.append(f"static void {self.prefix}_{head} {{")
        self._declare(sorted(used & numbers), lambda place: f"q[{self.slot(place)}]")
        for k, node in enumerate(inputs):
            if node.place in used:
                self.lines.append(f"    const vec v{node.place} = in[{k}];")
        self._grouped(rows, need, numbers, targets)
        self.lines += ["}", ""]

    def _declare(self, places: Iterable[int], computed: Callable[[int], str]) -> None:
        """Numbers at these places: parameters, the step, constants, and what is computed."""
        given = {symbol.place: f"p[{k}]" for k, symbol in enumerate(self.symbols)}
        given[self.h.place] = "h"
        for place in places:
            entry = self.entries[place]
            text = repr(entry.value) if entry.op == "const" else given.get(place)
            self.lines.append(f"    const double v{place} = {text or computed(place)};")

    def _grouped(
        self,
        rows: Sequence[int],
        need: dict[int, set[int]],
        numbers: set[int],
        targets: Sequence[tuple[str, Node, int]],
    ) -> None:
        """Operations that all need, then those that only some parameters' derivatives do."""
        groups: dict[frozenset[int], list[int]] = {}
        for place in rows:
            whose = {ALWAYS} if ALWAYS in need[place] else need[place]
            groups.setdefault(frozenset(whose), []).append(place)
        for _, _, by in targets:
            groups.setdefault(frozenset({by}), [])
        always = frozenset({ALWAYS})
        shared = [p for by, own in groups.items() if len(by) > 1 for p in own]
        for place in groups.pop(always, []):
            self.lines.append(f"    const vec v{place} = {self.operation(place, True, numbers)};")
        self._write(targets, ALWAYS, numbers, "    ")
        for at in range(0, len(shared), 8):
            self.lines.append(f"    vec {', '.join(f'v{p}' for p in shared[at : at + 8])};")
        for group in sorted(groups, key=lambda group: (-len(group), sorted(group))):
            asked = " | ".join(f"moved[{k}]" for k in sorted(group))
            self.lines.append(f"    if ({asked}) {{")
            kind = "" if len(group) > 1 else "const vec "
            for place in groups[group]:
                text = self.operation(place, True, numbers)
                self.lines.append(f"        {kind}v{place} = {text};")
            if len(group) == 1:
                self._write(targets, min(group), numbers, "        ")
            self.lines.append("    }")

    def _write(
        self, targets: Sequence[tuple[str, Node, int]], by: int, numbers: set[int], indent: str
    ) -> None:
        for to, node, whose in targets:
            if whose == by:
                text = f"v{node.place}"
                self.lines.append(
                    f"{indent}{to} = {f'all({text})' if node.place in numbers else text};"
                )

    def values(self, form: str, piece: Piece) -> list[tuple[str, Node, int]]:
        """A function that computes a piece's outputs; what it writes."""
        out = [(f"out[{i}]", node, ALWAYS) for i, node in enumerate(piece.outputs)]
        self.block(f"{form}({ROWS}, {NUMBERS})", piece.inputs, out)
        return out

    def piece(self, name: str, forms: dict[str, Piece]) -> None:
        """A piece in all its forms, which share one table of derivatives."""
        first = next(iter(forms.values()))
        slopes = self.slopes(tuple(forms.values()))
        split = len(first.inputs)
        for at, (form, piece) in enumerate(forms.items()):
            out = self.values(form, piece)
            by = [
                (f"j[{k}]", s.formulas[at], ALWAYS if s.source < split else s.source - split)
                for k, s in enumerate(slopes)
            ]
            rows = f"{ROWS}, vec *restrict j, const uint8_t *restrict moved"
            self.block(f"{form}_jac({rows}, {NUMBERS})", piece.inputs, [*out, *by])
        self._products(name, len(first.outputs), split, slopes)

    def slopes(self, forms: Sequence[Piece]) -> list[Slope]:
        """The derivatives of a piece; time has no sensitivity."""
        first = forms[0]
        sources = (*first.inputs, *self.symbols)
        found = []
        for i in range(len(first.outputs)):
            by = [gradient([(form.outputs[i], 1.0)], sources) for form in forms]
            for k, formulas in enumerate(zip(*by, strict=True)):
                moves = not all(is_number(node.entry, 0.0) for node in formulas)
                if moves and sources[k].place not in self.timeless:
                    found.append(Slope(i, k, formulas))
        return sorted(found, key=lambda s: s.source >= len(first.inputs))

    def _products(self, name: str, outputs: int, split: int, slopes: Sequence[Slope]) -> None:
        """Jacobian-vector product, its transpose, and the table of derivatives by parameters."""
        where = {(s.output, s.source): k for k, s in enumerate(slopes)}
        sources = sorted({s.source for s in slopes})
        head = "const vec *restrict j, const vec *restrict in, vec *restrict out"
        self.lines.append(f"INLINE void {self.prefix}_{name}_push({head}) {{")
        for i in range(outputs):
            inner = [k for k in sources if k < split and (i, k) in where]
            self._sum(f"out[{i}]", [f"j[{where[i, k]}] * in[{k}]" for k in inner])
        head = f"{head}, vec *restrict by"
        self.lines += ["}", f"INLINE void {self.prefix}_{name}_pull({head}) {{"]
        for k in sources:
            terms = [f"j[{where[i, k]}] * in[{i}]" for i in range(outputs) if (i, k) in where]
            self._sum(f"out[{k}]" if k < split else f"by[{k - split}]", terms)
        outer = [(k, s) for k, s in enumerate(slopes) if s.source >= split]
        table = ", ".join(f"{{{k}, {s.output}, {s.source - split}}}" for k, s in outer)
        upper = f"{self.prefix}_{name}_by"
        self.lines += [
            "}",
            f"static const by_t {upper}[] = {{{table or '{0, 0, 0}'}}};",
            f"enum {{ {self.prefix}_{name}_BY = {len(outer)}, "
            f"{self.prefix}_{name}_SLOPES = {len(slopes)} }};",
            "",
        ]

    def _sum(self, to: str, terms: Sequence[str]) -> None:
        """Add terms to a row."""
        if terms:
            self.lines.append(f"    {to} += {' + '.join(terms)};")

    def constants(self) -> None:
        """What depends on parameters and step alone."""
        places = needed(Node(self.tape, place) for place in self.hoisted)
        self.lines.append(
            f"static void {self.prefix}_constants(const double *p, double h, double *q) {{"
        )
        numbers = set(places)
        self._declare(places, lambda place: self.operation(place, False, numbers))
        self.lines += [f"    q[{slot}] = v{place};" for place, slot in self.hoisted.items()]
        self.lines += ["}", f"enum {{ {self.prefix}_CONSTANTS = {len(self.hoisted)} }};", ""]


def row_layout(traced: Traced) -> dict[str, int]:
    """Where the inputs and outputs of each piece stand in its workspace: row numbers by name.

    A workspace holds its inputs in the order in which `trace` lists them, then its outputs. The
    names are printed into every compiled module, so that no loop counts states itself.

    Actuators: state, memory, commands (newer, older, share of the older), time -> wheel at start
    and end, steer, accel, memory.
    Rates: chassis, wheel, accel, memory, time -> rates of the chassis.
    Remember: state before, state after, memory, time -> memory.
    Observe: state -> readings.
    """
    states, chassis, memory = len(State._fields), len(traced.rates.outputs), traced.memory
    return {
        "FIRST": 0,
        "ONE": 1,
        "STATES": states,
        "CHASSIS": chassis,
        "STEER": State._fields.index("steer"),
        "SPEED": State._fields.index("speed"),
        "YAW_RATE": State._fields.index("yaw_rate"),
        "MEMORY": memory,
        "ACTUATORS_COMMAND": states + memory,
        "ACTUATORS_OLDER": states + memory + 2,
        "ACTUATORS_SHARE": states + memory + 4,
        "ACTUATORS_TIME": states + memory + 6,
        "ACTUATORS_INPUTS": len(traced.actuators.inputs),
        "ACTUATORS_OUTPUTS": len(traced.actuators.outputs),
        "WHEEL_START": 0,
        "WHEEL_END": 1,
        "STEER_END": 2,
        "ACCEL": 3,
        "MEMORY_END": 4,
        "RATES_WHEEL": chassis,
        "RATES_ACCEL": chassis + 1,
        "RATES_TIME": chassis + 2 + memory,
        "RATES_INPUTS": len(traced.rates.inputs),
        "REMEMBER_AFTER": states,
        "REMEMBER_MEMORY": 2 * states,
        "REMEMBER_TIME": 2 * states + memory,
        "REMEMBER_INPUTS": len(traced.remember.inputs),
        "READINGS": len(traced.observe.outputs),
        "PARAMETER_COUNT": len(traced.parameters),
    }


def print_filter(chassis: Chassis) -> str:
    """The C text of a filter's programs for a chassis (`car_model.prediction`)."""
    tape = Tape()
    car: Car[Node] = Car(*map(tape.symbol, Car._fields))
    printer = Printer(tape, tuple(car), tape.symbol("no step"), "filter")
    programs = {
        "piece": prediction.recorded_piece(tape, car),
        "propagate": prediction.recorded_step(tape, car, chassis),
        "tangent": prediction.recorded_tangent(tape, car, chassis),
    }
    for name, (inputs, outputs) in programs.items():
        printer.values(name, Piece(tuple(inputs), tuple(outputs)))
    printer.constants()
    sizes = {"GIVEN": len(prediction.GIVEN), "SO_FAR": len(prediction.SO_FAR)}
    named = ("LONGEST_STEP_NS", "MOST_STEPS", "STEEPEST")
    sizes |= {name: getattr(prediction, name) for name in named}
    listed = ", ".join(f"{name} = {size}" for name, size in sizes.items())
    return "\n".join([f"enum {{ {listed} }};", *printer.lines])


def fast_rates(traced: Traced) -> Piece:
    """The rates above walking pace: without the kinematic equations."""
    rates = traced.rates
    speed = rates.inputs[CHASSIS.index("speed")]
    return Piece(
        rates.inputs, specialise(rates.outputs, {speed.place: Range(SPECIALISED_SPEED, inf)})
    )


def print_model(traced: Traced, prefix: str) -> str:
    """The C text of a model's pieces; every name begins with `prefix`."""
    timeless = frozenset({traced.t.place})
    printer = Printer(traced.tape, traced.symbols, traced.h, prefix, timeless)
    printer.piece("delays", {"delays": Piece((), traced.delays)})
    printer.piece("actuators", {"actuators": traced.actuators})
    printer.values("linkage", traced.linkage)
    printer.piece("rates", {"rates": traced.rates, "fast": fast_rates(traced)})
    printer.piece("remember", {"remember": traced.remember})
    printer.piece("observe", {"observe": traced.observe})
    printer.constants()
    layout = {**row_layout(traced), "REMEMBERS": int(traced.remembers)}
    sizes = ", ".join(f"{prefix}_{name} = {row}" for name, row in layout.items())
    head = [f"#define FAST_SPEED {SPECIALISED_SPEED}", f"enum {{ {sizes} }};"]
    return "\n".join([*head, *printer.lines])
