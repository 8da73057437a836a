"""The bank of cases: which effects, how strong, on which cars and drives, with which seeds.

Two sets that never meet: the set's name is the first word of every seed, so no car, drive or noise
of `tuning` can appear in `report`. A set is a pure function of its name and its nonce.
"""

# Why: docs/decisions/diagnosis.md#d54

import hashlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np

from benchmarks.blind_gap.detectability import load_severities
from benchmarks.blind_gap.effects import COMMON_PAIRS, EFFECTS, OUTSIDE, SIZES

SETS = ("tuning", "report")
CARS, STRUCTURAL_CARS = 20, 2
SEEDS = 5
RUNS, SECONDS, HELD_OUT = 8, 12.0, 2
ROUTES = ("oval", "eight", "bean")
OTHER_ROUTE = "star"
_FLAVOURS, _FLAVOUR_SHARE = ("vesc", "wheel", "bare"), (0.5, 0.3, 0.2)


@dataclass(frozen=True, slots=True)
class Truth:
    """One hidden effect: its name, size, on which scale, and strength (see `effects.Hidden`)."""

    effect: str
    size: str
    scale: str
    strength: float


@dataclass(frozen=True, slots=True)
class Case:
    """One session to diagnose and what is hidden in it.

    Attributes:
        name: opaque, given after shuffling.
        kind: `single`, `pair`, `null`, `outside`, `control` or `structural`.
        block: part of the bank, for the report.
        truths: hidden effects of the contract.
        outside: hidden defect outside the contract, or empty.
        size: severity of the defect outside.
        control: `shuffled`, `reversed`, `zero` or empty.
        drive: `rich`, `medium` or `gentle`.
        route: route lapped in closed loop, or empty.
        seconds: length of each run [s].
        runs: number of runs; the last `held_out` are reserved.
        pose_noise: scale of the mocap errors.
        flavour: which instruments the sessions hold.
        car: number of the car; structural ones come after the others.
        seed: number of the case within its set.
    """

    kind: str
    block: str
    name: str = ""
    truths: tuple[Truth, ...] = ()
    outside: str = ""
    size: str = ""
    control: str = ""
    drive: str = "rich"
    route: str = ""
    seconds: float = SECONDS
    runs: int = RUNS
    held_out: int = HELD_OUT
    pose_noise: float = 1.0
    flavour: str = "vesc"
    car: int = 0
    seed: int = 0


@dataclass(frozen=True, slots=True)
class Source:
    """Where a set's randomness comes from: its name first, then its nonce."""

    set_name: str
    nonce: int = 0
    strengths: dict[str, dict[str, float]] = field(default_factory=load_severities)

    def rng(self, *place: int | str) -> np.random.Generator:
        """The generator of one place of the set, such as ("car", 3).

        Raises:
            ValueError: there is no such set.
        """
        if self.set_name not in SETS:
            raise ValueError(f"no set {self.set_name!r}: {' or '.join(SETS)}")
        words = [_word(part) for part in (self.set_name, self.nonce, *place)]
        return np.random.default_rng(np.random.SeedSequence(words))


def _word(part: int | str) -> int:
    """A number of a seed; different words of different texts."""
    if isinstance(part, int):
        return part
    return int.from_bytes(hashlib.sha256(part.encode()).digest()[:8], "little")


def _truth(source: Source, effect: str, size: str, scale: str) -> Truth:
    """An effect at a size: by detectability, or by the table of published magnitudes.

    Detectability was measured away from any one spot, so effects of a place use the table.
    """
    hidden = EFFECTS[effect]
    if scale == "multiple" and not hidden.needs_place:
        return Truth(effect, size, "multiple", source.strengths[effect][size])
    return Truth(effect, size, "table", hidden.table[SIZES.index(size)])


def _scale(number: int) -> str:
    return "multiple" if number % 2 == 0 else "table"


def _singles(source: Source) -> Iterator[Case]:
    for number, effect in enumerate(EFFECTS):
        for size in SIZES:
            for seed in range(SEEDS):
                truth = _truth(source, effect, size, _scale(seed))
                yield Case("single", "single-rich", truths=(truth,))
            truth = _truth(source, effect, size, _scale(number))
            yield Case("single", "single-medium", truths=(truth,), drive="medium")
        for size in SIZES[1:]:
            truth = _truth(source, effect, size, _scale(number + 1))
            yield Case("single", "single-gentle", truths=(truth,), drive="gentle")
            route = ROUTES[number % len(ROUTES)]
            yield Case("single", "single-closed", truths=(truth,), route=route)
        truth = _truth(source, effect, "medium", "table")
        length = (30.0, 60.0, 120.0)[number % 3]
        yield Case(
            "single", "single-long", truths=(truth,), seconds=length, runs=1, held_out=0
        )  # fmt: skip


def _nulls(source: Source) -> Iterator[Case]:
    yield from (Case("null", "null-rich") for _ in range(40))
    yield from (Case("null", "null-medium", drive="medium") for _ in range(15))
    yield from (Case("null", "null-gentle", drive="gentle") for _ in range(15))
    yield from (Case("null", "null-noise", pose_noise=2.0) for _ in range(15))
    yield from (Case("null", "null-closed", route=ROUTES[i % 3]) for i in range(15))
    yield from (Case("null", "null-route", route=OTHER_ROUTE) for _ in range(15))
    for length in (30.0, 60.0, 120.0) * 2:
        yield Case("null", "null-long", seconds=length, runs=1, held_out=0)


def _pairs(source: Source) -> Iterator[Case]:
    drawn = list(combinations(EFFECTS, 2))
    picks = source.rng("pairs").permutation(len(drawn))[:48]
    for number, pair in enumerate([*COMMON_PAIRS, *(drawn[i] for i in picks)]):
        size = SIZES[1 + number % 2]
        truths = tuple(_truth(source, effect, size, "table") for effect in pair)
        block = "pair-common" if number < len(COMMON_PAIRS) else "pair-random"
        yield Case("pair", block, truths=truths)


def _outside(source: Source) -> Iterator[Case]:
    for name in OUTSIDE:
        for size in SIZES:
            yield Case("outside", "outside-rich", outside=name, size=size)
        yield Case("outside", "outside-closed", outside=name, size="large", route="oval")


def _controls(source: Source) -> Iterator[Case]:
    yield from (Case("control", "control-shuffled", control="shuffled") for _ in range(6))
    yield from (Case("control", "control-reversed", control="reversed") for _ in range(6))
    for effect in source.rng("zero").permutation(list(EFFECTS))[:12]:
        truth = Truth(str(effect), "zero", "zero", 0.0)
        yield Case("control", "control-zero", truths=(truth,), control="zero")


def _structural(source: Source) -> Iterator[Case]:
    yield from (Case("structural", "structural") for _ in range(8))


_PARTS: tuple[Callable[[Source], Iterator[Case]], ...] = (
    _singles, _nulls, _pairs, _outside, _controls, _structural,
)  # fmt: skip


def _filled(source: Source, case: Case, seed: int, cars: int) -> Case:
    """The case with its car, flavour and a route where a spot on the floor is needed."""
    rng = source.rng("fill", seed)
    car = int(rng.integers(CARS)) % cars
    if case.kind == "structural":
        car = CARS + int(rng.integers(STRUCTURAL_CARS))
    flavour = str(rng.choice(_FLAVOURS, p=_FLAVOUR_SHARE))
    route = case.route or (str(rng.choice(ROUTES)) if needs_place(case) else "")
    return replace(case, seed=seed, car=car, flavour=flavour, route=route)


def needs_place(case: Case) -> bool:
    """Whether what is hidden lies somewhere on the floor."""
    places = [EFFECTS[truth.effect].needs_place for truth in case.truths]
    return any(places) or (bool(case.outside) and OUTSIDE[case.outside].needs_place)


def make_plan(
    source: Source,
    limit: int | None = None,
    blocks: tuple[str, ...] = (),
    cars: int = CARS,
    whole: tuple[str, ...] = (),
) -> list[Case]:
    """The set's cases under opaque names; `limit` keeps every part's share of the whole.

    Every case has a rank between 0 and 1, spread evenly within its block; the first `limit` ranks
    stay, and names are dealt out after shuffling, so that neither says what a case is. `blocks`
    keeps only those whose name starts with one of them; cases keep their seeds. Fewer `cars` than
    `CARS` share the cases out among the first of them: each car is identified once. Blocks that
    start with one of `whole` are kept whole, whatever the limit leaves of the others.
    """
    cases = [case for part in _PARTS for case in part(source)]
    cases = [_filled(source, case, seed, cars) for seed, case in enumerate(cases)]
    cases = [case for case in cases if not blocks or case.block.startswith(blocks)]
    rng, ranks = source.rng("order"), np.empty(len(cases))
    of_case = np.array([case.block for case in cases])
    for block in sorted({case.block for case in cases}):
        members = rng.permutation(np.flatnonzero(of_case == block))
        ranks[members] = (np.arange(len(members)) + rng.random(len(members))) / len(members)
        if whole and block.startswith(whole):
            ranks[members] = 0.0
    kept = np.argsort(ranks)[:limit]
    mixed = rng.permutation(kept)
    return [replace(cases[i], name=f"case-{n:04d}") for n, i in enumerate(mixed, start=1)]
