"""Output files: replaced where steerd wrote them; anything else is kept beside the new one.

A car file is always kept, with the file beside it: yesterday's may be the better one, and a car
drove by it.

The digests of what steerd wrote lie in the user's state folder. A file whose digest is not among
them was written by somebody else, or edited since. Without the state folder every file is kept.
"""

import contextlib
import hashlib
import os
import shutil
import sys
import time
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import platformdirs

if TYPE_CHECKING:
    from steerd.car_model.car_file import CarFile

from steerd.daemon.common.errors import ExitCode, SteerdError, UsageError
from steerd.daemon.common.screen import print_labelled
from steerd.posterior_file import posterior_path
from steerd.steer_bus.atomic_file import is_full, write_atomically

_REMEMBERED = 10_000  # digests kept, the latest ones: 650 kB


def write_output(path: Path, text: str | bytes) -> Path | None:
    """Write a result, whole or not at all; keep what is there if steerd did not write it.

    Gives where the old content is now, or None: there was none, it was the same, or a page or a
    table of steerd's. After a SteerdError the old content is where it was.
    """
    data = text.encode() if isinstance(text, str) else text
    kept = _keep(path, data)
    try:
        write_whole(path, data)
    except SteerdError:
        if kept is not None:
            kept.unlink()
        raise
    digests = [*dict.fromkeys([*_written(), _digest(data)])][-_REMEMBERED:]
    with contextlib.suppress(OSError):  # where that is not possible, the next command keeps it
        _state_file().parent.mkdir(parents=True, exist_ok=True)
        write_atomically(_state_file(), "\n".join(digests) + "\n")
    return kept


Write = Callable[[Path | None, "str | bytes | None"], bool]
"""Writes one file, and says whether it is there; nothing where name or content is None."""


@contextmanager
def writing(named: Mapping[str, Path | None], *, announced: bool = False) -> Iterator[Write]:
    """Write the outputs of a command, see `check_outputs`, each as soon as its content is known.

    What cannot be written is a SteerdError when the block ends, after the others were written. An
    interrupt (Ctrl-C) leaves what was written by then and says in one line what that is; where it
    is `announced`, a terminal shows that at the end, too.
    """
    check_outputs(named)
    failures: dict[Path, SteerdError] = {}
    written: dict[Path, str | bytes] = {}

    def write(path: Path | None, text: str | bytes | None) -> bool:
        if path is None or text is None or written.get(path) == text:
            return path in written
        try:
            kept = write_output(path, text)
        except SteerdError as error:
            failures[path] = error
            return False
        failures.pop(path, None)
        written[path] = text
        if kept is not None:
            print_labelled("note: ", f"what {path} was before is kept as {kept}", sys.stderr)
        return True

    try:
        yield write
    except KeyboardInterrupt:
        missing = [path for path in named.values() if path and path not in written]
        text = f"{_are(written)} written" if written else "nothing is written"
        text += f", {_are(missing)} not" if written and missing else ""
        print_labelled("interrupted: ", text, sys.stderr)
        raise
    if announced and written and sys.stderr.isatty():
        print_labelled("written: ", ", ".join(map(str, written)), sys.stderr)
    if failures:
        first, *others = failures.values()
        raise SteerdError("; ".join(each.what for each in (first, *others)), first.hint, first.code)


def _are(paths: Collection[Path]) -> str:
    return f"{', '.join(map(str, paths))} {'is' if len(paths) == 1 else 'are'}"


def write_outputs(
    texts: Mapping[Path | None, str | bytes | None], *, announced: bool = False
) -> None:
    """Write every result, content by file, see `writing`; not those of which one is None."""
    with writing({}, announced=announced) as write:
        for path, text in texts.items():
            write(path, text)


def car_outputs(path: Path, car: "CarFile") -> dict[Path | None, str | bytes | None]:
    """A car file and the file beside it, for `write_outputs`."""
    return {path: car.text, posterior_path(path): car.posterior or None}


def _keep(path: Path, data: bytes) -> Path | None:
    """Give a car file, or a foreign or edited one, a second, dated name beside the first."""
    try:
        old = path.read_bytes()
    except FileNotFoundError:
        return None
    except OSError as error:
        raise SteerdError(f"{path}: {error.strerror}", "choose another name") from None
    if old == data or (path.suffix != ".toml" and _digest(old) in _written()):
        return None
    kept = dated_name(path)
    try:
        _link(path, kept)
    except OSError as error:
        kept.unlink(missing_ok=True)
        what = f"{path} is not steerd's and cannot be kept: {error.strerror}"
        raise SteerdError(what, "choose another name") from None
    if path.suffix == ".toml":
        with contextlib.suppress(OSError):  # most car files have none
            _link(posterior_path(path), posterior_path(kept))
    return kept


def _link(path: Path, other: Path) -> None:
    try:
        os.link(path, other)
    except OSError:  # a file system without links
        shutil.copy2(path, other)


def dated_name(path: Path) -> Path:
    """`NAME.DATE.SUFFIX` of a file, by its last change in local time; the first that is free."""
    stamp = time.strftime("%Y-%m-%dT%H-%M-%S", time.localtime(path.stat().st_mtime))
    name, count = path.with_name(f"{path.stem}.{stamp}{path.suffix}"), 1
    while name.exists():
        count += 1
        name = path.with_name(f"{path.stem}.{stamp}.{count}{path.suffix}")
    return name


def _digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def _state_file() -> Path:
    return platformdirs.user_state_path("steerd") / "written.sha256"


def _written() -> list[str]:
    try:
        return _state_file().read_text(encoding="ascii").split()
    except (OSError, UnicodeDecodeError):
        return []


def check_outputs(outputs: Mapping[str, Path | None]) -> None:
    """Refuse what cannot be written: paths by option name, None where the option was not given.

    A SteerdError where an output is a session or a folder, its folder is missing or read-only, or
    two options name one file.
    """
    taken: dict[Path, str] = {}
    for option, path in outputs.items():
        if path is None:
            continue
        where, folder = f"{option} {path}", path.parent
        if _is_session(path):
            what = f"{where}: that is a session, and a session is never overwritten"
            raise UsageError(what, "choose another name")
        if path.is_dir():
            what, hint = f"{where}: that is a folder", "name a file in it"
            raise SteerdError(what, hint, ExitCode.UNREADABLE)
        if not folder.is_dir() or not os.access(folder, os.W_OK | os.X_OK):
            what = f"the folder {folder} cannot be written"
            what = what if folder.is_dir() else f"there is no folder {folder}"
            raise SteerdError(f"{where}: {what}", "choose another folder", ExitCode.UNREADABLE)
        other = taken.setdefault(path.resolve(), option)
        if other != option:
            what = f"{other} and {option} name the same file, {path}"
            raise UsageError(what, "give each its own name")


def _is_session(path: Path) -> bool:
    """Whether it begins as sessions do; an unreadable file is reported by its reader."""
    from steerd.steer_bus.container import MAGIC

    try:
        if not path.is_file():
            return False
        with path.open("rb") as file:
            return file.read(len(MAGIC)) == MAGIC
    except OSError:
        return False


def write_whole(path: Path, text: str | bytes) -> None:
    """Write a file in one move, never half of it; a SteerdError where that is not possible."""
    try:
        write_atomically(path, text)
    except OSError as error:
        hint = f"{'free some space, or ' if is_full(error) else ''}choose another folder"
        raise SteerdError(f"{path}: {error.strerror}", hint, ExitCode.UNREADABLE) from None
