"""What a drive leaves behind: a table of poses, commands and wheel speed, and how to import it."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

COLUMNS = ("t", "x", "y", "yaw", "steer_cmd", "speed_cmd", "wheel_speed")
MAP = """\
# A drive as a lab would bring it: SI units, radians, left positive, poses of the centre of gravity.
[columns]
""" + "".join(f'{name} = "{name}"\n' for name in COLUMNS) + """
[session]
car = "foreign"
"""  # fmt: skip


@dataclass(frozen=True, slots=True)
class Log:
    """A recording at 100 Hz; arrays of equal length.

    Attributes:
        t: stamps of the poses [s].
        poses: rows x, y, yaw (not wrapped) as mocap saw them [m, m, rad].
        commands: rows wheel angle [rad], speed [m/s].
        wheel: measured speed of the driven wheels [m/s].
    """

    t: Array
    poses: Array
    commands: Array
    wheel: Array


def write_csv(path: Path, log: Log) -> None:
    """Write a recording as a table with a header.

    Raises:
        OSError: it cannot be written.
    """
    table = np.column_stack([log.t, log.poses, log.commands, log.wheel])
    np.savetxt(path, table, fmt="%.6f", delimiter=",", header=",".join(COLUMNS), comments="")
