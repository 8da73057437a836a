"""The record of the equations: what it keeps, what it rewrites, its derivatives at the seams."""

import math

import pytest

from steerd.car_model.tape import TAPE, Node, Tape, apply, gradient, program


def inputs(*names: str) -> list[Node]:
    tape = Tape()
    return [tape.symbol(name) for name in names]


def slope(function, x: float) -> float:  # type: ignore[no-untyped-def]
    (a,) = inputs("a")
    return program([a], gradient([(function(a), 1.0)], [a]))(x)[0]


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
    at = (math.nextafter(seam, -9.0), seam, math.nextafter(seam, 9.0))
    assert tuple(slope(function, x) for x in at) == slopes


def test_what_nothing_depends_on_has_no_derivative():
    a, b = inputs("a", "b")
    (by_b,) = gradient([(a * a, 1.0)], [b])
    assert by_b.entry.value == 0.0
    assert by_b.entry.op == "const"
    assert gradient([], [a])[0].entry.value == 0.0


def test_an_operation_without_a_derivative_is_refused():
    (a,) = inputs("a")
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
