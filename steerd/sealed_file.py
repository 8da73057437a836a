"""Files of a cache that are believed only if they are as this user's steerd wrote them.

A cache holds code that the control process loads and gains that a car is driven with. Each file
ends with a digest of its name, which says what it was made from, and of its content; it and its
folder belong to this user (or root), and nobody else may write them. Like `steerd.toml_text`, it
belongs to no room.
"""

import contextlib
import hashlib
import os
import stat
import warnings
from pathlib import Path

_OTHERS_WRITE = stat.S_IWGRP | stat.S_IWOTH
_OWN = 0o700


class CacheRefused(UserWarning):
    """A file of a cache is not believed: what it saves is done again."""


def seal(name: str, data: bytes) -> bytes:
    """The content of a file of that name, which says all that the data were made from."""
    return data + _digest(name, data)


def read_sealed(path: Path) -> bytes | None:
    """The data of a file; None where there is none, or it is not to be believed, which is said."""
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
    except OSError:
        return None
    with os.fdopen(descriptor, "rb") as file:
        why = _distrust(os.fstat(descriptor)) or _distrust(path.parent.stat())
        content = b"" if why else file.read()
    data = content[: -len(_digest("", b""))]
    if not why and content == seal(path.name, data):
        return data
    text = f"{path} {why or 'is damaged or was changed'}; it is made anew"
    warnings.warn(text, CacheRefused, stacklevel=2)
    return None


def make_own_folder(folder: Path) -> None:
    """Make a folder into which nobody else writes; take that right away where it was given.

    Raises:
        OSError: it cannot be made, or is somebody else's.
    """
    for each in (*reversed(folder.parents), folder):
        with contextlib.suppress(FileExistsError):
            each.mkdir(_OWN)
    if folder.stat().st_mode & _OTHERS_WRITE:
        folder.chmod(_OWN)


def _distrust(found: os.stat_result) -> str:
    if found.st_uid not in (os.geteuid(), 0):
        return "belongs to another user"
    return "may be written by others" if found.st_mode & _OTHERS_WRITE else ""


def _digest(name: str, data: bytes) -> bytes:
    digest = hashlib.sha256(name.encode() + b"\0" + data).hexdigest()
    return f"\nsha256 {digest}\n".encode()
