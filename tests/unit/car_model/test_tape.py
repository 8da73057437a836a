"""The record of the equations: what it keeps, what it rewrites, its derivatives at the seams."""

import math
import operator
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from steerd.car_model.ops import FLOAT, Ops
from steerd.car_model.tape import TAPE, Node, Tape, apply, gradient, program


def inputs(*names: str) -> list[Node]:
    tape = Tape()
    return [tape.symbol(name) for name in names]


SEAMS = [
    (lambda a: TAPE.minimum(a, 1.0), 1.0, (1.0, 0.0, 0.0)),
    (lambda a: TAPE.maximum(a, 1.0), 1.0, (0.0, 0.0, 1.0)),
    (lambda a: TAPE.clip(a, -1.0, 1.0), 1.0, (1.0, 0.0, 0.0)),
    (lambda a: TAPE.clip(a, -1.0, 1.0), -1.0, (0.0, 0.0, 1.0)),
    (lambda a: TAPE.where_positive(a, 2.0 * a, 3.0 * a), 0.0, (3.0, 3.0, 2.0)),
    (TAPE.absolute, 0.0, (-1.0, -1.0, 1.0)),
]


@pytest.mark.parametrize(("function", "seam", "slopes"), SEAMS)
def test_a_seam_has_the_derivative_of_the_branch_taken(function, seam, slopes):  # type: ignore[no-untyped-def]
    (a,), at = inputs("a"), (math.nextafter(seam, -9.0), seam, math.nextafter(seam, 9.0))
    slope = program([a], gradient([(function(a), 1.0)], [a]))
    assert tuple(slope(x)[0] for x in at) == slopes


def test_what_nothing_depends_on_has_no_derivative_and_some_operations_have_none():
    a, b = inputs("a", "b")
    (by_b,) = gradient([(a * a, 1.0)], [b])
    assert (by_b.entry.value, by_b.entry.op) == (0.0, "const")
    assert gradient([], [a])[0].entry.value == 0.0
    with pytest.raises(ValueError, match="no derivative for floor"):
        gradient([(apply("floor", a), 1.0)], [a])


def test_constants_are_worked_out_and_zeros_keep_their_sign():
    tape = Tape()
    a = tape.symbol("a")
    assert (tape.constant(2.0) * 3.0 - 1.0).entry.value == 5.0
    assert (tape.constant(1.0) / 4.0).entry.value == 0.25
    assert (Tape().constant(1.0) / 0.0).entry.value == math.inf
    assert tape.constant(0.0).place != tape.constant(-0.0).place
    assert tape.node(a) is a


def test_a_record_cannot_be_branched_on():
    (a,) = inputs("a")
    with pytest.raises(TypeError, match="branch"):
        bool(a)
    for compare in (lambda: a < 1.0, lambda: a >= 1.0, lambda: float(a)):  # type: ignore[operator, arg-type]
        with pytest.raises(TypeError):
            compare()


# Random formulas: the recorded program gives the floats, its derivatives the differences.
often = settings(derandomize=True, deadline=None, max_examples=150)

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


@often
@given(formulas, points)
def test_a_record_gives_the_same_values(formula, point):
    expected = evaluated(FLOAT, formula, point)
    near = [evaluated(FLOAT, formula, [v + d for v in point]) for d in (1e-9, -1e-9)]
    size = max(map(abs, (expected, *near)))
    assume(size < 1e6)
    assume(all(abs(n - expected) < 1e-6 * (1.0 + size) for n in near))  # a jump of where_positive
    (found,) = recorded(formula)(*point)
    assert found == pytest.approx(expected, rel=1e-9, abs=1e-9)


@often
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
    ends = [[v + s * (k == i) for k, v in enumerate(point)] for s in (width, -width)]
    high, low = (float(evaluated(FLOAT, formula, end)) for end in ends)
    return (high - low) / (2.0 * width)
