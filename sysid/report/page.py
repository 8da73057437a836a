"""Reports as HTML pages: jinja2 lives here, and the look that they share."""

from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, select_autoescape

_SHARED = Path(__file__).parent / "templates"


def render_page(template: Path, **values: Any) -> str:
    """The page that `template` makes of `values`; it may include `look.css`."""
    environment = Environment(
        loader=FileSystemLoader([template.parent, _SHARED]),
        autoescape=select_autoescape(),
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template(template.name).render(**values)
