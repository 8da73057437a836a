"""Random formulas: the recorded program gives the floats, its derivatives the differences."""

import operator
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from steerd.car_model.ops import FLOAT, Ops
from steerd.car_model.tape import TAPE, Tape, gradient, program

repeatable = settings(derandomize=True, deadline=None, max_examples=150)

UNARY = ("sin", "cos", "atan", "tanh", "absolute", "neg", "exp", "sqrt", "tan")
BINARY = ("add", "sub", "mul", "truediv", "minimum", "maximum")


class Formula(NamedTuple):
    """An operation on formulas; a leaf is an input's number or a constant."""

    op: str
    parts: tuple[Any, ...]


def evaluated(ops: Ops[Any], formula: Any, inputs: Sequence[Any]) -> Any:
    """The formula over one number type, kept where every function is smooth and tame."""
    if isinstance(formula, int):
        return inputs[formula]
    if isinstance(formula, float):
        return inputs[0] * 0.0 + formula
    args = [evaluated(ops, part, inputs) for part in formula.parts]
    match formula.op:
        case "neg":
            return -args[0]
        case "add" | "sub" | "mul":
            return getattr(operator, formula.op)(*args)
        case "truediv":
            return args[0] / (1.0 + args[1] * args[1])
        case "sqrt":
            return ops.sqrt(1.0 + args[0] * args[0])
        case "exp" | "tan":
            return getattr(ops, formula.op)(ops.atan(args[0]) * 0.5)
        case "clip":
            return ops.clip(args[0], -0.5, 0.75)
    return getattr(ops, formula.op)(*args)


def grown(parts: st.SearchStrategy[Any]) -> st.SearchStrategy[Any]:
    def made(op: str, count: int) -> st.SearchStrategy[Formula]:
        return st.tuples(*(parts,) * count).map(lambda chosen: Formula(op, chosen))

    return st.one_of(
        st.sampled_from((*UNARY, "clip")).flatmap(lambda op: made(op, 1)),
        st.sampled_from(BINARY).flatmap(lambda op: made(op, 2)),
        made("where_positive", 3),
    )


constants = st.sampled_from([0.0, -0.0, 1.0, -1.0, 0.3, -2.5])
formulas = st.recursive(st.integers(0, 2) | constants, grown, max_leaves=12)
plain = st.floats(-3.0, 3.0, allow_subnormal=False)
WIDTH = 1e-5
points = st.tuples(plain, plain, plain)


def recorded(formula: Any, *, slopes: bool = False) -> Callable[..., tuple[float, ...]]:
    tape = Tape()
    inputs = [tape.symbol(name) for name in "abc"]
    output = tape.node(evaluated(TAPE, formula, inputs))
    return program(inputs, gradient([(output, 1.0)], inputs) if slopes else [output])


@repeatable
@given(formulas, points)
def test_a_record_gives_the_same_values(formula, point):
    expected = evaluated(FLOAT, formula, point)
    near = [evaluated(FLOAT, formula, [v + d for v in point]) for d in (1e-9, -1e-9)]
    size = max(map(abs, (expected, *near)))
    assume(size < 1e6)
    assume(all(abs(n - expected) < 1e-6 * (1.0 + size) for n in near))  # a jump of where_positive
    (found,) = recorded(formula)(*point)
    assert found == pytest.approx(expected, rel=1e-9, abs=1e-9)


@repeatable
@given(formulas, points)
def test_gradients_are_those_of_central_differences(formula, point):
    slopes = recorded(formula, slopes=True)
    found = slopes(*point)
    for i in range(3):
        ends = [[v + s * (k == i) for k, v in enumerate(point)] for s in (WIDTH, -WIDTH)]
        wide, narrow = (difference(formula, point, i, width) for width in (WIDTH, WIDTH / 2.0))
        size = 1.0 + max(abs(v) for v in (*found, wide))
        assume(size < 1e4)
        # No seam near: there differences and slopes barely change from place to place.
        assume(abs(wide - narrow) < 1e-3 * size)
        assume(all(abs(slopes(*end)[i] - found[i]) < 1e-3 * size for end in ends))
        assert found[i] == pytest.approx(wide, abs=2e-3 * size)


def difference(formula: Any, point: Sequence[float], i: int, width: float) -> float:
    """Central difference along input `i`."""
    ends = [[v + s * (k == i) for k, v in enumerate(point)] for s in (width, -width)]
    high, low = (float(evaluated(FLOAT, formula, end)) for end in ends)
    return (high - low) / (2.0 * width)
