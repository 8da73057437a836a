"""What the plot page's script does with its data, in Python."""

import base64
import zlib

import numpy as np

from steerd.daemon.sessions.curves import LEVELS, VALUE


def unpack(packed: dict[str, float | str], slots: int) -> tuple[np.ndarray, np.ndarray]:
    """What `pack` packed, as the page's script reads it: values (NaN where none) and kinds."""
    planes = np.frombuffer(zlib.decompress(base64.b64decode(str(packed["data"]))), np.uint8)
    kinds, fine, coarse = planes.reshape(3, slots)
    level = np.cumsum(fine.astype(np.int64) + 256 * coarse.astype(np.int64)) % (LEVELS + 1)
    low, high = float(packed["low"]), float(packed["high"])
    return np.where(kinds == VALUE, low + level / LEVELS * (high - low), np.nan), kinds
