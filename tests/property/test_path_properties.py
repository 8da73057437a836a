"""Projection against a brute-force search on a fine resampling."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from steerd.car_model.path.path import Path, locate, project
from steerd.car_model.path.path_spec import parse_path

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
