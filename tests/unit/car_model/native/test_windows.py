"""The compiled library: Python's numbers, and the same bits from every compiler and processor."""

import hashlib
import importlib.util
import pickle
import platform
import shutil
import subprocess
import sys
from functools import partial
from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from steerd.car_model.effects import EFFECTS, find_effect
from steerd.car_model.model import Model
from steerd.car_model.native import library, windows
from steerd.car_model.native.build import BuildError, Compiler, compile_model, link, model_text
from steerd.car_model.native.library import LibraryError, load_function, load_library, model_label
from steerd.car_model.native.specialised import Range, specialise
from steerd.car_model.native.threads import WORTHWHILE, share_out
from steerd.car_model.native.windows import STATES, compute_readings, make_kernels, march
from steerd.car_model.ops import FLOAT
from steerd.car_model.params import DEFAULT_CAR
from steerd.car_model.planar import CHASSIS, PLANAR
from steerd.car_model.rollout import simulate, start
from steerd.car_model.state import Command, State
from steerd.car_model.tape import TAPE, Tape, program
from steerd.estimator import compiled
from steerd.estimator.config import FilterConfig
from steerd.estimator.history import History
from steerd.estimator.initial import make_belief
from steerd.estimator.sensors import make_gyro, make_pose, make_sensors, make_wheel_speed
from steerd.sim_hw.plant.car import make_steps
from tests.unit.car_model.test_tape import evaluated, formulas, points

H, STEPS, COUNT, N = 0.01, 60, 11, 13
EVERY = tuple(EFFECTS.values())


def _model(effects, chassis):
    """A car whose effects all do something."""
    rng = np.random.default_rng(0)
    of = [[np.clip(p.null + 0.05 * rng.random(), p.low, p.high) for p in e.parameters]
          for e in effects]  # fmt: skip
    return Model(DEFAULT_CAR, effects, tuple(tuple(map(float, each)) for each in of), chassis)


def _drive(model, speed):
    rng = np.random.default_rng(1)
    rows = np.stack([rng.uniform(-0.3, 0.3, STEPS), speed + rng.uniform(-0.3, 0.3, STEPS)], 1)
    first = np.zeros((COUNT, STATES + make_kernels(model.effects, model.chassis).memory))
    first[:, 2:4] = np.stack([rng.normal(size=COUNT), np.full(COUNT, speed)], 1)
    return windows.HeldCommands(rows, H), first


def _path(kernels, model, held, first):
    """The compiled path of all windows."""
    runs = np.tile(np.array([0, STEPS, 0]), (COUNT, 1))
    blocks = windows.make_window_blocks(runs, np.zeros(COUNT))
    return march(kernels, windows.parameter_vector(model), first, held, blocks, STEPS)


def _marched(model, held, first):
    """The compiled path of all windows, and Python's of some: (steps, states)."""
    path = _path(make_kernels(model.effects, model.chassis), model, held, first)
    orders, driven = [Command(*row) for row in held.rows.tolist()], {}
    for w in (0, COUNT - 1):
        begin = start(model, State(*first[w, :STATES].tolist()), 0.0)
        driven[w] = np.array([m.state for m in simulate(FLOAT, model, begin, orders, H)])
    return path, driven


@pytest.mark.parametrize("speed", [0.3, 1.5])
@pytest.mark.parametrize("chassis", CHASSIS, ids=lambda chassis: chassis.label)
@pytest.mark.parametrize("effects", [(), EVERY, (find_effect("tyre_relaxation"),)], ids=len)
def test_a_drive_is_that_of_python_on_floats(effects, chassis, speed):
    model = _model(effects, chassis)
    held, first = _drive(model, speed)
    path, driven = _marched(model, held, first)
    for w, found in driven.items():
        assert np.abs(path[:, :STATES, w] - found).max() < 1e-12 * max(1.0, np.abs(found).max())


def _digest(effects, chassis):
    """Of everything that the library computes, on the move and at walking pace."""
    seen = hashlib.sha256()
    for speed in (0.3, 1.5):
        model = _model(effects, chassis)
        held, first = _drive(model, speed)
        kernels, p = make_kernels(effects, chassis), windows.parameter_vector(model)
        rng = np.random.default_rng(2)
        begin = 20 + np.arange(COUNT) % 3
        spans = np.column_stack([0 * begin, 0 * begin + STEPS, begin, 30 + begin % 3, begin % 2])
        reading = windows.Windows(spans, H * begin)
        each = product(range(COUNT), range(30))
        places = [(k, 3 * (k % 2), w * 120 + 3 * k, 1 - k % 2) for w, k in each]
        shares, begins = rng.random(len(places)), 30 * np.arange(COUNT + 1)
        at = windows.Stations(np.array(places), shares, begins, 120 * COUNT)
        seeds, dfirst = rng.normal(size=(len(p), N)), rng.normal(size=(STATES, N))
        y, jy = compute_readings(kernels, p, seeds, first[:, :STATES], dfirst, held, reading, at)
        seen_by = [r + np.arange(3 if pose else 1) for _, _, r, pose in places]
        rows = np.unique(np.concatenate(seen_by))
        blocks = windows.make_window_blocks(np.ascontiguousarray(spans[:, :3]), reading.t)
        path = march(kernels, p, first, held, blocks, 30)
        pulls = rng.normal(size=(COUNT, *path.shape[:2]))
        back = windows.march_back(kernels, p, path, pulls, held, blocks)
        assert np.isfinite(path).all()
        assert np.isfinite(jy[rows]).all()
        settled = windows.settle(kernels, p, first, held, reading)
        for array in (y[rows], jy[rows], path, *back, settled):
            seen.update(np.ascontiguousarray(array).tobytes())
        steps = make_steps.__wrapped__(model, 0.002)
        begun = (*first[0, :STATES].tolist(), *[0.0] * steps.memory)
        for numbers in (steps.follow(*begun, 0.1, 1.0, 0.3), steps.glide(3, *begun, 0.1, 1.0, 0.3)):
            seen.update(np.array(numbers).tobytes())
    if not effects:
        seen.update(_filtered(chassis))
    return seen.hexdigest()


def _filtered(chassis):
    """What the filter makes of readings that come after late orders."""
    car, config, ms = DEFAULT_CAR._replace(steer_delay=0.012), FilterConfig(), 1_000_000
    kernel = compiled.Kernel(car, chassis, config, make_sensors(car, config))
    orders = tuple(Command(0.2 * (k % 3 - 1), 1.0 + 0.1 * k) for k in range(9))
    history = History(tuple(range(0, 90 * ms, 10 * ms)), orders)
    first = make_belief(np.array([0.1, 0.2, 3.0, 1.0, 0.3, 0.01, 0.05]), 0.01 * np.eye(STATES))
    chain = [make_wheel_speed(20 * ms, 1.1), make_gyro(33 * ms, 0.4), make_pose(60 * ms, 0, 0, 3)]
    beliefs = [link.belief for link in kernel.fuse(history, first, 10 * ms, chain)]
    beliefs.append(kernel.predict(history, beliefs[-1], 60 * ms, 800 * ms).belief)
    return b"".join(belief.numbers for belief in beliefs)


def _use(monkeypatch, **chosen):
    """Take all functions from a library or level of one's own choice."""
    for module in (library, compiled):
        monkeypatch.setattr(module, "load_function", partial(load_function, **chosen))


def _compilers():
    if shutil.which("gcc"):
        yield "gcc", Compiler(("gcc",), "-march={}", underscores=False)
    if importlib.util.find_spec("ziglang"):
        command = (sys.executable, "-m", "ziglang", "cc", "-fno-sanitize=all")
        yield "clang", Compiler(command, "-mcpu={}", underscores=True)


OWN = library.LEVELS.get(platform.machine(), {}).get(library._level(), "")
"""The compilers' name of this processor's level: most have FMA, which nothing may be contracted to.

The oldest level, which compilers take far longer for, is held by that of the library itself.
"""
both_models = pytest.mark.parametrize(
    "model", [((), CHASSIS[0]), (EVERY, PLANAR)], ids=["plain", "every"]
)


@pytest.mark.slow
@both_models
def test_every_compiler_and_optimisation_gives_the_same_bits(model, tmp_path, monkeypatch):
    expected, label = _digest(*model), model_label(*model)
    for (name, compiler), more in product(_compilers(), ("-O1", "-O3")):
        source = tmp_path / f"{name}{more}.c"
        source.write_text(model_text(*model))
        made = compile_model(compiler, source, label, "own", OWN, more)
        link(compiler, [made], source.with_suffix(".so"))
        _use(monkeypatch, level="own", path=source.with_suffix(".so"))
        assert _digest(*model) == expected, (name, more)


@both_models
def test_every_processor_level_gives_the_same_bits(model, monkeypatch):
    expected = _digest(*model)
    for level in ("v3", "v1"):
        try:
            load_function(model_label(*model), "march", level)
        except AttributeError:
            pytest.skip("this machine's library has one level")
        _use(monkeypatch, level=level)
        assert _digest(*model) == expected, level


def test_a_car_is_the_same_in_whatever_order_its_effects_are_named():
    """Some act on the same number, such as the steering angle; memory is laid out anew."""
    forth = _model(EVERY, PLANAR)
    back = forth._replace(effects=EVERY[::-1], values=forth.values[::-1])
    held, first = _drive(forth, 1.5)
    (path, driven), (other, again) = (_marched(model, held, first) for model in (forth, back))
    np.testing.assert_array_equal(path, other)
    np.testing.assert_array_equal([*driven.values()], [*again.values()])


def test_a_compiled_car_travels_without_its_code():
    """Work on a cluster: joblib's goes there, and finds its own code."""
    model, kernels = Model(DEFAULT_CAR), make_kernels()
    data = pickle.dumps(kernels)
    assert len(data) < 5_000
    again = pickle.loads(data)
    assert again.names == kernels.names
    paths = [_path(each, model, *_drive(model, 1.5)) for each in (kernels, again)]
    np.testing.assert_array_equal(*paths)


def test_a_library_of_other_equations_is_refused(tmp_path):
    _, compiler = next(_compilers(), None) or pytest.skip("no C compiler")
    other, made = tmp_path / "other.c", tmp_path / "other.so"
    other.write_text('const char *const fingerprint = "of other equations";\n')
    subprocess.run([*compiler.command, "-shared", "-fPIC", other, "-o", made], check=True)
    with pytest.raises(LibraryError, match=r"older than the equations.*car_model\.native\.build"):
        load_library(made)


def test_a_missing_compiler_names_the_one_to_install(tmp_path):
    nobody = Compiler((str(tmp_path / "nobody"),), "", underscores=False)
    with pytest.raises(BuildError, match="pip install ziglang"):
        compile_model(nobody, tmp_path / "x.c", "x", "own", "")


# Equations under bounds of their inputs: the same numbers, fewer operations.
@given(formulas, st.floats(-2.0, 2.0), st.floats(0.0, 3.0), points)
@settings(derandomize=True, deadline=None, max_examples=300)
def test_any_expression_keeps_its_value_within_the_bounds(formula, low, width, point):
    """Random formulas of three inputs, one of them bounded."""
    tape = Tape()
    inputs = [tape.symbol(name) for name in "abc"]
    output = tape.node(evaluated(TAPE, formula, inputs))
    short = specialise([output], {inputs[0].place: Range(low, low + width)})
    before, after = program(inputs, [output]), program(inputs, list(short))
    for a in np.linspace(low, low + width, 5).tolist():
        assert after(a, *point[1:]) == pytest.approx(before(a, *point[1:]), rel=1e-12, abs=1e-12)


# Pieces of compiled work on several threads.
@pytest.mark.parametrize("threads", [1, 2, 3])
def test_every_piece_is_done_once_by_a_worker_with_a_number(monkeypatch, threads):
    monkeypatch.setenv("OMP_NUM_THREADS", str(threads))
    done = []
    share_out(lambda piece, worker: done.append((piece, worker)), 40, WORTHWHILE)
    assert sorted(piece for piece, _ in done) == list(range(40))
    assert {worker for _, worker in done} <= set(range(threads))


def test_short_work_wakes_nobody_and_what_fails_in_another_thread_fails_here(monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "2")
    done = []
    share_out(lambda piece, worker: done.append((piece, worker)), 3, WORTHWHILE // 10)
    assert done == [(0, 0), (1, 0), (2, 0)]

    def work(piece: int, _worker: int) -> None:
        raise ZeroDivisionError(piece)

    with pytest.raises(ZeroDivisionError):
        share_out(work, 4, WORTHWHILE)


def test_two_threads_give_the_numbers_of_one(monkeypatch):
    kernels, p, count, steps = make_kernels(), np.array(DEFAULT_CAR), 20, WORTHWHILE
    steer = np.random.default_rng(7).uniform(-0.2, 0.2, count * steps)
    low = steps * np.arange(count)
    blocks = windows.make_window_blocks(np.stack([low, low + steps, low], axis=1), np.zeros(count))
    first = np.tile([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0], (count, 1))
    held = windows.HeldCommands(np.stack([steer, np.ones(count * steps)], -1), 0.005)
    found = []
    for threads in (1, 2):
        monkeypatch.setenv("OMP_NUM_THREADS", str(threads))
        path = march(kernels, p, first, held, blocks, steps)
        seen = windows.view_by_window(path, count)
        assert np.shares_memory(seen, path)
        found.append((seen, *windows.march_back(kernels, p, path, seen, held, blocks)))
        bare = windows.march_back(kernels, p, path, seen, held, blocks, commands=False)
        assert not len(bare.commands)
    for one, other in zip(*found, strict=True):
        np.testing.assert_array_equal(one, other)
