"""From recorded equations to Python source that Numba compiles.

Two forms of each piece are printed. The *point* form works on one state and fills Jacobians; its
callers vectorise over sensitivity columns. The *lane* form has the loop over windows innermost, so
that LLVM vectorises the equations themselves; it comes with its vector-Jacobian product. Whatever
depends on parameters and step alone is computed once per call, in `constants`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from car_model.tape import Node, gradient, needed, source_of
from sysid.trace import Piece, Traced

LANES = 16
"""Windows that one call of a lane piece works on."""


class Block(NamedTuple):
    """A function to print: which inputs it reads from where, and what it writes where."""

    name: str
    arguments: str
    loads: tuple[tuple[Node, str], ...]
    targets: tuple[tuple[str, Node], ...]
    lanes: bool


@dataclass
class _Constants:
    """Values that all blocks share: computed once per call, read from `q`."""

    slots: dict[int, int] = field(default_factory=dict)

    def slot(self, place: int) -> int:
        return self.slots.setdefault(place, len(self.slots))


def _row(row: int) -> str:
    # One workspace with a constant stride: LLVM sees that rows never overlap, and vectorises.
    return f"w[{row * LANES} + lane]" if row else "w[lane]"


def value_block(name: str, piece: Piece) -> Block:
    """Outputs at one point: `out[i]`."""
    loads = tuple((s, f"z[{i}]") for i, s in enumerate(piece.inputs))
    targets = tuple((f"out[{i}]", e) for i, e in enumerate(piece.outputs))
    return Block(name, "z, p, q, h, out", loads, targets, lanes=False)


def jacobian_block(name: str, piece: Piece, traced: Traced) -> Block:
    """Outputs and Jacobians at one point: `out[i]`, `jz[i, j]`, `jp[i, k]`; zeros are not written."""
    loads = tuple((s, f"z[{i}]") for i, s in enumerate(piece.inputs))
    targets = [(f"out[{i}]", e) for i, e in enumerate(piece.outputs)]
    split = len(piece.inputs)
    for i, output in enumerate(piece.outputs):
        slopes = gradient([(output, 1.0)], (*piece.inputs, *traced.symbols))
        targets += [(f"jz[{i}, {j}]", e) for j, e in enumerate(slopes[:split]) if not _zero(e)]
        targets += [(f"jp[{i}, {k}]", e) for k, e in enumerate(slopes[split:]) if not _zero(e)]
    return Block(name, "z, p, q, h, out, jz, jp", loads, tuple(targets), lanes=False)


def _zero(node: Node) -> bool:
    return node.entry.op == "const" and node.entry.value == 0.0


def lane_block(name: str, piece: Piece) -> Block:
    """Workspace rows: inputs, then outputs."""
    loads = tuple((s, _row(i)) for i, s in enumerate(piece.inputs))
    targets = tuple((_row(len(loads) + i), e) for i, e in enumerate(piece.outputs))
    return Block(name, "w, n, p, q, h", loads, targets, lanes=True)


def lane_vjp_block(name: str, piece: Piece, traced: Traced) -> Block:
    """Vector-Jacobian product; rows: inputs, output weights, input slopes (set), parameter slopes.

    Parameter slopes are added to; rows of parameters that the piece does not depend on stay.
    """
    tape = traced.tape
    bars = [tape.symbol(f"bar_{i}") for i in range(len(piece.outputs))]
    sources = (*piece.inputs, *bars)
    loads = tuple((s, _row(i)) for i, s in enumerate(sources))
    slopes = gradient(zip(piece.outputs, bars, strict=True), (*piece.inputs, *traced.symbols))
    split, first = len(piece.inputs), len(sources)
    targets = [(_row(first + j), e) for j, e in enumerate(slopes[:split])]
    for k, e in enumerate(slopes[split:]):
        if not _zero(e):
            targets.append((f"{_row(first + split + k)} +", e))
    return Block(name, "w, n, p, q, h", loads, tuple(targets), lanes=True)


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


def _print_block(block: Block, traced: Traced, constants: _Constants) -> list[str]:
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
    body += [f"v{p} = {source_of(entries[p], names)}" for p in body_places]
    body += [
        f"{target}= {names[node.place]}"
        if target.endswith("+")
        else f"{target} = {names[node.place]}"
        for target, node in block.targets
    ]
    return _assemble(block, head, body)


def _assemble(block: Block, head: list[str], body: list[str]) -> list[str]:
    lines = [f"@{'lanes' if block.lanes else 'point'}", f"def {block.name}({block.arguments}):"]
    lines += [f"    {line}" for line in head]
    indent = "    "
    if block.lanes:
        lines.append("    for lane in range(n):")
        indent = "        "
    return [*lines, *(indent + line for line in body), "", ""]


def _print_constants(traced: Traced, constants: _Constants) -> list[str]:
    entries = traced.tape.entries
    places = needed(Node(traced.tape, place) for place in constants.slots)
    names = {p: f"v{p}" if entries[p].op != "const" else repr(entries[p].value) for p in places}
    names[traced.h.place] = "h"
    lines = [f"v{s.place} = p[{k}]" for k, s in enumerate(traced.symbols) if s.place in places]
    lines += [f"v{p} = {source_of(entries[p], names)}" for p in places if entries[p].args]
    lines += [f"q[{slot}] = v{place}" for place, slot in constants.slots.items()]
    return ["@point", "def constants(p, h, q):", *(f"    {line}" for line in lines), "", ""]


def _blocks(traced: Traced) -> list[Block]:
    blocks = [jacobian_block("delays_jac", Piece((), traced.delays), traced)]
    pieces = [("actuators", traced.actuators), ("rates", traced.rates), ("observe", traced.observe)]
    if traced.remember is not None:
        pieces.append(("remember", traced.remember))
    for name, piece in pieces:
        blocks += [
            value_block(name, piece),
            jacobian_block(f"{name}_jac", piece, traced),
            lane_block(f"{name}_lanes", piece),
            lane_vjp_block(f"{name}_vjp", piece, traced),
        ]
    return blocks


def generate(traced: Traced) -> str:
    """Source of a module with all pieces of one model in every form."""
    constants = _Constants()
    printed = [line for block in _blocks(traced) for line in _print_block(block, traced, constants)]
    header = [
        '"""Printed by sysid.codegen from the equations of car_model."""',
        "",
        "from sysid.choice import greatest as max, least as min, select",
        "from sysid.compile import lanes, point",
        "from sysid.lane_math import abs, atan, cos, exp, sin, sqrt, tan, tanh",
        "",
        f"PARAMETERS = {traced.parameters!r}",
        f"MEMORY = {traced.memory}",
        f"CONSTANTS = {len(constants.slots)}",
        "",
        "",
    ]
    return "\n".join([*header, *_print_constants(traced, constants), *printed])
