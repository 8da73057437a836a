"""Recorded equations as straight-line Python over floats, to print or to run; or printed as C.

Only what the results need is written, each operation once; what is used once is written where it
is used, which spares the interpreter a variable. Choices become conditional expressions with the
meaning of `steerd.car_model.ops.FloatOps`, so only the chosen side of them is computed where it can
be.
"""

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, cast

from steerd.car_model.tape import Entry, Node, needed

FUNCTIONS = ("atan", "cos", "exp", "fabs", "sin", "sqrt", "tan", "tanh")
"""Of `math`, which the text may call."""
_FORMS = {
    "add": "{0} + {1}",
    "sub": "{0} - {1}",
    "mul": "{0} * {1}",
    "div": "{0} / {1}",
    "neg": "-{0}",
    "inverse": "1.0 / {0}",
    "abs": "fabs({0})",
    "min": "{0} if {0} < {1} else {1}",
    "max": "{0} if {0} > {1} else {1}",
    "select": "{1} if {0} > 0.0 else {2}",
    **{name: name + "({0})" for name in FUNCTIONS},
}
C_FORMS = _FORMS | {
    "min": "{0} < {1} ? {0} : {1}",
    "max": "{0} > {1} ? {0} : {1}",
    "select": "{0} > 0.0 ? {1} : {2}",
}
"""The same operations in C, for `written`."""
_DEEPEST = 12
"""Levels of parentheses: for readers, and the compiler has a limit of its own."""


class Text(NamedTuple):
    """A program: statements in order, then an expression for each result."""

    statements: list[str]
    results: list[str]


def written(outputs: Sequence[Node], forms: Mapping[str, str] = _FORMS) -> Text:
    """The program for some outputs; inputs keep their names, others are called `v<number>`."""
    places = needed(outputs)
    entries = outputs[0].tape.entries if outputs else []
    uses = Counter(node.place for node in outputs)
    for place in places:
        entry = entries[place]
        for at, argument in enumerate(entry.args):
            uses[argument] += forms[entry.op].count(f"{{{at}}}")
    statements: list[str] = []
    texts: dict[int, tuple[str, int]] = {}
    for place in places:
        text, depth = _expression(entries[place], texts, forms)
        if depth and (uses[place] > 1 or depth > _DEEPEST):
            name = f"v{place}"
            statements.append(f"{name} = {text}")
            text, depth = name, 0
        texts[place] = (f"({text})" if depth else text), depth
    return Text(statements, [texts[node.place][0] for node in outputs])


def _expression(
    entry: Entry, texts: dict[int, tuple[str, int]], forms: Mapping[str, str]
) -> tuple[str, int]:
    """An operation with its operands written in, and how deeply it nests."""
    if not entry.args:
        return (f"({entry.name})" if entry.name.startswith("-") else entry.name), 0
    inner = [texts[argument] for argument in entry.args]
    return forms[entry.op].format(*(text for text, _ in inner)), 1 + max(d for _, d in inner)


def compiled(inputs: Sequence[Node], outputs: Sequence[Node]) -> Callable[..., tuple[float, ...]]:
    """The program as a function of the inputs' values, in order; it gives the outputs' values."""
    text = written(outputs)
    body = "\n    ".join([*text.statements, f"return ({''.join(f'{r}, ' for r in text.results)})"])
    names = ", ".join(node.entry.name for node in inputs)
    scope: dict[str, Any] = {name: getattr(math, name) for name in (*FUNCTIONS, "inf", "nan")}
    exec(compile(f"def program({names}):\n    {body}\n", "<straight line>", "exec"), scope)
    return cast("Callable[..., tuple[float, ...]]", scope["program"])
