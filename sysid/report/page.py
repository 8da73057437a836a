"""Reports as HTML pages without links: jinja2 lives here, and the look that all pages share."""

from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, select_autoescape

from steerd.sysid.report.report import Report

_SHARED = Path(__file__).parent / "templates"


def render_report(report: Report) -> str:
    """The page of a report."""
    return render_page(_SHARED / "report.html", report=report)


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
