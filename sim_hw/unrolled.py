"""The car model's step as straight-line Python: its own equations, run over a recording number.

`car_model` is generic over the number type. Here it runs once over numbers that write down each
operation, and the record is compiled: the same operations on the same floats in the same order
(equal bit for bit, tested), without the tuples and calls between them. A step costs a third.
A model that a record cannot hold (one that branches on a value) runs as it is.
"""

import math
from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, NoReturn, cast

from car_model.model import Model, Moment, aim, car_now, drive_actuators, memory_size
from car_model.ops import FLOAT, Ops
from car_model.rollout import glide
from car_model.state import Command, State

Numbers = tuple[float, ...]
_DEEPEST = 20
"""Levels of parentheses; the compiler has a limit of its own."""


class Steps(NamedTuple):
    """A step and its two halves, over plain floats.

    ``actuate(*state, *memory, steer, speed, t, h)`` gives the steering angle at the step's end and
    the acceleration; ``glide(*state, *memory, steer_end, accel, t, h)`` gives state and memory.
    ``follow(*state, *memory, steer, speed, t, h)`` is both.
    """

    actuate: Callable[..., Numbers]
    glide: Callable[..., Numbers]
    follow: Callable[..., Numbers]
    unrolled: bool


class _Recorded:
    """A number that exists only as the name of a local variable."""

    __slots__ = ("name", "tape")

    def __init__(self, tape: "_Tape", name: str) -> None:
        self.tape = tape
        self.name = name

    def __add__(self, other: Any) -> "_Recorded":
        return self.tape.note("{0} + {1}", self, other)

    def __radd__(self, other: Any) -> "_Recorded":
        return self.tape.note("{0} + {1}", other, self)

    def __sub__(self, other: Any) -> "_Recorded":
        return self.tape.note("{0} - {1}", self, other)

    def __rsub__(self, other: Any) -> "_Recorded":
        return self.tape.note("{0} - {1}", other, self)

    def __mul__(self, other: Any) -> "_Recorded":
        return self.tape.note("{0} * {1}", self, other)

    def __rmul__(self, other: Any) -> "_Recorded":
        return self.tape.note("{0} * {1}", other, self)

    def __truediv__(self, other: Any) -> "_Recorded":
        return self.tape.note("{0} / {1}", self, other)

    def __rtruediv__(self, other: Any) -> "_Recorded":
        return self.tape.note("{0} / {1}", other, self)

    def __pow__(self, other: Any) -> "_Recorded":
        return self.tape.note("{0} ** {1}", self, other)

    def __neg__(self) -> "_Recorded":
        return self.tape.note("-{0}", self)

    def _refuse(self, *_: object) -> NoReturn:
        raise TypeError("a recorded number has no value to branch on")

    __bool__ = __float__ = __int__ = __lt__ = __le__ = __gt__ = __ge__ = _refuse
    __eq__ = __ne__ = _refuse


def text(value: Any) -> str:
    """Source text of a recorded or plain number."""
    if isinstance(value, _Recorded):
        return value.name
    number = value if isinstance(value, int) else float(value)
    return f"({number!r})"


class _Entry(NamedTuple):
    """One operation: its form and the texts of its operands."""

    name: str
    form: str
    operands: tuple[str, ...]


class _Tape:
    """The record: one entry per distinct operation."""

    def __init__(self) -> None:
        self._entries: dict[tuple[str, tuple[str, ...]], _Entry] = {}

    def note(self, form: str, *operands: Any) -> _Recorded:
        """The number that an operation gives."""
        key = form, tuple(map(text, operands))
        if key not in self._entries:
            self._entries[key] = _Entry(f"v{len(self._entries)}", *key)
        return _Recorded(self, self._entries[key].name)

    def lines(self, results: Sequence[str]) -> list[str]:
        """The record as statements; what is used once is written where it is used."""
        uses = Counter(results)
        for entry in self._entries.values():
            for at, operand in enumerate(entry.operands):
                uses[operand] += entry.form.count(f"{{{at}}}")
        lines, nested = [], dict[str, tuple[str, int]]()
        for name, form, operands in self._entries.values():
            inner = [nested.get(operand, (operand, 0)) for operand in operands]
            depth = 1 + max((d for _, d in inner), default=0)
            expression = form.format(*(t for t, _ in inner))
            if uses[name] == 1 and name not in results and depth < _DEEPEST:
                nested[name] = f"({expression})", depth
            else:
                lines.append(f"{name} = {expression}")
        return lines


class _RecordingOps:
    """`Ops` over recorded numbers; plain numbers are computed at once."""

    def __init__(self, tape: _Tape) -> None:
        self._tape = tape

    def __getattr__(self, function: str) -> Callable[..., Any]:
        plain = getattr(FLOAT, function)
        form = _FORMS[function]

        def record(*arguments: Any) -> Any:
            if not any(isinstance(a, _Recorded) for a in arguments):
                return plain(*arguments)
            return self._tape.note(form, *arguments)

        return record


_FORMS = {
    **{name: name + "({0})" for name in ("sin", "cos", "tan", "atan", "tanh", "exp", "sqrt")},
    "absolute": "fabs({0})",
    "minimum": "{0} if {0} < {1} else {1}",
    "maximum": "{0} if {0} > {1} else {1}",
    "clip": "{1} if {0} < {1} else ({2} if {0} > {2} else {0})",
    "where_positive": "{1} if {0} > 0.0 else {2}",
}
"""The text of each function, with the meaning that `car_model.ops.FloatOps` gives it."""

_STATE = State._fields
_GLOBALS = {
    **{name: getattr(math, name) for name in ("sin", "cos", "tan", "atan", "tanh", "exp", "sqrt")},
    "fabs": math.fabs,
    "inf": math.inf,
    "nan": math.nan,
}


def make_steps(model: Model[float]) -> Steps:
    """The halves of a step of this model, unrolled where that is possible."""
    count = memory_size(model.effects)

    def actuate(ops: Ops[Any], numbers: Sequence[Any]) -> Sequence[Any]:
        state, _, (steer, speed, t, h) = _split(numbers, count)
        car = car_now(ops, cast("Model[Any]", model), state, t)
        ref = aim(ops, cast("Model[Any]", model), car, Command(steer, speed), t)
        return drive_actuators(ops, cast("Model[Any]", model), car, state, ref, h)

    def move(ops: Ops[Any], numbers: Sequence[Any]) -> Sequence[Any]:
        state, memory, (steer, accel, t, h) = _split(numbers, count)
        car = car_now(ops, cast("Model[Any]", model), state, t)
        moment = Moment(state, memory)
        after = glide(ops, cast("Model[Any]", model), car, moment, steer, accel, h)
        return (*after.state, *after.memory)

    def follow(ops: Ops[Any], numbers: Sequence[Any]) -> Sequence[Any]:
        t, h = numbers[-2:]
        return move(ops, [*numbers[:-4], *actuate(ops, numbers), t, h])

    names = [*_STATE, *(f"m{i}" for i in range(count))]
    try:
        return Steps(
            _compiled(actuate, [*names, "steer_ask", "speed_ask", "t", "h"]),
            _compiled(move, [*names, "steer_end", "accel", "t", "h"]),
            _compiled(follow, [*names, "steer_ask", "speed_ask", "t", "h"]),
            True,
        )
    except TypeError:
        return Steps(
            lambda *numbers: tuple(actuate(FLOAT, numbers)),
            lambda *numbers: tuple(move(FLOAT, numbers)),
            lambda *numbers: tuple(follow(FLOAT, numbers)),
            False,
        )


def _split(numbers: Sequence[Any], count: int) -> tuple[State[Any], tuple[Any, ...], Sequence[Any]]:
    end = len(_STATE) + count
    return State(*numbers[: len(_STATE)]), tuple(numbers[len(_STATE) : end]), numbers[end:]


def _compiled(
    function: Callable[[Ops[Any], Sequence[Any]], Sequence[Any]], names: Sequence[str]
) -> Callable[..., Numbers]:
    """Run a function once over recorded numbers and compile the record.

    Raises:
        TypeError: the function needs a number's value.
    """
    tape = _Tape()
    ops = cast("Ops[Any]", _RecordingOps(tape))
    results = function(ops, [_Recorded(tape, name) for name in names])
    ends = [text(result) for result in results]
    body = "\n    ".join([*tape.lines(ends), f"return ({', '.join(ends)},)"])
    scope: dict[str, Any] = dict(_GLOBALS)
    exec(compile(f"def step({', '.join(names)}):\n    {body}\n", "<unrolled>", "exec"), scope)
    return cast("Callable[..., Numbers]", scope["step"])
