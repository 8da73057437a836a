"""What an earlier run's learner kept of the car: found and checked before the learner begins."""

# Why: docs/decisions/diagnosis.md#d87

import hashlib
import sys
from pathlib import Path
from typing import NamedTuple

from steerd.car_model.car_file import default_car_path
from steerd.daemon.assembly.build import RunPlan
from steerd.daemon.assembly.session_meta import data_folder
from steerd.daemon.common.screen import print_labelled
from steerd.daemon.learning import kept
from steerd.version import VERSION


class LearnerMemory(NamedTuple):
    """Where a run's learner keeps what it learns, and what it begins with."""

    page: str = ""  # the file; empty for simulated hardware, whose numbers are no car's
    about: kept.About = kept.About("", "", "", "")  # of what it is
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
    page, scaling = learnt_page(plan), plan.settings.scaling
    numbers = kept.digest_numbers(plan.settings.file, scaling.erpm_gain, scaling.erpm_offset)
    about = kept.About(plan.options.car, numbers, VERSION, session.name)
    try:
        with page.open("rb") as file:
            data = file.read(kept.SIZE_MAX + 1)
        memory = kept.recall(kept.parse_kept(data), about, now_ns)
    except FileNotFoundError:
        return LearnerMemory(str(page), about)
    except (OSError, kept.KeptError) as error:
        why = error if isinstance(error, kept.KeptError) else f"cannot be read ({error.strerror})"
        text = f"{page} {why}. The learner begins with the car file."
        print_labelled("note: ", text, sys.stderr)
        return LearnerMemory(str(page), about, refused=True)
    metadata = {"file": page.name, "sha256": hashlib.sha256(data).hexdigest(), "memory": memory}
    return LearnerMemory(str(page), about, memory, metadata={kept.METADATA: metadata})
