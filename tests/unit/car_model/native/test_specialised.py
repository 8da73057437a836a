"""Equations under bounds of their inputs: the same numbers, fewer operations."""

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from steerd.car_model.native.print_c import fast_rates
from steerd.car_model.native.specialised import SPECIALISED_SPEED, Range, specialise
from steerd.car_model.native.trace import trace
from steerd.car_model.params import DEFAULT_CAR
from steerd.car_model.straight_line import compiled
from steerd.car_model.tape import TAPE, Tape, gradient, needed

OPS = ("add", "sub", "mul", "min", "max", "select", "neg")


def test_above_walking_pace_both_forms_give_the_same_rates():
    traced = trace(())
    fast = fast_rates(traced)
    inputs = [*fast.inputs, *traced.symbols, traced.h]
    one, other = (compiled(inputs, list(p.outputs)) for p in (traced.rates, fast))
    rng = np.random.default_rng(3)
    for _ in range(200):
        x = rng.normal(size=len(fast.inputs)) * 0.2
        x[3] = rng.uniform(SPECIALISED_SPEED, 6.0)
        numbers = [*x.tolist(), *DEFAULT_CAR, 0.005]
        np.testing.assert_allclose(other(*numbers), one(*numbers), rtol=1e-13, atol=1e-15)
    assert len(needed(fast.outputs)) < 0.7 * len(needed(traced.rates.outputs))
    wheel = fast.inputs[6]
    assert not {"tan", "atan", "select", "min", "max"} & {
        traced.tape.entries[p].op for p in needed(gradient([(fast.outputs[5], 1.0)], [wheel]))
    }


@given(st.integers(0, 10**6), st.floats(-2.0, 2.0), st.floats(0.0, 3.0))
@settings(derandomize=True, deadline=None, max_examples=150)
def test_any_expression_keeps_its_value_within_the_bounds(seed, low, width):
    """Random expressions of three inputs, one of them bounded."""
    rng, tape = np.random.default_rng(seed), Tape()
    inputs = [tape.symbol(name) for name in "abc"]
    nodes = [*inputs, tape.constant(0.5), tape.constant(-1.0)]
    choices = {"min": TAPE.minimum, "max": TAPE.maximum, "select": TAPE.where_positive}
    for _ in range(12):
        op = OPS[rng.integers(len(OPS))]
        a, b, c = (nodes[i] for i in rng.integers(len(nodes), size=3))
        plain = {"add": lambda x, y: x + y, "sub": lambda x, y: x - y, "mul": lambda x, y: x * y}
        if op == "neg":
            nodes.append(-a)
        elif op == "select":
            nodes.append(choices[op](a, b, c))
        else:
            nodes.append((plain.get(op) or choices[op])(a, b))
    outputs = nodes[-4:]
    short = specialise(outputs, {inputs[0].place: Range(low, low + width)})
    before, after = (compiled(inputs, list(each)) for each in (outputs, short))
    for a in np.linspace(low, low + width, 5):
        numbers = [float(a), *rng.normal(size=2).tolist()]
        got, wanted = after(*numbers), before(*numbers)
        assert all(
            math.isclose(x, y, rel_tol=1e-12, abs_tol=1e-12)
            for x, y in zip(got, wanted, strict=True)
        )


def test_bounds_that_are_not_known_decide_nothing():
    tape = Tape()
    a, b = tape.symbol("a"), tape.symbol("b")
    chosen = TAPE.maximum(a, b * 2.0)
    assert specialise([chosen], {})[0].place == chosen.place
    assert specialise([chosen], {a.place: Range(-1.0, math.inf)})[0].place == chosen.place
