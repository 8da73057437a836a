"""Lists of cases: drawn from a nonce, frozen, sealed."""

import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from benchmarks.blind_gap.effects import COMMON_PAIRS
from benchmarks.blind_gap.seal import load_key, make_key, save_key, seal, sha256, unseal
from benchmarks.foreign_cars.cases import Case, read_case
from benchmarks.foreign_cars.drives import PUSH
from benchmarks.foreign_cars.plants import PLANTS, Plant, make_plant

Hidden = tuple[tuple[str, str], ...]
STRONG = ("medium", "large")


@dataclass(frozen=True, slots=True)
class Shares:
    """How many cases of a kind each plant gets, and how many cars they share."""

    nulls: int
    singles: int
    pairs: int = 0
    outside: int = 0
    cars: int = 4


def _in_turn(names: Sequence[str], count: int, rng: np.random.Generator) -> Iterator[str]:
    """Names in random order, all of them before any comes again."""
    order: list[str] = []
    for _ in range(count):
        if not order:
            order = [str(name) for name in rng.permutation(sorted(names))]
        yield order.pop()


def _hidden(plant: Plant, shares: Shares, rng: np.random.Generator) -> Iterator[Hidden]:
    """What is hidden, case by case."""
    for _ in range(shares.nulls):
        yield ()
    for name in _in_turn(tuple(plant.effects), shares.singles, rng):
        yield ((name, str(rng.choice(STRONG))),)
    pairs = [f"{a} {b}" for a, b in COMMON_PAIRS if {a, b} <= plant.effects]
    for pair in _in_turn(pairs, shares.pairs, rng):
        yield tuple((name, str(rng.choice(STRONG))) for name in pair.split())
    for name in _in_turn(tuple(plant.outside), shares.outside, rng):
        yield ((name, str(rng.choice(STRONG))),)


def draw_cases(
    nonce: int,
    shares: Shares,
    plants: Sequence[str] = PLANTS,
    temper: str = "rich",
    push: float = PUSH,
) -> list[Case]:
    """Cases of a nonce, shared out among the cars of each plant; no two nonces share a car.

    Their order is random: the first of them are a fair sample.

    Args:
        nonce: fixes the list.
        shares: how many of which kind.
        plants: of `PLANTS`.
        temper: of the drives.
        push: disturbances, per those of the blind test.
    """
    cases = []
    for name in plants:
        rng = np.random.default_rng([nonce, PLANTS.index(name)])
        cars = [int(seed) for seed in rng.integers(2**31, size=shares.cars)]
        for number, hidden in enumerate(_hidden(make_plant(name, cars[0]), shares, rng)):
            car = cars[number % len(cars)]
            cases.append(Case(name, car, number, hidden, temper, push=push))
    order = np.random.default_rng([nonce, len(PLANTS)]).permutation(len(cases))
    return [cases[i] for i in order]


def save_cases(path: Path, cases: Sequence[Case], sealed: bool = False) -> str:
    """Write a list, one case a line; its SHA-256.

    Args:
        path: the file; it must not exist.
        cases: the list.
        sealed: encrypt it; the key comes beside it, as `NAME.key`.

    Raises:
        FileExistsError: the file exists.
        OSError: it cannot be written.
    """
    text = "".join(json.dumps(asdict(case)) + "\n" for case in cases).encode()
    if sealed:
        key = make_key()
        save_key(path.with_name(path.name + ".key"), key)
        text = seal(text, key)
    with path.open("xb") as file:
        file.write(text)
    return sha256(text)


def load_cases(path: Path, key: Path | None = None) -> list[Case]:
    """Read a list.

    Args:
        path: the list.
        key: of a sealed list.

    Raises:
        OSError: it cannot be read.
        SealError: the key does not open it.
    """
    data = path.read_bytes()
    text = data if key is None else unseal(data, load_key(key))
    return [read_case(json.loads(line)) for line in text.decode().splitlines()]
