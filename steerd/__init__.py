"""steerd: control, identification and sim-to-real diagnosis for Ackermann cars.

    import steerd

    drive = steerd.simulate(path="figure8", speed=1.5, duration=30, effects={"steer_delay": 0.05})
    state = drive.table("state")            # NumPy structured array: state["t"], state["e1"], …
    drive.plot()                            # a matplotlib figure
    fit = steerd.identify(drive)            # parameters with standard errors
    gap = steerd.diagnose(drive)            # which unmodelled effect explains the rest
    mine = steerd.simulate(controller=lambda t, state, lane: (-0.8 * lane.e1 - lane.e2, 1.0))
    many = steerd.sweep({"car.mass": {"share": 0.1}}, seeds=200)   # and if the car were another?

`steerd.load("drive.mcap")` opens a recorded session. Every failure is a `SteerdError` that says
what happened and what to try. Importing the package loads nothing else: each name is fetched from
its module when it is first used.
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from steerd.daemon.analysis.diagnosis import Diagnosis, diagnose
    from steerd.daemon.analysis.environment import Environment
    from steerd.daemon.analysis.identification import Identification, identify
    from steerd.daemon.analysis.recorded import Session, load
    from steerd.daemon.analysis.simulation import simulate
    from steerd.daemon.common.errors import SteerdError
    from steerd.daemon.many.batch.run import Batch, batch
    from steerd.daemon.many.sweep.run import Sweep, sweep
    from steerd.daemon.process.external_controller import serve

__all__ = [
    "Batch", "Diagnosis", "Environment", "Identification", "Session", "SteerdError", "Sweep",
    "batch", "diagnose", "identify", "load", "serve", "simulate", "sweep",
]  # fmt: skip

_NAMES = {
    "analysis.diagnosis": ("Diagnosis", "diagnose"),
    "analysis.environment": ("Environment",),
    "analysis.identification": ("Identification", "identify"),
    "analysis.recorded": ("Session", "load"),
    "analysis.simulation": ("simulate",),
    "common.errors": ("SteerdError",),
    "many.batch.run": ("Batch", "batch"),
    "many.sweep.run": ("Sweep", "sweep"),
    "process.external_controller": ("serve",),
}
_MODULES = {name: module for module, names in _NAMES.items() for name in names}

if not TYPE_CHECKING:  # type checkers read the imports above

    def __getattr__(name: str) -> Any:
        """Fetch a name of `__all__` from its module (PEP 562)."""
        if name == "__version__":
            from steerd.version import VERSION

            return VERSION
        if name not in _MODULES:
            raise AttributeError(f"module 'steerd' has no attribute {name!r}")
        module = importlib.import_module(f"steerd.daemon.{_MODULES[name]}")
        value = globals()[name] = getattr(module, name)
        return value


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
