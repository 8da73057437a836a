"""Output files: replaced where steerd wrote them; anything else is kept beside the new one.

A car file is always kept: yesterday's may be the better one, and a car drove by it.

The digests of what steerd wrote lie in the user's state folder. A file whose digest is not among
them was written by somebody else, or edited since. Without the state folder every file is kept.
"""

import contextlib
import hashlib
import os
import shutil
import sys
import time
from collections.abc import Mapping
from pathlib import Path

import platformdirs

from steerd.daemon.common.errors import SteerdError
from steerd.daemon.common.screen import print_labelled
from steerd.daemon.common.whole_file import write_whole
from steerd.steer_bus.atomic_file import write_atomically

_REMEMBERED = 10_000
"""Digests kept, the latest ones: 650 kB."""


def write_output(path: Path, text: str | bytes) -> Path | None:
    """Write a result, whole or not at all; keep what is there if steerd did not write it.

    Args:
        path: the file; it may exist.
        text: its new content.

    Returns:
        Where the old content is now, or None: there was none, it was the same, or a page or a
        table of steerd's.

    Raises:
        SteerdError: it cannot be written; the old content is then where it was.
    """
    kept = _keep(path, text)
    try:
        write_whole(path, text)
    except SteerdError:
        if kept is not None:
            kept.unlink()
        raise
    _remember(_encode(text))
    return kept


def write_outputs(
    texts: Mapping[Path | None, str | bytes | None], *, announced: bool = False
) -> None:
    """Write every result, and name on standard error what was kept.

    Args:
        texts: content by file; an entry without a file or without a content is left out.
        announced: a terminal shows what was written, as after work that ends with it.

    Raises:
        SteerdError: every file that failed in one line, after the others were written.
    """
    failures: list[SteerdError] = []
    written: list[str] = []
    for path, text in texts.items():
        if path is None or text is None:
            continue
        try:
            kept = write_output(path, text)
        except SteerdError as error:
            failures.append(error)
            continue
        written.append(str(path))
        if kept is not None:
            print_labelled("note: ", describe_kept(path, kept), sys.stderr)
    if announced and written and sys.stderr.isatty():
        print_labelled("written: ", ", ".join(written), sys.stderr)
    if failures:
        what = "; ".join(failure.what for failure in failures)
        raise SteerdError(what, failures[0].hint, failures[0].code)


def describe_kept(path: Path, kept: Path) -> str:
    """One line about a file that was kept."""
    return f"what {path} was before is kept as {kept}"


def _keep(path: Path, text: str | bytes) -> Path | None:
    """Give a car file, or a foreign or edited one, a second, dated name beside the first.

    Raises:
        SteerdError: it can be neither linked nor copied.
    """
    try:
        old = path.read_bytes()
    except FileNotFoundError:
        return None
    except OSError as error:
        raise SteerdError(f"{path}: {error.strerror}", "choose another name") from None
    if old == _encode(text) or (path.suffix != ".toml" and _digest(old) in _written()):
        return None
    kept = _dated_name(path)
    try:
        os.link(path, kept)
    except OSError:  # a file system without links
        try:
            shutil.copy2(path, kept)
        except OSError as error:
            kept.unlink(missing_ok=True)
            what = f"{path} is not steerd's and cannot be kept: {error.strerror}"
            raise SteerdError(what, "choose another name") from None
    return kept


def _dated_name(path: Path) -> Path:
    """`NAME.DATE.SUFFIX` of a file, by its last change in local time; the first that is free."""
    stamp = time.strftime("%Y-%m-%dT%H-%M-%S", time.localtime(path.stat().st_mtime))
    count = 1
    while True:
        more = "" if count == 1 else f".{count}"
        name = path.with_name(f"{path.stem}.{stamp}{more}{path.suffix}")
        if not name.exists():
            return name
        count += 1


def _encode(text: str | bytes) -> bytes:
    return text.encode() if isinstance(text, str) else text


def _digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def _state_file() -> Path:
    return platformdirs.user_state_path("steerd") / "written.sha256"


def _written() -> list[str]:
    try:
        return _state_file().read_text(encoding="ascii").split()
    except (OSError, UnicodeDecodeError):
        return []


def _remember(data: bytes) -> None:
    """Add a digest; where that is not possible, the next command keeps the file."""
    digests = [*dict.fromkeys([*_written(), _digest(data)])][-_REMEMBERED:]
    with contextlib.suppress(OSError):
        _state_file().parent.mkdir(parents=True, exist_ok=True)
        write_atomically(_state_file(), "\n".join(digests) + "\n")
