"""The search as a search: does any of many random starts end lower than it does?

    python -m benchmarks.search --starts 50 --jobs 2 rows.jsonl

Two drives of 12 s for each effect of the library at four sizes, from the least that matters to ten
times as much, and a base that is wrong by up to 5 standard deviations of what is known of it. A
hypothesis misses where a random start ends 0.5 nats lower, or where the base alone does. Rows are
appended as they come; what is there is not done again.
"""

import argparse
import json
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from joblib import Parallel, delayed

from steerd.car_model.effect import EffectParameter, Role
from steerd.car_model.effects import EFFECTS
from steerd.sysid.inference.augmented_car import make_augmented_car
from steerd.sysid.inference.hypotheses import explain
from steerd.sysid.inference.library import Library
from steerd.sysid.inference.likelihood import make_likelihood
from steerd.sysid.inference.noise import Noise
from steerd.sysid.inference.predictor import open_predictor
from steerd.sysid.inference.search import Point, minimise, stand, with_size
from steerd.sysid.inference.space import make_space, nuisance_names
from tests.unit.conftest import make_base, simulate_drives

NOISE = Noise((7e-4, 2e-3, 0.02, 0.05), (0.4, 0.4, 2.5), 1e-4)
"""Of the drives that are simulated."""
SIZES = (1.0, 2.15, 4.64, 10.0)
"""Of an effect per its least size."""
OFF = 5.0
"""Standard deviations by which a base is wrong at most."""
WORSE = 0.5
"""Nats by which an optimum counts as missed."""
SPREADS = 2.5
"""Prior standard deviations over which random starts are drawn, each way."""


def ordinary(p: EffectParameter) -> float:
    """An ordinary severity: the middle of what a scan tries, or one scale off the null."""
    return p.scan[len(p.scan) // 2] if p.scan else min(p.null + p.scale, 0.5 * (p.null + p.high))


@dataclass(frozen=True)
class Case:
    """An effect at a size [least sizes], and a seed of drives and base."""

    effect: str
    size: float
    seed: int

    @property
    def values(self) -> tuple[float, ...]:
        """Of the effect: its first size by the least one, or by its own scan where any counts."""
        effect = EFFECTS[self.effect]
        place = next(i for i, p in enumerate(effect.parameters) if p.role is Role.SIZE)
        moved, values = effect.parameters[place], [ordinary(p) for p in effect.parameters]
        if effect.least_size:
            away = self.size * effect.least_size
            away = away if moved.null + away <= moved.high else -away
            values[place] = float(np.clip(moved.null + away, moved.low, moved.high))
        else:
            at = SIZES.index(self.size) * (len(moved.scan) - 1) / (len(SIZES) - 1)
            values[place] = moved.scan[round(at)]
        return tuple(values)

    @property
    def text(self) -> str:
        """The effect as a command line has it."""
        return f"{self.effect}={','.join(f'{value:g}' for value in self.values)}"


def open_case(case: Case) -> Library:
    """The case's drives from a base that is off."""
    rng = np.random.default_rng([7, case.seed])
    runs = simulate_drives(case.text, runs=2, seconds=12.0, seed=case.seed)
    augmented = make_augmented_car(make_base(), runs)
    free = nuisance_names(augmented, runs)
    space = make_space(augmented, free)
    away = rng.standard_normal(len(space.centre))
    away *= rng.uniform(0.0, OFF) / np.linalg.norm(away)
    z = np.clip(space.centre + np.linalg.cholesky(space.covariance) @ away, space.low, space.high)
    augmented = replace(augmented, base=space.chart.parameters(z))
    engine = open_predictor(augmented, runs)
    x = engine.guess.copy()
    effects = tuple(e for e in augmented.effects if e.name == case.effect)
    return Library(make_likelihood(engine, augmented.base, x, NOISE), free, effects)


def search_at_random(library: Library, found: Point, case: Case, seed: int) -> float:
    """The cost where a random start ends [nats]; infinite where its simulation diverges."""
    rng, space, likelihood = np.random.default_rng([30, seed]), found.space, library.likelihood
    z = space.centre + space.spread * rng.uniform(-SPREADS, SPREADS, len(space.centre))
    own = slice(len(z) - len(case.values), None)
    nulls = np.array(EFFECTS[case.effect].nulls)
    z[own] = nulls + rng.uniform(0.0, 2.0, len(nulls)) * (np.array(case.values) - nulls)
    z, x = np.clip(z, space.low, space.high), likelihood.predictor.guess
    try:
        start = stand(likelihood, space, z, x, 20.0)
        size = likelihood.best_size(start.rotated, start.linear.error, start.x)
        return minimise(likelihood, with_size(likelihood, start, size)).cost
    except (FloatingPointError, np.linalg.LinAlgError):
        return np.inf


def judge(case: Case, starts: int) -> dict[str, object]:
    """What the search found, and the best of the random starts [nats]."""
    library = open_case(case)
    findings = explain(library, most=1)
    with_effect = [h.point for h in findings.hypotheses if h.effects]
    row: dict[str, object] = {"effect": case.effect, "size": case.size, "seed": case.seed}
    if not with_effect:
        return {**row, "looked": False, "left": findings.null.point.cost}
    found = with_effect[0]
    costs = [search_at_random(library, found, case, seed) for seed in range(starts)]
    nested = findings.null.point.cost
    return {**row, "looked": True, "found": found.cost, "best": min(costs), "nested": nested}


def missed(row: dict[str, object]) -> float:
    """How much lower an optimum lies than what was found [nats]."""
    return float(row["found"]) - min(float(row["best"]), float(row["nested"]))  # type: ignore[arg-type]


def describe(rows: list[dict[str, object]]) -> Iterable[str]:
    """How many were found, and which were not."""
    looked = [row for row in rows if row["looked"]]
    bad = [row for row in looked if missed(row) > WORSE]
    yield f"{len(rows)} cases, {len(looked)} fitted, {len(looked) - len(bad)} at the best optimum"
    for row in sorted(bad, key=missed, reverse=True):
        yield f"  {row['effect']} x {row['size']} (seed {row['seed']}): {missed(row):.1f} nats"
    small = [f"{row['effect']} x {row['size']}" for row in rows if not row["looked"]]
    yield f"not fitted, nothing to gain at a look: {', '.join(small) or 'none'}"


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("rows", type=Path)
    parser.add_argument("--starts", type=int, default=50)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    text = args.rows.read_text() if args.rows.exists() else ""
    rows = [json.loads(line) for line in text.splitlines()]
    done = {(row["effect"], row["size"], row["seed"]) for row in rows}
    cases = [Case(name, size, args.seed) for name in EFFECTS for size in SIZES]
    left = [case for case in cases if (case.effect, case.size, case.seed) not in done]
    work = Parallel(n_jobs=args.jobs, return_as="generator_unordered")
    with args.rows.open("a") as file:
        for row in work(delayed(judge)(case, args.starts) for case in left):
            file.write(json.dumps(row) + "\n")
            file.flush()
            rows.append(row)
    print("\n".join(describe(rows)))


if __name__ == "__main__":
    main()
