"""Paths: geometry of the shapes, files, specs, projection."""

import math
from pathlib import Path as FilePath

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import j0

from steerd.car_model.path import path_spec
from steerd.car_model.path.path import Path, interpolate, locate, project, wrap_angle
from steerd.car_model.path.path_csv import load_path, make_path, read_track
from steerd.car_model.path.path_spec import parse_path

SPECS = ["line", "circle", "circle:radius=-2", "circle:radius=0.7,dir=cw", "figure8",
         "figure8:size=4"]  # fmt: skip
CLOSED = [spec for spec in SPECS if spec != "line"]


def chords(path: Path) -> np.ndarray:
    points = np.column_stack([path.x, path.y])
    if path.closed:
        points = np.vstack([points, points[:1]])
    return np.linalg.norm(np.diff(points, axis=0), axis=1)


@pytest.mark.parametrize("spec", SPECS)
def test_samples_begin_at_the_origin_and_lie_a_step_apart_along_their_heading(spec: str) -> None:
    path = parse_path(spec)
    assert (path.x[0], path.y[0], path.yaw[0]) == (0.0, 0.0, 0.0)
    k = np.abs(path.curvature)
    bend = np.maximum(k, np.roll(k, -1))[: len(chords(path))]
    arc = chords(path) * (1.0 + (bend * path.step) ** 2 / 24.0)
    np.testing.assert_allclose(arc, path.step, atol=1e-6)
    yaw_rate = np.diff(path.yaw) / path.step
    middle = 0.5 * (np.array(path.curvature[1:]) + np.array(path.curvature[:-1]))
    np.testing.assert_allclose(yaw_rate, middle, atol=1e-4)


@pytest.mark.parametrize("spec", CLOSED)
def test_closes_in_place_and_curvature(spec: str) -> None:
    path = parse_path(spec)
    assert chords(path)[-1] == pytest.approx(path.step, abs=1e-6)
    jumps = np.diff([*path.curvature, path.curvature[0]])
    assert np.abs(jumps).max() <= 1.0 * path.step  # |dk/ds| below 1 per square metre
    turns = (path.yaw[-1] + path.curvature[-1] * path.step) / math.tau
    assert turns == pytest.approx(round(turns), abs=1e-3)


def test_known_circles() -> None:
    left, right = parse_path("circle:radius=2"), parse_path("circle:radius=2,dir=cw")
    assert left.length == pytest.approx(4.0 * math.pi)
    np.testing.assert_allclose(np.hypot(left.x, np.array(left.y) - 2.0), 2.0)
    np.testing.assert_allclose(np.hypot(right.x, np.array(right.y) + 2.0), 2.0)
    assert (left.curvature[7], right.curvature[7]) == (0.5, -0.5)
    assert left.yaw[1] > 0.0 > right.yaw[1]


def test_figure_eight_is_drivable_crosses_itself_at_the_origin_and_has_its_extent() -> None:
    path = parse_path("figure8")
    assert j0(path_spec.FIGURE_EIGHT_SWING) == pytest.approx(0.0, abs=1e-15)
    sharpest = 1.0 / path_spec.FIGURE_EIGHT_RADIUS
    assert max(map(abs, path.curvature)) == pytest.approx(sharpest, rel=1e-9)
    half = len(path.x) // 2
    assert math.hypot(path.x[half], path.y[half]) < 1e-12
    assert sum(path.curvature) == pytest.approx(0.0, abs=1e-9)
    path = parse_path("figure8:size=4")
    points = np.column_stack([path.x, path.y])
    apart = np.linalg.norm(points[:, None] - points[None], axis=2)
    assert apart.max() == pytest.approx(4.0, abs=1e-4)


@pytest.mark.parametrize(("spec", "said"), [
    ("oval", "no path called 'oval'"), ("circle:radius", "not name=value"),
    ("circle:radius=big", "give a number"), ("circle:radius=0", "circle:radius=2"),
    ("circle:radius=nan", "circle:radius=2"), ("circle:dir=left", "dir=ccw"),
    ("circle:size=2", "no option size"), ("line:length=-1", "line:length=20"),
    ("line:length=inf", "line:length=20"), ("figure8:radius=1,size=2", "not both"),
    ("figure8:radius=-1", "figure8:radius=1.5"), ("csv:", "which file"),
    ("csv:/nowhere/at/all.csv", "No such file"),
])  # fmt: skip
def test_a_wrong_spec_says_what_is_wrong(spec: str, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        parse_path(spec)


# --- files
def oval_points(count: int = 80) -> np.ndarray:
    u = math.tau * np.arange(count) / count
    return np.column_stack([3.0 * np.cos(u) + 5.0, 2.0 * np.sin(u) - 1.0])


def oval_raceline(offset: float, count: int = 80) -> str:
    u = math.tau * np.arange(count) / count
    yaw = np.arctan2(2.0 * np.cos(u), -3.0 * np.sin(u))
    rows = [
        f"{i * 0.2}; {x}; {y}; {wrap_angle(psi + offset)}; 0.3; {1.0 + 0.5 * math.sin(a)}; 0.0"
        for i, ((x, y), psi, a) in enumerate(zip(oval_points(count), yaw, u, strict=True))
    ]
    header = "# 4aa6d0b7\n# s_m; x_m; y_m; psi_rad; kappa_radpm; vx_mps; ax_mps2\n"
    return header + "\n".join([*rows, rows[0]])


@pytest.mark.parametrize("offset", [-0.5 * math.pi, 0.0])
def test_raceline_with_psi_from_north_or_from_x_and_no_other(offset: float) -> None:
    path = make_path(read_track(oval_raceline(offset), "oval.csv"))
    assert path.closed
    assert path.length == pytest.approx(15.8654396, abs=1e-3)  # 12 E(sqrt(5)/3)
    assert path.curvature[0] == pytest.approx(3.0 / 4.0, rel=5e-3)  # a / b^2 at the vertex
    assert path.yaw[0] == pytest.approx(math.pi / 2.0, abs=1e-3)
    assert max(path.speed) == pytest.approx(1.5, abs=0.01)
    assert path.width_left is None
    with pytest.raises(ValueError, match="psi_rad disagrees"):
        make_path(read_track(oval_raceline(1.5), "oval.csv"))


def test_centreline_with_widths_placed_at_the_start(tmp_path: FilePath) -> None:
    file = tmp_path / "track.csv"
    rows = [f"{x}, {y}, 1.1, 0.9" for x, y in oval_points()]
    file.write_text("# x_m, y_m, w_tr_right_m, w_tr_left_m\n" + "\n".join(rows))
    path = parse_path(f"csv:{file}")
    assert (path.x[0], path.y[0], path.yaw[0]) == (0.0, 0.0, 0.0)
    assert (path.width_left[3], path.width_right[3]) == pytest.approx((0.9, 1.1))
    as_is = parse_path(f"csv:{file},place=as-is")
    assert (as_is.x[0], as_is.y[0]) == pytest.approx((8.0, -1.0))


def test_smoothing_calms_a_noisy_line() -> None:
    noise = np.random.default_rng(3).normal(0.0, 0.01, (80, 2))
    track = read_track("\n".join(f"{x},{y}" for x, y in oval_points() + noise), "noisy.csv")
    calm, rough = (max(map(abs, make_path(track, smooth=s).curvature)) for s in (0.012, 0.0))
    assert calm < 0.5 * rough


@pytest.mark.parametrize(("text", "said"), [
    ("1,2\n3,4\n", "2 points"), ("1,2,3\n" * 9, "columns"), ("1,2\n" * 9, "do not move"),
    ("0,0\n1,1\nx,2\n3,3\n4,4\n5,5", "line 3"), ("0,0\n1,1\n2,nan\n3,3\n4,4\n5,5", "not finite"),
    ("", "0 points"),
])  # fmt: skip
def test_a_useless_file_says_why(text: str, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        read_track(text, "bad.csv")


def test_a_place_or_a_file_that_is_none_is_refused_in_plain_words(tmp_path: FilePath) -> None:
    with pytest.raises(ValueError, match="place=start"):
        load_path(tmp_path / "x.csv", place="here")
    binary = tmp_path / "points.csv"
    binary.write_bytes(bytes(range(128, 256)))
    for place, words in ((tmp_path, "Is a directory"), (binary, "not a text of points")):
        with pytest.raises(ValueError, match=words) as caught:
            parse_path(f"csv:{place}")
        assert "Errno" not in str(caught.value)
        assert "codec" not in str(caught.value)


# --- projection
@pytest.mark.parametrize("e1", [-0.3, 0.0, 0.3])
def test_the_crossing_of_the_figure_eight_keeps_the_branch(e1: float) -> None:
    path = parse_path("figure8")
    hint, before = 0, -0.01
    for k in range(2 * len(path.x)):
        i = k % len(path.x)
        x = path.x[i] - e1 * math.sin(path.yaw[i])
        y = path.y[i] + e1 * math.cos(path.yaw[i])
        seen = project(path, x, y, hint)
        moved = (seen.s - before) % path.length
        assert 0.0 < moved < 2.0 * path.step
        assert seen.e1 == pytest.approx(e1, abs=1e-6)
        hint, before = seen.hint, seen.s


def test_a_heading_chooses_the_branch_and_beyond_an_open_end_the_line_goes_on() -> None:
    path = parse_path("figure8")
    other = path.yaw[len(path.x) // 2]
    assert locate(path, 0.01, 0.0, yaw=other).s == pytest.approx(path.length / 2.0, abs=0.05)
    assert locate(path, 0.01, 0.0, yaw=0.0).s == pytest.approx(0.01, abs=0.01)
    path = parse_path("line:length=2")
    before, after = locate(path, -0.3, -0.4), locate(path, 2.3, 0.4)
    assert (after.s, after.e1, after.curvature) == (2.0, 0.4, 0.0)
    assert after.distance == pytest.approx(0.5)
    assert (before.s, before.e1) == (0.0, -0.4)


def test_interpolation_goes_round_and_holds_at_ends_and_angles_wrap() -> None:
    closed, line = parse_path("figure8"), parse_path("line:length=1")
    assert interpolate(closed, closed.curvature, closed.length) == closed.curvature[0]
    between = 0.5 * (closed.curvature[0] + closed.curvature[-1])
    assert interpolate(closed, closed.curvature, -0.5 * closed.step) == pytest.approx(between)
    assert (interpolate(line, line.x, -1.0), interpolate(line, line.x, 9.0)) == (0.0, 1.0)
    assert interpolate(line, line.x, 0.333) == pytest.approx(0.333)
    assert (wrap_angle(math.pi), wrap_angle(-math.pi)) == (math.pi, math.pi)
    assert wrap_angle(7.0) == pytest.approx(7.0 - math.tau)


@pytest.mark.parametrize(("changes", "said"), [
    ({"x": (0.0, 1.0)}, "at least 3"), ({"step": 0.0}, "positive step"),
    ({"yaw": (0.0,)}, "differ in length"), ({"y": (0.0, math.nan, 0.0)}, "not finite"),
])  # fmt: skip
def test_a_broken_path_is_refused(changes: dict[str, object], said: str) -> None:
    fields = dict.fromkeys(("y", "yaw", "curvature"), (0.0, 0.0, 0.0))
    fields |= {"name": "p", "step": 1.0, "closed": False, "x": (0.0, 1.0, 2.0)}
    with pytest.raises(ValueError, match=said):
        Path(**{**fields, **changes})


# Projection against a brute-force search on a fine resampling.
PATHS = {spec: parse_path(spec) for spec in ("circle:radius=1.3", "figure8", "line:length=5")}


def point_beside(path: Path, s: float, offset: float) -> tuple[float, float]:
    i = min(int(s / path.step), len(path.x) - 1)
    yaw = path.yaw[i]
    return path.x[i] - offset * math.sin(yaw), path.y[i] + offset * math.cos(yaw)


def brute_distance(path: Path, x: float, y: float) -> float:
    """Distance to the polygon through the samples (within k step^2 / 8 of the curve)."""
    points = np.column_stack([path.x, path.y])
    ends = np.roll(points, -1, axis=0) if path.closed else points[1:]
    points = points[: len(ends)]
    along = ends - points
    share = np.einsum("ij,ij->i", np.array([x, y]) - points, along) / np.sum(along**2, axis=1)
    nearest = points + np.clip(share, 0.0, 1.0)[:, None] * along
    return float(np.linalg.norm(np.array([x, y]) - nearest, axis=1).min())


@pytest.mark.parametrize("spec", PATHS)
@settings(max_examples=60, deadline=None, derandomize=True)
@given(share=st.floats(0.0, 0.999), offset=st.floats(-0.5, 0.5))
def test_offset_equals_brute_force(spec, share, offset):
    path = PATHS[spec]
    x, y = point_beside(path, share * path.length, offset)
    seen = locate(path, x, y)
    assert seen.distance == pytest.approx(brute_distance(path, x, y), abs=6e-5)
    assert abs(seen.e1) == pytest.approx(seen.distance, abs=1e-12)


@pytest.mark.parametrize("spec", PATHS)
@settings(max_examples=60, deadline=None, derandomize=True)
@given(share=st.floats(0.05, 0.95), offset=st.floats(-0.5, 0.5), behind=st.integers(-12, 12))
def test_the_hint_does_not_matter(spec, share, offset, behind):
    path = PATHS[spec]
    x, y = point_beside(path, share * path.length, offset)
    index = int(share * path.length / path.step)
    near = project(path, x, y, index)
    far = project(path, x, y, (index + behind) % len(path.x))
    assert far.e1 == pytest.approx(near.e1, abs=1e-6)
    assert (far.s - near.s + 1.0) % path.length == pytest.approx(1.0, abs=1e-4)
