"""Files that are installed with steerd, for texts that name them."""

from importlib.resources import files
from pathlib import Path

EXAMPLES = Path(str(files("steerd") / "data" / "examples"))
"""Maps for `steerd import`, a sweep, layouts for viewers, a pose publisher: the `examples/`."""
EXAMPLE_MAP = EXAMPLES / "import-dart.toml"
