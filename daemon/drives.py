"""Sessions as drives for the offline tools; what cannot be used is one clear line."""

from pathlib import Path
from typing import TYPE_CHECKING

from daemon.errors import ExitCode, SteerdError

if TYPE_CHECKING:
    from car_model.car_file import CarFile
    from sysid.dataset import Run


def load_drive(path: Path, speed: str = "command") -> "Run":
    """A session as a drive.

    Args:
        path: the session.
        speed: `wheel` takes the measured speed in place of the command.

    Raises:
        SteerdError: it cannot be read, or is not fit for a fit.
    """
    from steer_bus.session_read import SessionError
    from sysid.beat import steadied
    from sysid.cut import with_wheel_speed
    from sysid.dataset import load_run
    from sysid.gate import DataError

    try:
        run = steadied(load_run(path))
        return with_wheel_speed(run) if speed == "wheel" else run
    except SessionError as error:
        code = ExitCode(error.exit_code)
        raise SteerdError(str(error), error.hint, code) from None
    except DataError as error:
        raise SteerdError(error.what, error.hint, ExitCode.INVALID) from None
    except OSError as error:
        raise SteerdError(f"{path}: {error.strerror}", "", ExitCode.UNREADABLE) from None


def load_base(path: Path) -> "CarFile":
    """A car file that was named on the command line.

    Raises:
        SteerdError: it cannot be read, or says something impossible.
    """
    from car_model.car_file import CarFileError, load_car

    try:
        return load_car(path)
    except CarFileError as error:
        unreadable = isinstance(error.__cause__, OSError)
        code = ExitCode.UNREADABLE if unreadable else ExitCode.INVALID
        raise SteerdError(str(error), error.hint, code) from None
