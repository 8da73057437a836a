"""From recorded equations to Python source that Numba compiles.

Each piece is printed in four forms. `*_rows` has the loop over slots innermost, so that LLVM
vectorises the equations themselves; `*_vjp` is its vector-Jacobian product, and `*_jac` gives the
nonzero derivatives as well. `*_jvp` multiplies one slot's rows of sensitivities by the derivatives
by inputs; those by parameters are few numbers once multiplied by what is free, and are added one by
one (`*_BY` says which they are). What depends on parameters and step alone is computed once per
call, in `constants`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import inf
from typing import NamedTuple

from steerd.car_model.native.layout import row_layout
from steerd.car_model.native.specialised import SPECIALISED_SPEED, Range, specialise
from steerd.car_model.native.trace import CHASSIS, Piece, Traced
from steerd.car_model.tape import Entry, Node, gradient, needed, source_of
from steerd.sysid.compiler.simd_rows import SLOTS

SENSITIVITIES = 72
"""Most sensitivities of a number; a row is 9 cache lines, so that rows do not share cache sets."""


_SINGLE = ("delays", "observe")
"""Pieces whose derivatives are taken of one state at a time."""


class CodeBlock(NamedTuple):
    """A function to print: which inputs it reads from where, and what it writes where.

    `loops`: its body is a loop over the numbers of a row.
    """

    name: str
    arguments: str
    loads: tuple[tuple[Node, str], ...]
    targets: tuple[tuple[str, Node], ...]
    loops: bool


class Slope(NamedTuple):
    """A nonzero derivative: of output `output` by source `source` (inputs, then parameters)."""

    output: int
    source: int
    formula: Node


@dataclass
class _Constants:
    """Values that all blocks share: computed once per call, read from `q`."""

    slots: dict[int, int] = field(default_factory=dict)

    def slot(self, place: int) -> int:
        return self.slots.setdefault(place, len(self.slots))


def _slots(row: int) -> str:
    # One workspace with a constant stride: LLVM proves that rows never overlap, and vectorises.
    return f"w[{row * SLOTS} + i]" if row else "w[i]"


def _source(entry: Entry, names: Mapping[int, str]) -> str:
    # min and max keep Python's meaning for the loops that share the module.
    own = {"min": "least", "max": "greatest"}.get(entry.op, entry.op)
    return source_of(entry._replace(op=own), names)


def _number(row: int) -> str:
    return f"w[{row}]"


def _sensitivities(row: int) -> str:
    return f"w[{row * SENSITIVITIES} + i]" if row else "w[i]"


def slopes_of(piece: Piece, traced: Traced) -> list[Slope]:
    """The derivatives of a piece that are not zero everywhere; time has no sensitivity."""
    sources = (*piece.inputs, *traced.symbols)
    found = []
    for i, output in enumerate(piece.outputs):
        by = gradient([(output, 1.0)], sources)
        found += [
            Slope(i, j, e)
            for j, (source, e) in enumerate(zip(sources, by, strict=True))
            if not _zero(e) and source.place != traced.t.place
        ]
    return found


def jacobian_block(name: str, piece: Piece, slopes: Sequence[Slope], slots: bool) -> CodeBlock:
    """Outputs and nonzero derivatives; workspace rows: inputs, outputs, slopes.

    Args:
        name: of the function.
        piece: what it computes.
        slopes: its derivatives.
        slots: whether a row has SLOTS numbers, or is one number.
    """
    place = _slots if slots else _number
    values = (*piece.outputs, *(slope.formula for slope in slopes))
    loads = tuple((s, place(i)) for i, s in enumerate(piece.inputs))
    targets = tuple((place(len(loads) + i), e) for i, e in enumerate(values))
    return CodeBlock(name, "w, n, p, q, h" if slots else "w, p, q, h", loads, targets, slots)


def _print_jvp(name: str, piece: Piece, slopes: Sequence[Slope], stride: int) -> list[str]:
    """Jacobian-vector products by the inputs; rows: inputs, outputs (set).

    Slope k is `j[at + stride k]`.
    """
    split = len(piece.inputs)
    used = [(k, s) for k, s in enumerate(slopes) if s.source < split]
    head = [f"j{k} = j[unsigned(at + {stride * k})]" for k, _ in used]
    body = []
    for i in range(len(piece.outputs)):
        terms = [f"j{k} * {_sensitivities(s.source)}" for k, s in used if s.output == i]
        body.append(f"{_sensitivities(split + i)} = {' + '.join(terms) or '0.0'}")
    return _assemble(CodeBlock(name, "j, at, w, n", (), (), loops=True), head, body)


def _print_by(name: str, piece: Piece, slopes: Sequence[Slope]) -> list[str]:
    """The derivatives by parameters: number of the slope, output, parameter."""
    split = len(piece.inputs)
    rows = [(k, s.output, s.source - split) for k, s in enumerate(slopes) if s.source >= split]
    return [f"{name}_BY = np.array({rows!r}, dtype=np.int64).reshape(-1, 3)", ""]


def _zero(node: Node) -> bool:
    return node.entry.op == "const" and node.entry.value == 0.0


def rows_block(name: str, piece: Piece) -> CodeBlock:
    """Workspace rows: inputs, then outputs."""
    loads = tuple((s, _slots(i)) for i, s in enumerate(piece.inputs))
    targets = tuple((_slots(len(loads) + i), e) for i, e in enumerate(piece.outputs))
    return CodeBlock(name, "w, n, p, q, h", loads, targets, loops=True)


def vjp_block(name: str, piece: Piece, traced: Traced) -> CodeBlock:
    """Vector-Jacobian product; rows: inputs, output weights, input slopes (set), parameter slopes.

    Parameter slopes are added to; rows of parameters that the piece does not depend on stay.
    """
    tape = traced.tape
    bars = [tape.symbol(f"bar_{i}") for i in range(len(piece.outputs))]
    sources = (*piece.inputs, *bars)
    loads = tuple((s, _slots(i)) for i, s in enumerate(sources))
    slopes = gradient(zip(piece.outputs, bars, strict=True), (*piece.inputs, *traced.symbols))
    split, first = len(piece.inputs), len(sources)
    targets = [(_slots(first + j), e) for j, e in enumerate(slopes[:split])]
    for k, e in enumerate(slopes[split:]):
        if not _zero(e):
            targets.append((f"{_slots(first + split + k)} +", e))
    return CodeBlock(name, "w, n, p, q, h", loads, tuple(targets), loops=True)


def _constant_places(traced: Traced, places: Sequence[int]) -> set[int]:
    """Which of the places depend on parameters and step alone (and are more than a number)."""
    fixed = {node.place for node in (*traced.symbols, traced.h)}
    entries = traced.tape.entries
    known = set(fixed)
    for place in places:
        entry = entries[place]
        if entry.op == "const" or (entry.args and all(a in known for a in entry.args)):
            known.add(place)
    return {p for p in known - fixed if entries[p].op != "const"}


def _print_block(block: CodeBlock, traced: Traced, constants: _Constants) -> list[str]:
    entries = traced.tape.entries
    places = needed(node for _, node in block.targets)
    hoisted = _constant_places(traced, places)
    names = {p: repr(entries[p].value) for p in places if entries[p].op == "const"}
    names |= {p: f"v{p}" for p in places if p not in names}
    names |= {node.place: "h" for node in (traced.h,)}
    body_places = [p for p in places if p not in hoisted and entries[p].args]
    used = {a for p in body_places for a in entries[p].args} | {n.place for _, n in block.targets}
    head = [f"v{s.place} = p[{k}]" for k, s in enumerate(traced.symbols) if s.place in used]
    head += [f"v{p} = q[{constants.slot(p)}]" for p in sorted(hoisted & used)]
    body = [f"v{s.place} = {text}" for s, text in block.loads if s.place in used]
    body += [f"v{p} = {_source(entries[p], names)}" for p in body_places]
    body += [
        f"{target}= {names[node.place]}"
        if target.endswith("+")
        else f"{target} = {names[node.place]}"
        for target, node in block.targets
    ]
    return _assemble(block, head, body)


def _assemble(block: CodeBlock, head: list[str], body: list[str]) -> list[str]:
    lines = ["@inlined", f"def {block.name}({block.arguments}):"]
    lines += [f"    {line}" for line in head]
    indent = "    "
    if block.loops:
        lines.append("    for i in range(n):")
        indent = "        "
    body = body or ["pass"]
    return [*lines, *(indent + line for line in body), "", ""]


def _print_constants(traced: Traced, constants: _Constants) -> list[str]:
    entries = traced.tape.entries
    places = needed(Node(traced.tape, place) for place in constants.slots)
    names = {p: f"v{p}" if entries[p].op != "const" else repr(entries[p].value) for p in places}
    names[traced.h.place] = "h"
    lines = [f"v{s.place} = p[{k}]" for k, s in enumerate(traced.symbols) if s.place in places]
    lines += [f"v{p} = {_source(entries[p], names)}" for p in places if entries[p].args]
    lines += [f"q[{slot}] = v{place}" for place, slot in constants.slots.items()]
    lines = lines or ["pass"]
    return ["@entry_point", "def constants(p, h, q):", *(f"    {line}" for line in lines), "", ""]


def specialised_rates(traced: Traced) -> Piece:
    """The rates above walking pace: without the kinematic equations."""
    rates = traced.rates
    speed = rates.inputs[CHASSIS.index("speed")]
    return Piece(
        rates.inputs, specialise(rates.outputs, {speed.place: Range(SPECIALISED_SPEED, inf)})
    )


def _pieces(traced: Traced) -> dict[str, Piece]:
    return {
        "actuators": traced.actuators,
        "rates": traced.rates,
        "specialised": specialised_rates(traced),
        "remember": traced.remember,
        "observe": traced.observe,
    }


def _print_slopes(name: str, piece: Piece, traced: Traced, constants: _Constants) -> list[str]:
    """A piece with its derivatives: one state's for what is done now and then, else all slots'."""
    slopes, slots = slopes_of(piece, traced), name not in _SINGLE
    return [
        *_print_block(jacobian_block(f"{name}_jac", piece, slopes, slots), traced, constants),
        *_print_jvp(f"{name}_jvp", piece, slopes, SLOTS if slots else 1),
        *_print_by(name.upper(), piece, slopes),
        f"{name.upper()}_SLOPES = np.int64({len(slopes)})",
        "",
        "",
    ]


def _print_pieces(traced: Traced, constants: _Constants) -> list[str]:
    printed: list[str] = []
    for name, piece in {"delays": Piece((), traced.delays), **_pieces(traced)}.items():
        printed += _print_slopes(name, piece, traced, constants)
    for name, piece in _pieces(traced).items():
        for block in (
            rows_block(f"{name}_rows", piece),
            vjp_block(f"{name}_vjp", piece, traced),
        ):
            printed += _print_block(block, traced, constants)
    return printed


def generate(traced: Traced) -> str:
    """Source of a module with all pieces of one model in every form."""
    constants = _Constants()
    printed = _print_pieces(traced, constants)
    header = [
        '"""Printed by steerd.sysid.compiler.codegen from the equations of car_model."""',
        "",
        "import numpy as np",
        "",
        "from steerd.sysid.compiler.choice import greatest, least, select",
        "from steerd.sysid.compiler.compile import entry_point, inlined",
        "from steerd.sysid.compiler.simd_math import abs, atan, cos, exp, sin, sqrt, tan, tanh",
        "",
        f"PARAMETERS = {traced.parameters!r}",
        f"REMEMBERS = {traced.remembers}",
        f"CONSTANTS = {len(constants.slots)}",
        f"SLOTS = {SLOTS}",
        f"SENSITIVITIES = {SENSITIVITIES}",
        f"SPECIALISED_SPEED = {SPECIALISED_SPEED}",
        *(f"{name} = np.int64({row})" for name, row in row_layout(traced).items()),
        "",
        "",
    ]
    return "\n".join([*header, *_print_constants(traced, constants), *printed])
