"""steerd: control, identification and sim-to-real diagnosis for Ackermann cars.

    import steerd

    drive = steerd.simulate(path="figure8", speed=1.5, duration=30, effects={"steer_delay": 0.05})
    state = drive.table("state")            # NumPy structured array: state["t"], state["e1"], …
    drive.plot()                            # a matplotlib figure
    fit = steerd.identify(drive)            # parameters with standard errors
    gap = steerd.diagnose(drive)            # which unmodelled effect explains the rest

`steerd.load("drive.mcap")` opens a recorded session. Every failure is a `SteerdError` that says
what happened and what to try. Importing the package loads nothing else: each name is fetched from
its module when it is first used.
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from steerd.daemon.analysis.diagnosis import Diagnosis, diagnose
    from steerd.daemon.analysis.identification import Identification, identify
    from steerd.daemon.analysis.recorded import Session, load
    from steerd.daemon.analysis.simulation import simulate
    from steerd.daemon.common.errors import SteerdError

__all__ = [
    "Diagnosis",
    "Identification",
    "Session",
    "SteerdError",
    "diagnose",
    "identify",
    "load",
    "simulate",
]

_MODULES = {
    "Diagnosis": "diagnosis",
    "Identification": "identification",
    "Session": "recorded",
    "diagnose": "diagnosis",
    "identify": "identification",
    "load": "recorded",
    "simulate": "simulation",
}

if not TYPE_CHECKING:  # type checkers read the imports above

    def __getattr__(name: str) -> Any:
        """Fetch a name of `__all__` from its module (PEP 562)."""
        if name == "SteerdError":
            module = "steerd.daemon.common.errors"
        elif name in _MODULES:
            module = f"steerd.daemon.analysis.{_MODULES[name]}"
        else:
            raise AttributeError(f"module 'steerd' has no attribute {name!r}")
        value = globals()[name] = getattr(importlib.import_module(module), name)
        return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
