"""Reports as HTML pages: jinja2 lives here, and the look that they share."""

from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, select_autoescape

_SHARED = Path(__file__).parent / "templates"


def render_page(template: Path, **values: Any) -> str:
    """The page that `template` makes of `values`, escaped; it may include `look.css`.

    Raises:
        ValueError: a number for `|tojson` is not finite.
    """
    environment = Environment(
        loader=FileSystemLoader([template.parent, _SHARED]),
        autoescape=select_autoescape(),
        trim_blocks=True,
        lstrip_blocks=True,
    )
    # `|tojson` escapes <, > and &, so data cannot end its script element; NaN is no JSON.
    environment.policies["json.dumps_kwargs"] = {"allow_nan": False, "separators": (",", ":")}
    return environment.get_template(template.name).render(**values)
