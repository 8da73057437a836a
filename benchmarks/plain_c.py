"""A plain C loop over the same equations, written from their record and compiled on the spot.

Value and gradient of the sum of squared positions: march forward keeping the states, march back
with the step's own adjoint. What a C programmer would write by hand, one run after the other.
"""

import ctypes
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from steerd.car_model.model import Model, Moment
from steerd.car_model.params import Car
from steerd.car_model.rollout import rk4, step
from steerd.car_model.state import Command, State
from steerd.car_model.tape import TAPE, Node, Tape, gradient, needed

Array = NDArray[np.float64]
_FORMS = {
    "add": "{0} + {1}", "sub": "{0} - {1}", "mul": "{0} * {1}", "div": "{0} / {1}",
    "neg": "-{0}", "inverse": "1.0 / {0}", "abs": "fabs({0})",
    "min": "{0} < {1} ? {0} : {1}", "max": "{0} > {1} ? {0} : {1}",
    "select": "{0} > 0.0 ? {1} : {2}",
}  # fmt: skip
_LOOP = """
#include <math.h>
#include <stdlib.h>
static void forward(const double *p, double h, const double *s, const double *u, double *o) {{
{forward}
}}
static void backward(const double *p, double h, const double *s, const double *u,
                     const double *b, double *sb, double *pb) {{
{backward}
}}
double simulate(const double *p, double h, const double *first, const double *commands,
                long runs, long steps, double *slopes) {{
    double loss = 0.0, *path = malloc((steps + 1) * 7 * sizeof(double));
    for (long r = 0; r < runs; r++) {{
        const double *u = commands + 2 * r * steps;
        for (int i = 0; i < 7; i++) path[i] = first[7 * r + i];
        for (long k = 0; k < steps; k++) {{
            forward(p, h, path + 7 * k, u + 2 * k, path + 7 * (k + 1));
            double *s = path + 7 * (k + 1);
            loss += s[0] * s[0] + s[1] * s[1];
        }}
        double bar[7] = {{0.0}}, next[7];
        for (long k = steps; k > 0; k--) {{
            bar[0] += 2.0 * path[7 * k];
            bar[1] += 2.0 * path[7 * k + 1];
            backward(p, h, path + 7 * (k - 1), u + 2 * (k - 1), bar, next, slopes);
            for (int i = 0; i < 7; i++) bar[i] = next[i];
        }}
    }}
    free(path);
    return loss;
}}
"""


def _body(outputs: Sequence[Node], targets: Sequence[str]) -> str:
    """Statements for some outputs of the record."""
    entries, lines = outputs[0].tape.entries, []
    for place in needed(outputs):
        entry = entries[place]
        if entry.args:
            form = _FORMS.get(entry.op, entry.op + "({0})")
            text = form.format(*(f"v{a}" for a in entry.args))
        else:
            text = entry.name
        lines.append(f"    const double v{place} = {text};")
    lines += [f"    {t} v{n.place};" for t, n in zip(targets, outputs, strict=True)]
    return "\n".join(lines)


def _source() -> str:
    tape = Tape()
    state = [tape.symbol(f"s[{i}]") for i in range(7)]
    orders = [tape.symbol(f"u[{i}]") for i in range(2)]
    numbers = [tape.symbol(f"p[{i}]") for i in range(len(Car._fields))]
    h = tape.symbol("h")
    model: Model[Any] = Model(Car(*numbers))
    moment: Moment[Any] = Moment(State(*state))
    after = step(TAPE, model, moment, Command(*orders), 0.0, h, rk4)  # type: ignore[arg-type]
    out = [tape.node(value) for value in after.state]
    seeds = [(value, tape.symbol(f"b[{i}]")) for i, value in enumerate(out)]
    slopes = [tape.node(value) for value in gradient(seeds, [*state, *numbers])]
    into = [f"sb[{i}] =" for i in range(7)] + [f"pb[{i}] +=" for i in range(len(numbers))]
    return _LOOP.format(
        forward=_body(out, [f"o[{i}] =" for i in range(7)]), backward=_body(slopes, into)
    )


def make_plain_c() -> Callable[[Array, float, Array, Array], tuple[float, Array]] | None:
    """(parameters, h, first (W, 7), commands (W, N, 2)) -> value and gradient; None without cc."""
    compiler = shutil.which("cc")
    if compiler is None:
        return None
    with tempfile.TemporaryDirectory() as folder:
        source, library = Path(folder) / "loop.c", Path(folder) / "loop.so"
        source.write_text(_source(), encoding="ascii")
        command = [compiler, "-O2", "-shared", "-fPIC", str(source), "-o", str(library), "-lm"]
        subprocess.run(command, check=True)
        simulate = ctypes.CDLL(str(library)).simulate
    pointer = np.ctypeslib.ndpointer(np.float64, flags="C_CONTIGUOUS")
    long = ctypes.c_long
    simulate.argtypes = [pointer, ctypes.c_double, pointer, pointer, long, long, pointer]
    simulate.restype = ctypes.c_double

    def run(parameters: Array, h: float, first: Array, commands: Array) -> tuple[float, Array]:
        slopes = np.zeros(len(parameters))
        runs, steps = commands.shape[:2]
        return simulate(parameters, h, first, commands, runs, steps, slopes), slopes

    return run
