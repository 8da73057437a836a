"""Where compiled models live: names that follow the equations, writers side by side."""

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from steerd.car_model.effects import find_effect
from steerd.sysid.compiler import simd_math
from steerd.sysid.compiler.modules import load_module, module_source


def test_one_file_per_model_whoever_writes_it(tmp_path, monkeypatch):
    monkeypatch.setenv("STEERD_CACHE", str(tmp_path))
    load = load_module.__wrapped__
    with ThreadPoolExecutor(8) as pool:
        paths = {made.__file__ for made in pool.map(lambda _: load(), range(16))}
    assert len(paths) == 1
    files = [p for p in (tmp_path / "kernels").iterdir() if p.is_file()]
    assert [str(p) for p in files] == list(paths)
    other = load((find_effect("steer_bias"),)).__file__
    assert other not in paths
    assert Path(other).read_text(encoding="utf-8") == module_source((find_effect("steer_bias"),))


def test_simd_functions_are_good_to_the_last_places():
    x = np.linspace(-40.0, 40.0, 4001)
    for name in ("sin", "cos", "tan"):
        ours = np.array([getattr(simd_math, name)(v) for v in x])
        assert np.abs(ours - getattr(np, name)(x)).max() < 4e-16 * (1.0 + np.abs(ours).max() ** 2)
    ours = np.array([simd_math.atan(v) for v in x])
    assert np.abs(ours - np.arctan(x)).max() < 4e-16
