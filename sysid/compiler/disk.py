"""Where compiled models are kept, and what becomes of a command where nothing can be kept.

Kept code only saves time. A folder that takes nothing is replaced by one that lasts as long as the
process; a disk that fills while code is written to it ends the keeping and not the command.
"""

# Why: docs/decisions/kernels.md#d55

import atexit
import hashlib
import os
import pickle
import shutil
import tempfile
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numba
import platformdirs
from numba.core import serialize
from numba.core.caching import FunctionCache

from steerd.car_model.machine_code import CodeNotKept
from steerd.sealed_file import make_own_folder, read_sealed, seal
from steerd.steer_bus.atomic_file import write_atomically

CACHE_VARIABLE = "STEERD_CACHE"
"""Environment variable that names another cache folder."""


def cache_folder() -> Path:
    """Where compiled models are kept; it need not exist yet."""
    chosen = os.environ.get(CACHE_VARIABLE)
    return Path(chosen) if chosen else platformdirs.user_cache_path("steerd")


def replace_folder(error: Exception) -> None:
    """Keep compiled models in a temporary folder from now on, for worker processes too; say so.

    Raises:
        OSError: there is no room for one either; it names the cache folder.
    """
    wanted = cache_folder()
    what = (isinstance(error, OSError) and error.strerror) or str(error)
    try:
        folder = tempfile.mkdtemp(prefix="steerd-")
    except OSError:
        raise at_place(error, wanted) from None
    atexit.register(_remove, folder, os.getpid())
    os.environ[CACHE_VARIABLE] = folder
    warnings.warn(f"{wanted}: {what}; compiled code is not kept", CodeNotKept, stacklevel=2)


def at_place(error: Exception, place: Path) -> OSError:
    """The same error with the place that took nothing, which a full disk does not name."""
    if isinstance(error, OSError):
        return OSError(error.errno, error.strerror, str(place))
    return OSError(str(error))


def _remove(folder: str, owner: int) -> None:
    """Remove a temporary folder when the process that made it ends; its forks leave it alone."""
    if os.getpid() == owner:
        shutil.rmtree(folder, ignore_errors=True)


_dumps: Any = serialize.dumps


class _SealedFiles:
    """Stands in for Numba's index and data: a sealed file for each signature of a function."""

    def __init__(self, own: Any) -> None:
        self._folder, self._base = Path(own.cache_path), own._impl.filename_base  # noqa: SLF001
        self._source = numba.__version__, own._impl.locator.get_source_stamp()  # noqa: SLF001

    def _path(self, key: Any) -> Path:
        digest = hashlib.sha256(repr((key, self._source)).encode()).hexdigest()[:24]
        return self._folder / f"{self._base}.{digest}.nbc"

    def load(self, key: Any) -> Any:
        """The kept code; None where there is none that can be believed."""
        data = read_sealed(self._path(key))
        return None if data is None else pickle.loads(data)

    def save(self, key: Any, made: Any) -> None:
        """Keep the code, or say that it is not kept."""
        path = self._path(key)
        try:
            make_own_folder(path.parent)
            data: bytes = _dumps(made)
            write_atomically(path, seal(path.name, data))
        except OSError as error:
            text = f"{path.parent}: {error.strerror}; compiled code is not kept"
            warnings.warn(text, CodeNotKept, stacklevel=2)


def seal_caches(functions: Mapping[str, Any]) -> None:
    """Let compiled functions load no code that is not as it was kept, and fail for none."""
    for function in functions.values():
        own: Any = getattr(function, "_cache", None)  # Numba has no public way
        if isinstance(own, FunctionCache):
            vars(own)["_cache_file"] = _SealedFiles(own)
