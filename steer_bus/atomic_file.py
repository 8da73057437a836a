"""Files replaced in one move: a reader sees the old content or the new, never half of it."""

import contextlib
import errno
import os
import tempfile
from pathlib import Path

MODE = 0o644  # everybody may read, the owner may write


_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
_REFUSED = (errno.EACCES, errno.EPERM, errno.EROFS, errno.ENOTDIR, errno.EEXIST)


def is_full(error: OSError) -> bool:
    """Whether a disk, a quota or a limit of the shell (`ulimit -f`) took no more bytes."""
    return error.errno in _FULL


def takes_nothing(error: Exception) -> bool:
    """Whether a place cannot be written: it is full, or its rights, owner or mount forbid it."""
    if not isinstance(error, OSError):
        return False
    return is_full(error) or (error.errno in _REFUSED and error.filename is not None)


def write_atomically(path: Path, data: str | bytes, mode: int = MODE) -> None:
    """Write a temporary file in the same folder, then rename it; text is written as UTF-8.

    The data is on the disk before the rename, so a power cut leaves the old file or the new one.

    Raises:
        OSError: the folder or the file cannot be written; nothing is left behind.
    """
    handle, name = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(data.encode() if isinstance(data, str) else data)
            file.flush()
            os.fsync(file.fileno())
        Path(name).chmod(mode)
        Path(name).replace(path)
    except BaseException:
        with contextlib.suppress(OSError):
            Path(name).unlink()
        raise
