"""How soon a car that does not do as ordered is found: `python -m benchmarks.shown`.

A fault of motor or servo can hide: a servo that is stuck straight ahead is right on a straight. It
shows when the true motion leaves what cars off their file by 20 % make of the same orders, by more
than the instruments' noise. The same bytes are therefore given to a family of healthy cars, drawn
and at the corners of the range, and the envelope of their motion is compared with the truth.
Writes the table of docs/results/safety.md.
"""

import copy
import os
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from math import hypot, inf
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from joblib import Parallel, delayed

from benchmarks.no_false_stop import draw_car, load_identified
from steerd.car_model.params import Car
from steerd.car_model.state import Command
from steerd.daemon.assembly.build import make_world_config
from steerd.daemon.loop.follow_model import make_follow_model
from steerd.daemon.loop.following import follow_span
from steerd.sim_hw.world import World
from tests.safety import catalogue_car as car
from tests.safety.report import replace_section
from tests.safety.rig import MS, Rig, make_rig, twin

OFF = 0.2
DRAWN = 4
LONGEST_S = 4.0
FAULTS = {
    "wheels accelerate by 2 m/s2": car.run_away,
    "motor dead": car.die,
    "steering stays where it is": car.stick,
    "servo turns the other way": car.reverse,
    "servo ten times slower": car.slow_down,
}
DRIVES = (
    ("line", 2.0, 3.0), ("figure8", 1.0, 4.0), ("figure8", 2.0, 4.5),
    ("figure8:radius=2", 2.5, 4.0), ("steps", 1.5, 3.0),
)  # fmt: skip
"""Path, speed [m/s], and when the fault strikes [s] after the start.

`steps` is a straight on which something else than the lane keeper steers by `STEP`, left and right.
"""
STEP, STEP_S = 0.15, 0.5  # angle [rad] and duration [s] of a step
PAGE = Path(__file__).parents[1] / "docs" / "results" / "safety.md"
_GROUPS = (
    ("steer_gain",), ("lf", "lr"), ("steer_lag", "steer_delay", "speed_lag"),
    ("steer_rate", "accel_max", "decel_max"), ("c_sf", "mu"), ("c_sr",), ("inertia_z", "mass"),
)  # fmt: skip


@dataclass(frozen=True)
class Found:
    """A fault in one drive; times from its beginning [s], `way` from when it showed [m]."""

    fault: str
    path: str
    speed: float
    shown: float
    found: float
    way: float
    by: str

    @property
    def good(self) -> bool:
        """Found within 0.3 s and 0.3 m of showing, or never shown."""
        return self.shown == inf or (self.found - self.shown <= 0.3 and self.way <= 0.3)


def make_family(nominal: Car[float], drawn: int) -> Iterator[Car[float]]:
    """Cars at corners of the range (a two-level design of eight) and within it."""
    for k in range(8):
        a, b, c = (2 * (k >> bit & 1) - 1 for bit in range(3))
        signs = (a, b, c, a * b, a * c, b * c, a * b * c)
        changed = {
            name: getattr(nominal, name) * (1.0 + OFF * sign)
            for group, sign in zip(_GROUPS, signs, strict=True)
            for name in group
        }
        yield nominal._replace(**changed)
    for seed in range(drawn):
        yield draw_car(nominal, OFF, seed)


def feed(world: World, rig: Rig, since: int) -> Iterator[tuple[int, float, float]]:
    """A healthy car under the rig's bytes; (time, speed, curvature) after each write."""
    for entry in rig.run.world.log[since:]:
        if entry.to == "vesc":
            world.advance(entry.t_ns)
            world.serial_read(entry.t_ns)
            world.serial_write(entry.t_ns, entry.data)
            state = world.car.state
            yield entry.t_ns, state.speed, state.yaw_rate / max(state.speed, 0.1)


def start(path: str, speed: float, after_s: float) -> Rig:
    """A drive up to the moment of the fault."""
    rig = make_rig("line" if path == "steps" else path, speed, load_identified(speed))
    rig.drive_off(after_s)
    return rig


def swerve(rig: Rig) -> None:
    """From now on the wish is a step to the left, one to the right, and so on."""
    t0 = rig.t_ns

    def step(wanted: Command[float] | None) -> Command[float] | None:
        side = 1.0 if (rig.t_ns - t0) / 1e9 % (2.0 * STEP_S) < STEP_S else -1.0
        return wanted and Command(side * STEP, wanted.speed)

    car.wish_for(rig, step)


def judge_drive(path: str, speed: float, after_s: float, drawn: int = DRAWN) -> list[Found]:
    """Every fault at one moment of a drive."""
    base = start(path, speed, after_s)
    plain = make_world_config(base.plan)
    family = [
        World(replace(plain, model=plain.model._replace(car=member), keep_bytes=False))
        for member in make_family(plain.model.car, drawn)
    ]
    for world in family:
        for _ in feed(world, base, 0):
            pass
    return [judge_fault(name, base, family, path, speed) for name in FAULTS]


def judge_fault(name: str, base: Rig, family: Sequence[World], path: str, speed: float) -> Found:
    """One fault: when it shows and when it is found."""
    rig = twin(base)
    log = rig.run.world.log
    seen, since, t_fault = len(rig.notes.transitions), len(log), rig.t_ns
    rig.track.clear()
    if path == "steps":
        swerve(rig)
    FAULTS[name](rig)
    truth = {}
    while rig.t_ns < t_fault + round(LONGEST_S * 1e9) and len(rig.notes.transitions) == seen:
        state = rig.run.world.car.state
        truth[rig.t_ns] = (state.speed, state.yaw_rate)
        rig.step()
    followed = rig.notes.transitions[seen:]
    found_ns = followed[0][0] if followed else t_fault + round(LONGEST_S * 1e9)
    shown_ns = find_shown(rig, [copy.deepcopy(world) for world in family], since, truth)
    if shown_ns is None:
        found = (found_ns - t_fault) / 1e9 if followed else inf
        return Found(name, path, speed, inf, found, 0.0, describe(followed))
    way = sum(
        hypot(b.x - a.x, b.y - a.y)
        for a, b in pairwise(rig.track)
        if shown_ns <= a.t_ns and b.t_ns <= found_ns + 2 * MS
    )
    found = (found_ns - t_fault) / 1e9 if followed else inf
    return Found(name, path, speed, (shown_ns - t_fault) / 1e9, found, way, describe(followed))


def describe(followed: Sequence[tuple[int, object]]) -> str:
    """Which watchdog found it."""
    return str(getattr(followed[0][1], "text", "")).split(":")[0] if followed else "nobody"


def find_shown(
    rig: Rig, family: Sequence[World], since: int, truth: dict[int, tuple[float, float]]
) -> int | None:
    """When the true motion first leaves the family's envelope by more than the noise."""
    settings = rig.plan.settings
    th = settings.thresholds
    model = make_follow_model(settings.file.car, settings.file.sd, settings.filter, th)
    for moment in zip(*(feed(world, rig, since) for world in family), strict=True):
        t_ns = moment[0][0]
        if t_ns not in truth:
            continue
        speed, yaw_rate = truth[t_ns]
        speeds, bends = ([row[column] for row in moment] for column in (1, 2))
        margin = model.turn_margin / follow_span(th, speed)
        off = max(speed - max(speeds), min(speeds) - speed) - model.speed_margin
        turned = max(yaw_rate - max(bends) * speed, min(bends) * speed - yaw_rate) - margin
        if off > 0.0 or turned > 0.0:
            return t_ns
    return None


def write_table(found: Sequence[Found]) -> list[str]:
    """One line a fault, one column a drive."""
    drives = list(dict.fromkeys((f.path, f.speed) for f in found))
    titles = [f"{path}, {speed:g} m/s" for path, speed in drives]
    lines = ["| fault | " + " | ".join(titles) + " |", "|---|" + "---|" * len(drives)]
    for fault in dict.fromkeys(f.fault for f in found):
        cells = [_cell(f) for drive in drives for f in found
                 if f.fault == fault and (f.path, f.speed) == drive]  # fmt: skip
        lines.append(f"| {fault} | " + " | ".join(cells) + " |")
    return lines


def _cell(f: Found) -> str:
    """When it showed, how much later it was found, the way until then, by which watchdog."""
    by = f.by.split()[0]
    if f.shown == inf:
        return "not shown" if by == "nobody" else f"not shown; {by}"
    return f"{f.shown:.2f} + {max(0.0, f.found - f.shown):.2f} s, {f.way:.2f} m, {by}"


def main() -> int:
    """Entry point."""
    parts = Parallel(n_jobs=-1)(delayed(judge_drive)(*drive) for drive in DRIVES)
    found = [one for part in parts for one in part]
    lines = write_table(found)
    print(*lines, sep="\n")
    text = PAGE.read_text(encoding="utf-8")
    PAGE.write_text(replace_section(text, "shown", lines), encoding="utf-8")
    return 0 if all(one.good for one in found) else 1


if __name__ == "__main__":
    sys.exit(main())
