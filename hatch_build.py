"""Build hook: the compiled equations are part of the package (`car_model/native/build.py`)."""

import sys
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class EquationsHook(BuildHookInterface):
    """Prints and compiles the library before a wheel or an editable install is made."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Put the library beside its loader, and the machine into the wheel's name."""
        if self.target_name != "wheel":
            return
        sys.path.insert(0, self.root)
        try:
            from steerd.car_model.native.build import build, find_compiler, wheel_tag

            made = build()
            build_data["tag"] = wheel_tag(find_compiler())
        finally:
            sys.path.remove(self.root)
        build_data["pure_python"] = False
        build_data["artifacts"].append(f"steerd/car_model/native/{Path(made).name}")
