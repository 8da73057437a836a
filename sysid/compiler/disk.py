"""Where compiled models are kept, and what becomes of a command where nothing can be kept.

Kept code only saves time. A folder that takes nothing is replaced by one that lasts as long as the
process; a disk that fills while code is written to it ends the keeping and not the command.
"""

# Why: docs/decisions/kernels.md#d55

import atexit
import contextlib
import os
import pickle
import shutil
import tempfile
import warnings
from pathlib import Path
from types import ModuleType
from typing import Any

import platformdirs
from numba.core.caching import FunctionCache

from steerd.car_model.machine_code import CodeNotKept

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


class _Kept:
    """Numba's cache of one function, whose failures cost time and nothing else.

    Attributes:
        own: Numba's, whose other attributes are this one's.
    """

    def __init__(self, own: Any) -> None:
        self.own = own

    def __getattr__(self, name: str) -> Any:
        return getattr(self.own, name)

    def load_overload(self, *asked: Any) -> Any:
        """The kept code; None where there is none or it is damaged, as a power cut leaves it."""
        try:
            return self.own.load_overload(*asked)
        except (OSError, EOFError, pickle.UnpicklingError):
            with contextlib.suppress(OSError):
                self.own.flush()
            return None

    def save_overload(self, *made: Any) -> None:
        """Keep the code, or say that it is not kept."""
        try:
            self.own.save_overload(*made)
        except OSError as error:
            text = f"{self.own.cache_path}: {error.strerror}; compiled code is not kept"
            warnings.warn(text, CodeNotKept, stacklevel=2)


def spare_failures(module: ModuleType) -> None:
    """Let no entry point of a compiled module fail because its code cannot be read or kept."""
    for function in vars(module).values():
        own: Any = getattr(function, "_cache", None)  # Numba has no public way
        if isinstance(own, FunctionCache):
            vars(function)["_cache"] = _Kept(own)
