"""Paper's method, CMA-ES, least squares and ours to the same held-out error, from one start.

The race of `identify.py` on its sixteen circles, shortened for `make bench`.
"""

import json
import sys
from typing import Any

import numpy as np

from benchmarks.identify import (
    FRICTIONS,
    TARGET_MM,
    Judge,
    circles,
    ours,
    ours_watched,
    search_timed,
)
from benchmarks.least_squares import fit_least_squares
from steerd.car_model.native.windows import make_kernels
from steerd.sysid.paper import PAPER_CAR_DIRECT
from steerd.sysid.paper.paper_method import (
    draw_starts,
    make_problem,
    paper_runs,
    search_adam,
    search_cma,
)


def row(judge: Judge, final: np.ndarray, seconds: float) -> dict[str, Any]:
    """Iterations and seconds to the mark, and the end."""
    reached = judge.reached()
    return {
        "iterations": reached and reached[0],
        "s": reached and round(reached[1], 3),
        "all_s": round(seconds, 3),
        "final_mm": round(judge.error_mm(final), 4),
        "slalom_mm": round(judge.slalom_mm(final), 4),
    }


def main() -> int:
    kernels = make_kernels()
    truth = PAPER_CAR_DIRECT._replace(mu=FRICTIONS["standard"])
    runs = circles(kernels, truth, np.random.default_rng(0))
    judge, start = Judge(kernels, truth), draw_starts(np.random.default_rng(1), 1)[0]
    problem = make_problem(paper_runs(runs), truth)
    searches = {
        "paper": lambda: search_timed(judge, lambda: search_adam(problem, start), best=False),
        "CMA-ES": lambda: search_timed(judge, lambda: search_cma(problem, start), best=True),
        "scipy least_squares": lambda: fit_least_squares(problem, start, judge.watch).final,
    }
    ours(runs, truth, start)  # compiled kernels in memory, for all methods
    found: dict[str, Any] = {}
    for name, search in searches.items():
        judge.start()
        final = search()
        found[name] = row(judge, final, judge.log[-1][1])
    final, seconds = ours_watched(judge, runs, truth, start)
    found["ours"] = row(judge, final, seconds)
    print(json.dumps({"target_mm": TARGET_MM, "methods": found}))
    return 0


if __name__ == "__main__":
    sys.exit(main())
