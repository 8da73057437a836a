"""Unsealing the sealed labels: only after the verdicts are written, and never unnoticed.

Every opening of a report set adds a line to an append-only log in the repository; each line holds
the hash of the line before it, so that a line taken out shows.
"""

import json
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from benchmarks.blind_gap.generate import key_path
from benchmarks.blind_gap.seal import load_key, sha256, unseal
from benchmarks.blind_gap.verdicts import digest_verdicts

LOG = Path(__file__).with_name("opened.jsonl")


class OpeningError(RuntimeError):
    """A set that may not be opened or scored; the message says why."""


@dataclass(frozen=True, slots=True)
class Unsealing:
    """One line of the log."""

    when: str
    labels_sha256: str
    verdicts_sha256: str
    cases: int
    missing: int
    previous: str


def load_manifest(out: Path) -> dict[str, Any]:
    """A set's manifest.

    Raises:
        OpeningError: the folder holds none.
    """
    path = out / "manifest.json"
    if not path.exists():
        raise OpeningError(f"{out} holds no manifest.json: generate a set there first")
    manifest: dict[str, Any] = json.loads(path.read_text())
    return manifest


def case_names(manifest: dict[str, Any]) -> list[str]:
    """Names of a set's cases."""
    return [row["case"] for row in manifest["cases"]]


def load_log(path: Path = LOG) -> list[Unsealing]:
    """Every opening so far.

    Raises:
        OpeningError: a line was changed or taken out.
    """
    lines = path.read_text().splitlines() if path.exists() else []
    openings, previous = [], ""
    for line in lines:
        entry = Unsealing(**json.loads(line))
        if entry.previous != previous:
            raise OpeningError(f"{path.name}: the line of {entry.when} does not follow its last")
        openings.append(entry)
        previous = sha256(line.encode())
    return openings


def _append(path: Path, entry: Unsealing) -> None:
    with path.open("a") as file:
        file.write(json.dumps(asdict(entry)) + "\n")


def open_labels(
    out: Path,
    verdicts: Path,
    key_file: Path | None = None,
    log: Path = LOG,
    allow_missing: bool = False,
    now: datetime | None = None,
) -> dict[str, Any]:
    """Unseal a report set's labels into `labels.json` and log it.

    Args:
        out: the set.
        verdicts: folder with a verdict for every case.
        key_file: by default beside the set.
        log: the append-only log.
        allow_missing: open although verdicts are missing; they count as failures.
        now: time for the log; the clock's by default.

    Raises:
        OpeningError: a verdict is missing, or the sealed file is not the one of the manifest.
        SealError: the key is not the file's, or the file was changed.
        OSError: a file cannot be read or written.
    """
    manifest = load_manifest(out)
    digest, missing = digest_verdicts(verdicts, case_names(manifest))
    if missing and not allow_missing:
        raise OpeningError(f"{len(missing)} cases have no verdict yet, the first is {missing[0]}")
    sealed = (out / "labels.sealed").read_bytes()
    if sha256(sealed) != manifest["labels_sha256"]:
        raise OpeningError("labels.sealed is not the file that the manifest was published with")
    text = unseal(sealed, load_key(key_file or key_path(out)))
    load_log(log)
    lines = log.read_text().splitlines() if log.exists() else []
    when = (now or datetime.now(UTC)).isoformat(timespec="seconds")
    previous = sha256(lines[-1].encode()) if lines else ""
    counts = (len(manifest["cases"]), len(missing))
    _append(log, Unsealing(when, sha256(sealed), digest, *counts, previous))
    (out / "labels.json").write_bytes(text)
    labels: dict[str, Any] = json.loads(text)
    return labels


def load_labels(
    out: Path, verdicts: Path, log: Path = LOG
) -> tuple[dict[str, Any], list[Unsealing]]:
    """Labels that may be scored, and the openings of report sets so far.

    Raises:
        OpeningError: the labels are still sealed, or verdicts were changed after the opening.
    """
    manifest = load_manifest(out)
    path = out / "labels.json"
    if not path.exists():
        raise OpeningError("the labels are sealed: write all verdicts, then `open` them")
    openings = load_log(log)
    text = path.read_bytes()
    if manifest["set"] == "report":
        _check_report(out, manifest, verdicts, text, openings)
    elif sha256(text) != manifest["labels_sha256"]:
        raise OpeningError("labels.json is not the file that the manifest was written with")
    labels: dict[str, Any] = json.loads(text)
    return labels, openings


def _check_report(
    out: Path, manifest: dict[str, Any], verdicts: Path, text: bytes, openings: list[Unsealing]
) -> None:
    digest, _ = digest_verdicts(verdicts, case_names(manifest))
    known = {(o.labels_sha256, o.verdicts_sha256) for o in openings}
    if (manifest["labels_sha256"], digest) not in known:
        raise OpeningError("these verdicts are not the ones that the labels were opened for")
    sealed = (out / "labels.sealed").read_bytes()
    if key_path(out).exists() and unseal(sealed, load_key(key_path(out))) != text:
        raise OpeningError("labels.json is not what was sealed")
