"""Write a set: sessions of every case, healthy sessions of every car, a manifest, sealed labels."""

import json
import secrets
from collections.abc import Iterable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
from joblib import Parallel, delayed
from rich.progress import Progress

from benchmarks.blind_gap.bank import CARS, ROUTES, Case, Source, make_plan, needs_place
from benchmarks.blind_gap.car import MISMATCH, PlantCar, make_car
from benchmarks.blind_gap.drives import LEAD, make_noise, make_orders, make_route, make_start
from benchmarks.blind_gap.effects import EFFECTS, OUTSIDE, SIZES, Place, draw_place
from benchmarks.blind_gap.plant import Array, simulate
from benchmarks.blind_gap.seal import make_key, save_key, seal, sha256
from benchmarks.blind_gap.sessions import Run, make_run, reverse_run, swap_commands, write_run

HEALTHY_RUNS, HEALTHY_SECONDS = 8, 15.0
_PAUSE_NS = 60_000_000_000
"""Between the starts of two runs, beyond their length [ns]."""

Json = dict[str, Any]


def load_car(source: Source, number: int) -> PlantCar:
    """A car of the set; those after `CARS` are structurally unlike the base model."""
    return make_car(source.rng("car", number), MISMATCH if number < CARS else 1.0)


def hidden_car(car: PlantCar, case: Case, place: Place) -> tuple[PlantCar, list[Json]]:
    """The car with what the case hides, and the label of each hidden effect."""
    labels = []
    for truth in case.truths:
        effect = EFFECTS[truth.effect]
        values = effect.null if case.control == "zero" else effect.values(truth.strength, place)
        car = effect.apply(car, values)
        labels.append({**asdict(truth), "family": effect.family, "parameters": values})
    if case.outside:
        car = OUTSIDE[case.outside].apply(car, outside_strength(case), place)
    return car, labels


def outside_strength(case: Case) -> float:
    """Strength of the case's defect outside the contract; 0 without one."""
    return OUTSIDE[case.outside].table[SIZES.index(case.size)] if case.outside else 0.0


def _route(case: Case, rng: np.random.Generator) -> Array | None:
    return make_route(case.route, rng) if case.route else None


def make_runs(source: Source, case: Case) -> tuple[list[Run], list[Json]]:
    """Every run of a case, and the labels of its effects."""
    rng = source.rng("case", case.seed)
    route, place = _route(case, rng), draw_place(rng)
    if route is not None and needs_place(case):
        x, y = route[int(rng.integers(len(route))), :2]
        place = replace(place, x=float(x), y=float(y))
    car, labels = hidden_car(load_car(source, case.car), case, place)
    strength = outside_strength(case)
    kind = OUTSIDE.get(case.outside)
    freeze, cut, jitter = (kind.freeze, kind.cut, kind.jitter) if kind else (0.0, 0.0, 0.0)
    runs = []
    for _ in range(case.runs):
        orders = make_orders(
            case.drive, case.seconds, rng, route, freeze * strength, cut * strength
        )
        start, noise = make_start(orders, rng), make_noise(case.seconds, rng, case.pose_noise)
        runs.append(
            make_run(car, simulate(car, start, LEAD, orders, noise), rng, jitter * strength)
        )
    return _controlled(case, runs), labels


def _controlled(case: Case, runs: list[Run]) -> list[Run]:
    """The runs as a control spoils them."""
    if case.control == "shuffled":
        return [
            swap_commands(run, other) for run, other in zip(runs, runs[1:] + runs[:1], strict=True)
        ]
    return [reverse_run(run) for run in runs] if case.control == "reversed" else runs


def healthy_runs(source: Source, number: int) -> list[Run]:
    """Rich drives of a car with nothing wrong, five open-loop and three on routes."""
    car, rng = load_car(source, number), source.rng("healthy", number)
    runs = []
    for index in range(HEALTHY_RUNS):
        route = make_route(ROUTES[index - 5], rng) if index >= 5 else None
        orders = make_orders("rich", HEALTHY_SECONDS, rng, route)
        start, noise = make_start(orders, rng), make_noise(HEALTHY_SECONDS, rng)
        runs.append(make_run(car, simulate(car, start, LEAD, orders, noise), rng))
    return runs


def _write(out: Path, folder: str, runs: Iterable[Run], flavour: str) -> dict[str, str]:
    """Write runs; give file names, relative to the set, with their SHA-256."""
    (out / folder).mkdir(parents=True)
    files, offset_ns = {}, 0
    for index, run in enumerate(runs, start=1):
        name = f"{folder}/run-{index}.mcap"
        write_run(out / name, run, flavour, offset_ns)
        files[name] = sha256((out / name).read_bytes())
        offset_ns += int(run.t_ns[-1]) + _PAUSE_NS
    return files


def write_case(source: Source, case: Case, out: Path) -> tuple[Json, Json]:
    """Write one case; give its row of the manifest and its label."""
    runs, labels = make_runs(source, case)
    files = _write(out, case.name, runs, case.flavour)
    names = list(files)
    public = {
        "case": case.name,
        "base": _car_name(case.car),
        "runs": names[: case.runs - case.held_out],
        "held_out": names[case.runs - case.held_out :],
        "sha256": files,
    }
    return public, {**asdict(case), "truths": labels}


def write_car(source: Source, number: int, out: Path) -> Json:
    """Write a car's healthy sessions; give its row of the manifest."""
    flavour = "vesc" if number % 2 else "wheel"
    name = _car_name(number)
    files = _write(out, f"cars/{name}", healthy_runs(source, number), flavour)
    return {"base": name, "runs": list(files), "sha256": files}


def _car_name(number: int) -> str:
    return f"car-{number + 1:02d}"


def generate(
    set_name: str,
    out: Path,
    limit: int | None = None,
    nonce: int | None = None,
    jobs: int = 1,
    blocks: tuple[str, ...] = (),
    cars: int = CARS,
    whole: tuple[str, ...] = (),
) -> Path:
    """Write a set.

    Args:
        set_name: `tuning` or `report`.
        out: a folder that does not exist yet.
        limit: number of cases; every part of the bank keeps its share.
        nonce: fixes the set; drawn for `report`, 0 for `tuning` if left out.
        jobs: processes.
        blocks: only parts of the bank whose names start so; all if empty.
        cars: number of cars that the cases are shared out among.
        whole: parts that are kept whole, whatever the limit.

    Returns:
        The manifest.

    Raises:
        OSError: the folder exists or the disk does not take it.
    """
    if nonce is None:
        nonce = secrets.randbits(63) if set_name == "report" else 0
    source = Source(set_name, nonce)
    plan = make_plan(source, limit, blocks, cars, whole)
    out.mkdir(parents=True)
    numbers = sorted({case.car for case in plan})
    tasks = [delayed(write_car)(source, number, out) for number in numbers]
    rows = _progress(tasks, "healthy cars", jobs)
    tasks = [delayed(write_case)(source, case, out) for case in plan]
    done = _progress(tasks, f"cases of {set_name}", jobs)
    manifest = {
        "schema": "blind_gap.manifest/1",
        "set": set_name,
        "cars": sorted(rows, key=lambda row: row["base"]),
        "cases": sorted((public for public, _ in done), key=lambda row: row["case"]),
    }
    labels = {
        "set": set_name,
        "nonce": nonce,
        "limit": limit,
        "blocks": list(blocks),
        "cars": cars,
        "whole": list(whole),
        "cases": [label for _, label in done],
    }
    return _save(out, manifest, labels)


def _progress(tasks: list[Any], title: str, jobs: int) -> list[Any]:
    results = []
    with Progress(transient=True) as progress:
        bar = progress.add_task(title, total=len(tasks))
        for result in Parallel(n_jobs=jobs, return_as="generator_unordered")(tasks):
            results.append(result)
            progress.advance(bar)
    return results


def _save(out: Path, manifest: Json, labels: Json) -> Path:
    """Write labels, sealed for `report`, and the manifest that commits to them."""
    labels["cases"].sort(key=lambda label: label["name"])
    text = json.dumps(labels, indent=1).encode()
    if manifest["set"] == "report":
        key = make_key()
        save_key(key_path(out), key)
        text = seal(text, key)
        (out / "labels.sealed").write_bytes(text)
        (out / "labels.sealed.sha256").write_text(f"{sha256(text)}  labels.sealed\n")
    else:
        (out / "labels.json").write_bytes(text)
    manifest["labels_sha256"] = sha256(text)
    path = out / "manifest.json"
    path.write_text(json.dumps(manifest, indent=1) + "\n")
    return path


def key_path(out: Path) -> Path:
    """Where a set's key lies: beside its folder, so that a copy of the folder stays sealed."""
    return out.with_name(out.name + ".key")
