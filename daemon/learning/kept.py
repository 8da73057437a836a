"""What a learner keeps beside the car file from one run to the next; no numerics are loaded here.

A TOML page: of which car and which numbers of its file it is, when and in which session it was
learnt, each number with its standard deviation, and the changes. Its first line is a digest of the
rest, so a torn or edited page is recognised.
"""

# Why: docs/decisions/diagnosis.md#d87

import hashlib
import json
import sys
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import Any, NamedTuple

from steerd.car_model.car_file import CarFile, default_car_path
from steerd.daemon.assembly.build import RunPlan
from steerd.daemon.assembly.session_meta import data_folder
from steerd.daemon.common.errors import SteerdError
from steerd.daemon.common.screen import NBSP, print_labelled
from steerd.daemon.common.written import write_output, write_whole
from steerd.daemon.learning.reported import describe_change, reported_changes, reported_values
from steerd.steer_bus import messages as m
from steerd.toml_text import parse_toml
from steerd.version import VERSION
from steerd.vesc_link.scaling import Scaling

METADATA = "steerd.learner"  # of a session whose learner began with an earlier drive's numbers
SIZE_MAX = 100_000  # a kept page is small; what is larger is something else [bytes]
AHEAD_NS = 60_000_000_000
"""A page this much younger than now is one from the future: less is a clock that was set."""
DAY_NS = 86_400_000_000_000
EVERY_NS = 60_000_000_000  # drive time between two writings
_HEAD = "# sha256 "
_ABOUT = "# What steerd learnt while driving; written anew by `steerd run --learn`.\n"


class KeptError(ValueError):
    """A page that cannot be used; the text is what is wrong and what to try."""


class About(NamedTuple):
    """Of what a page is."""

    car: str  # the car's name
    numbers: str  # digest of the car file's numbers, see `digest_numbers`
    version: str  # of steerd
    session: str  # the file's name


class Kept(NamedTuple):
    """A page that was read: of what, when [UNIX ns], and (value, standard deviation) by name."""

    about: About
    written_ns: int
    values: dict[str, tuple[float, float]]


def digest_numbers(car: CarFile, scaling: Scaling) -> str:
    """SHA-256 of everything in a car file that gives learnt numbers their meaning.

    Comments, gains and limits may be edited; another wheel, tyre or effect is another car.
    """
    numbers = {
        "chassis": [car.chassis.name, car.chassis.drive],
        "car": car.car._asdict(),
        "effects": {e.name: v for e, v in zip(car.effects, car.values, strict=True)},
        "sd": dict(car.sd),
        "learnt": {name: car.sections.get(name, {}) for name in ("knowledge", "noise")},
        "scaling": [scaling.erpm_gain, scaling.erpm_offset],
    }
    return _digest(json.dumps(numbers, sort_keys=True, default=str).encode())


def format_kept(about: About, report: m.Model) -> str:
    """The page of a report of a learner that knows the car: what it identifies, and each change."""
    lines = [f"{name} = {json.dumps(text)}" for name, text in about._asdict().items()]
    lines += [f"written_ns = {m.stamp_ns(report.header)}", "changes = ["]
    for change in reported_changes(report):
        text = describe_change(report, change).replace(NBSP, " ")
        lines.append(f"  {json.dumps(text, ensure_ascii=False)},")
    lines += ["]", "", "[values]"]
    for value in reported_values(report):
        if value.identifiable and isfinite(value.value) and value.sd > 0.0 and isfinite(value.sd):
            pair = f"[{float(value.value)!r}, {float(value.sd)!r}]"
            lines.append(f"{json.dumps(value.name)} = {pair}  # {value.unit}")
    body = _ABOUT + "\n".join(lines) + "\n"
    return f"{_HEAD}{_digest(body.encode())}\n{body}"


def _digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def parse_kept(data: bytes) -> Kept:
    """Read a page.

    Raises:
        KeptError: it is torn, edited, or none.
    """
    head, _, body = data.partition(b"\n")
    if len(data) > SIZE_MAX or head.decode(errors="replace") != _HEAD + _digest(body):
        raise KeptError("is torn or was edited; this drive writes it anew")
    try:
        page: dict[str, Any] = parse_toml(body.decode())
        about = About(*(str(page[name]) for name in About._fields))
        values = {name: (float(v), float(sd)) for name, (v, sd) in page["values"].items()}
        return Kept(about, int(page["written_ns"]), values)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise KeptError("is not what steerd writes; move it elsewhere") from error


def recall(kept: Kept, about: About, now_ns: int) -> str:
    """What the metadata of a run at a UNIX time says of the numbers its learner begins with: JSON.

    Raises:
        KeptError: it is another car's, or of other numbers, or from the future.
    """
    if kept.about.car != about.car:
        raise KeptError(f"is of {kept.about.car}, not of {about.car}; give each car its own file")
    if kept.about.numbers != about.numbers:
        raise KeptError("is of other numbers: the car file was edited since; drive to learn anew")
    if kept.written_ns > now_ns + AHEAD_NS:
        raise KeptError("is from the future; set this machine's clock (`date`)")
    days = max(now_ns - kept.written_ns, 0) / DAY_NS
    return json.dumps({"days": days, "values": kept.values}, separators=(",", ":"))


class LearnerMemory(NamedTuple):
    """Where a run's learner keeps what it learns, and what it begins with."""

    page: str = ""  # the file; empty for simulated hardware, whose numbers are no car's
    about: About = About("", "", "", "")  # of what it is
    memory: str = ""  # JSON of what it begins with, empty for the car file alone
    # Whether a page is there that cannot be used; it is not overwritten but moved aside
    refused: bool = False
    metadata: dict[str, dict[str, str]] = {}  # what the session says of it  # noqa: RUF012


def learnt_page(plan: RunPlan) -> Path:
    """`car.learnt.toml` beside `car.toml`; for the car that steerd brings, in the data folder."""
    path = plan.settings.file.path
    if path == default_car_path():
        return data_folder() / f"{plan.options.car}.learnt.toml"
    return path.with_name(f"{path.stem}.learnt.toml")


def recall_learnt(plan: RunPlan, session: Path, now_ns: int) -> LearnerMemory:
    """What the run's learner begins with at a UNIX time; a page of no use is named on stderr."""
    if not plan.options.learn or plan.options.simulated:
        return LearnerMemory()
    page, numbers = learnt_page(plan), digest_numbers(plan.settings.file, plan.settings.scaling)
    about = About(plan.options.car, numbers, VERSION, session.name)
    try:
        with page.open("rb") as file:
            data = file.read(SIZE_MAX + 1)
        memory = recall(parse_kept(data), about, now_ns)
    except FileNotFoundError:
        return LearnerMemory(str(page), about)
    except (OSError, KeptError) as error:
        why = error if isinstance(error, KeptError) else f"cannot be read ({error.strerror})"
        print_labelled("note: ", f"{page} {why}. The learner begins with the car file.", sys.stderr)
        return LearnerMemory(str(page), about, refused=True)
    metadata = {"file": page.name, "sha256": _digest(data), "memory": memory}
    return LearnerMemory(str(page), about, memory, metadata={METADATA: metadata})


@dataclass
class Keeper:
    """Takes a learner's reports and writes some of them; a page that cannot be written is said."""

    page: Path
    about: About  # of what the page is
    refused: bool = False  # what is there cannot be used, and is somebody's: it is moved aside
    newest: m.Model | None = None  # the last report that knows the car and is not written yet
    due_ns: int | None = None  # when the page is written next (monotonic), None before the first
    failed: bool = False  # whether writing failed; then it is not tried again

    def take(self, report: m.Model) -> None:
        """Take a report; one of a car that is not known yet says nothing new."""
        if report.verdict == "learning":
            return
        self.newest = report
        if self.due_ns is None or report.mono_ns >= self.due_ns:
            self.due_ns = report.mono_ns + EVERY_NS
            self.end()

    def end(self) -> None:
        """Write the last report, if it is not written."""
        if self.newest is None or self.failed:
            return
        write = write_output if self.refused else write_whole
        try:
            self.page.parent.mkdir(parents=True, exist_ok=True)
            write(self.page, format_kept(self.about, self.newest))
            self.refused = False
        except (OSError, SteerdError) as error:
            self.failed = True
            what = f"what was learnt cannot be kept ({error}); the drive goes on"
            print(f"steerd learner: {what}", file=sys.stderr)
        self.newest = None
