"""The filter in machine code gives the bits that it gives in Python."""

import math
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from steerd.car_model import machine_code
from steerd.car_model.chassis import Chassis
from steerd.car_model.params import DEFAULT_CAR, PAPER_CAR, Car
from steerd.car_model.planar import CHASSIS
from steerd.car_model.single_track import SINGLE_TRACK
from steerd.car_model.state import Command
from steerd.estimator.actuation import History
from steerd.estimator.config import FilterConfig
from steerd.estimator.kalman import Belief
from steerd.estimator.native import choice, generate
from steerd.estimator.native.source import FILTER
from steerd.estimator.sensors import make_gyro, make_pose, make_wheel_speed
from steerd.estimator.state_filter import (
    FilterState,
    Node,
    StateFilter,
    Tally,
    make_state_filter,
    predict_to,
    step,
)
from steerd.sealed_file import CacheRefused

MS = 1_000_000
T0 = 10**12
ODD_CAR = PAPER_CAR._replace(
    speed_gain=1.07, steer_gain=0.9, steer_bias=0.02, steer_delay=0.012, drive_delay=0.004,
    pose_delay=0.003,
)  # fmt: skip
pytestmark = pytest.mark.skipif(not machine_code.find_compiler(), reason="no C compiler")


@pytest.fixture(scope="module")
def both() -> Any:
    """Filters of a car, in Python and in machine code."""
    assert machine_code.build_library(FILTER) is not None
    choice._checked_library.cache_clear()

    def make(
        car: Car[float], chassis: Chassis = SINGLE_TRACK, config: FilterConfig | None = None
    ) -> tuple[StateFilter, ...]:
        made = partial(make_state_filter, car, config, chassis=chassis)
        pair = made(), made(native=True)
        assert pair[0].kernel is None
        assert pair[1].kernel is not None
        return pair

    return make


def assert_same(one: FilterState, other: FilterState) -> None:
    """The same nodes, to the last bit."""
    assert len(one.nodes) == len(other.nodes)
    for a, b in zip(one.nodes, other.nodes, strict=True):
        np.testing.assert_array_equal(a.belief.mean, b.belief.mean)
        np.testing.assert_array_equal(a.belief.covariance, b.belief.covariance)
        np.testing.assert_array_equal(a.innovation, b.innovation)
        np.testing.assert_array_equal(a.nis, b.nis)
        assert (a.measurement, a.believed) == (b.measurement, b.believed)
        np.testing.assert_array_equal(a.tally, b.tally)


def test_the_printed_equations_are_those_of_the_car() -> None:
    printed = generate.TARGET.read_text(encoding="utf-8")
    assert printed == generate.generated_text()


@pytest.mark.parametrize("chassis", CHASSIS, ids=lambda chassis: chassis.label)
@pytest.mark.parametrize("car", [DEFAULT_CAR, ODD_CAR])
def test_a_drive_gives_the_same_bits(
    both: Any, simulate: Any, run_filter: Any, car: Any, chassis: Chassis
) -> None:
    drive = simulate(seed=3, seconds=2.0, car=car, gyro=True)
    reference, native = both(car, chassis)
    pairs = zip(run_filter(reference, drive), run_filter(native, drive), strict=True)
    for k, ((t_ns, one), (_, other)) in enumerate(pairs):
        if k % 40 == 0:
            assert_same(one, other)
        seen = [predict_to(flt, s, t_ns) for flt, s in ((reference, one), (native, other))]
        if seen[0] is not None:
            assert (seen[0].state, seen[0].sd) == (seen[1].state, seen[1].sd)
            assert repr(seen[0].health) == repr(seen[1].health)


FINITE = st.floats(-1.0, 1.0)


@st.composite
def scenes(draw: st.DrawFn) -> tuple[Node, History, list[Any]]:
    """A belief somewhere, orders about it, and what is measured after it."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    scale = np.array([3.0, 3.0, 3.0, 1.0, 2.0, 0.3, 0.3])
    mean = scale * rng.uniform(-1.0, 1.0, 7) + np.array([0, 0, 0, draw(st.floats(-1, 3)), 0, 0, 0])
    root = 10.0 ** draw(st.floats(-4.0, 0.0)) * rng.standard_normal((7, 7))
    belief = Belief(mean, root @ root.T + 1e-10 * np.eye(7))
    times = tuple(T0 - 60 * MS + k * draw(st.integers(1, 12)) * MS for k in range(12))
    times = tuple(sorted(set(times)))
    orders = tuple(
        None if rng.random() < 0.2 else Command(*rng.uniform((-0.5, -1.0), (0.5, 4.0)).tolist())
        for _ in times
    )
    measured = [make_wheel_speed(T0 + 3 * MS, mean[3] + draw(FINITE))]
    measured += [make_gyro(T0 + draw(st.integers(0, 40)) * MS, mean[4] + draw(FINITE))]
    place = draw(st.integers(0, 400)) * MS
    pose = (float(value) + 0.1 * draw(FINITE) for value in mean[:3])
    measured += [make_pose(T0 + place, *pose)]
    first = make_pose(T0, *mean[:3].tolist())
    return (
        Node(first, belief, np.empty(0), math.nan, True, Tally()),
        History(times, orders),
        measured,
    )


@settings(max_examples=60, deadline=None)
@given(
    scene=scenes(), car=st.sampled_from([DEFAULT_CAR, ODD_CAR]), chassis=st.sampled_from(CHASSIS)
)
def test_any_belief_orders_and_measurements_give_the_same_bits(
    both: Any, scene: Any, car: Any, chassis: Chassis
) -> None:
    node, history, measured = scene
    end = T0 + 450 * MS
    states = []
    for flt in both(car, chassis):
        state = step(flt, FilterState((node,), history), end, measured)
        states.append((state, predict_to(flt, state, end)))
    (one, look), (other, native_look) = states
    assert_same(one, other)
    np.testing.assert_array_equal(look.covariance, native_look.covariance)
    assert repr(look.health) == repr(native_look.health)


def test_readings_that_are_no_numbers_are_pythons_to_judge(both: Any) -> None:
    flts = both(DEFAULT_CAR)
    node = Node(
        make_pose(T0, 0, 0, 0), Belief(np.zeros(7), np.eye(7)), np.empty(0), math.nan, True, Tally()
    )
    bad = [make_wheel_speed(T0 + MS, math.nan), make_pose(T0 + 2 * MS, 1e9, 0.0, 0.0)]
    one, other = (step(flt, FilterState((node,)), T0 + 5 * MS, bad) for flt in flts)
    assert_same(one, other)
    assert not other.nodes[-1].believed


def test_what_is_not_finite_is_left_to_python(both: Any) -> None:
    _, native = both(DEFAULT_CAR)
    huge = Belief(np.full(7, 1e300), 1e300 * np.eye(7))
    assert native.kernel.predict(History(), huge, T0, T0 + 5 * MS) is None
    assert native.kernel.fuse(History(), huge, T0, [make_gyro(T0 + MS, 0.0)]) is None
    endless = [make_gyro(T0 + k, 0.0) for k in range(300)]
    assert native.kernel.fuse(History(), Belief(np.zeros(7), np.eye(7)), T0, endless) is None


class Altered:
    """The machine code with one function that rounds otherwise."""

    def __init__(self, library: Any, name: str) -> None:
        self.library, self.name = library, name

    def __getattr__(self, name: str) -> Any:
        real = getattr(self.library, name)

        def altered(*args: Any) -> Any:
            outcome = real(*args)
            if name == "try_functions":
                args[-1][3] = math.nextafter(args[-1][3], math.inf)
            else:
                import ctypes

                nis = ctypes.c_double.from_address(args[-1].value)
                nis.value = math.nextafter(nis.value, math.inf)
            return outcome

        return altered if name == self.name else real


@pytest.mark.parametrize("name", ["try_functions", "try_algebra"])
def test_machine_code_with_other_bits_is_not_used(both: Any, name: str) -> None:
    library = machine_code.load_library(FILTER, choice.gives_same_bits)
    assert library is not None
    altered = Altered(library, name)
    assert not (machine_code.same_functions(altered) and choice.gives_same_bits(altered))


def test_without_a_compiler_python_computes(both: Any, monkeypatch: Any, tmp_path: Any) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("CC", raising=False)
    choice._checked_library.cache_clear()
    assert machine_code.build_library(FILTER) is None
    flt = make_state_filter(DEFAULT_CAR, native=True)
    choice._checked_library.cache_clear()
    assert flt.kernel is None


@pytest.mark.parametrize("compiler", ["false", "sleep 0.01"])
def test_a_compiler_that_makes_nothing_leaves_nothing(
    monkeypatch: Any, tmp_path: Any, compiler: str
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setenv("CC", compiler)
    assert machine_code.build_library(FILTER) is None
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]


def test_a_folder_that_cannot_be_written_is_named(monkeypatch: Any, tmp_path: Any) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    with pytest.warns(machine_code.CodeNotKept, match="file/steerd/machine-code: Not a directory"):
        assert machine_code.build_library(FILTER) is None


def test_a_disk_that_fills_while_compiling_is_named(monkeypatch: Any, tmp_path: Any) -> None:
    compiler = tmp_path / "compiler"
    compiler.write_text(
        "#!/bin/sh\necho 'ld: final link failed: No space left on device' >&2\nfalse"
    )
    compiler.chmod(0o755)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setenv("CC", str(compiler))
    with pytest.warns(machine_code.CodeNotKept, match="No space left on device; without"):
        assert machine_code.build_library(FILTER) is None


@pytest.mark.parametrize("damage", ["cut", "zeros", "a bit", "no library"])
def test_a_damaged_library_is_made_anew(monkeypatch: Any, tmp_path: Any, damage: str) -> None:
    """Loaded as they are, most of these end the process with SIGBUS or SIGSEGV."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    path = machine_code.build_library(FILTER)
    assert path is not None
    whole = path.read_bytes()
    middle = len(whole) // 2
    path.write_bytes(
        {
            "cut": whole[:middle],
            "zeros": whole[:middle] + bytes(len(whole) - middle),
            "a bit": whole[:middle] + bytes([whole[middle] ^ 1]) + whole[middle + 1 :],
            "no library": b"no library",
        }[damage]
    )
    with pytest.warns(CacheRefused, match="is damaged or was changed"):
        assert machine_code.load_library(FILTER) is None
    with pytest.warns(CacheRefused, match="it is made anew"):
        assert machine_code.build_library(FILTER) == path
    assert path.read_bytes() == whole
    assert machine_code.load_library(FILTER) is not None


def test_another_configuration_is_another_kernel(both: Any, simulate: Any, run_filter: Any) -> None:
    config = replace(FilterConfig(), wheel_speed_sd=0.1, yaw_accel_density=3.0)
    drive = simulate(seed=5, seconds=0.5)
    flts = both(DEFAULT_CAR, config=config)
    (_, one), (_, other) = (list(run_filter(flt, drive))[-1] for flt in flts)
    assert_same(one, other)
