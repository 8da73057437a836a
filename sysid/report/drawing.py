"""Style of the reports' figures, and their conversion to inline SVG without file or network."""

import io
import re
from collections.abc import Callable, Mapping, Sequence
from html import escape
from types import MappingProxyType
from typing import Any

from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter, StrMethodFormatter

INK, FAINT = "#1f2933", "#9aa5b1"
MEASURED, AFTER, BEFORE = "#1f2933", "#d9480f", "#4c8dca"
BAND, CONFOUNDED, GRID, PAGE = "#fff0e6", "#f0a77f", "#e4e7eb", "#fefefe"
TEAL, VIOLET, GREEN = "#0b7285", "#862e9c", "#5c940d"
LINES = (BEFORE, AFTER, TEAL, VIOLET, GREEN)
"""Of several curves; the eye does not distinguish more."""
IN_PAGE = MappingProxyType({
    INK: "ink", FAINT: "soft", GRID: "line", BAND: "band", AFTER: "after", BEFORE: "before",
    CONFOUNDED: "confounded", TEAL: "teal", VIOLET: "violet", GREEN: "green", PAGE: "back",
})  # fmt: skip
"""Colours that the page decides: the variables of `look.css`, one value a theme."""
WIDTH = 9.6
"""Of a page's text [inch]; diagrams side by side share it."""
LINEAR = 20.0
"""Ratio of two bars up to which both can be seen from zero on."""
STYLE: dict[Any, Any] = {
    "font.family": "sans-serif", "font.size": 9.0, "axes.edgecolor": FAINT, "axes.labelcolor": INK,
    "xtick.color": INK, "ytick.color": INK, "axes.spines.top": False, "axes.spines.right": False,
    "axes.grid": True, "grid.color": GRID, "grid.linewidth": 0.6, "svg.fonttype": "none",
    "svg.hashsalt": "steerd", "legend.facecolor": PAGE, "legend.edgecolor": "none",
    "axes.titlesize": 9.5, "axes.titlelocation": "left", "text.color": INK, "axes.titlecolor": INK,
    "axes.facecolor": "none", "axes.axisbelow": True,
}  # fmt: skip


Colours = Mapping[str, str]
NONE: Colours = MappingProxyType({})
"""What colours stand for, by name."""


def draw(
    plot: Callable[..., None], height: float, *about: Any, columns: int = 1, colours: Colours = NONE
) -> str:
    """The markup of `columns` diagrams that `plot` fills with what they are about."""
    axes = make_axes(columns, height, max(columns, 2))
    plot(*axes, *about)
    return to_svg(axes, colours)


def make_axes(count: int, height: float, columns: int = 2) -> list[Any]:
    """Axes of so many diagrams, each so high [inch] and so wide that `columns` fill the page."""
    size = WIDTH / columns, height
    return [Figure(figsize=size, layout="constrained").subplots() for _ in range(count)]


def plain_log(axis: Axis) -> None:
    """Plain numbers at a logarithmic axis: powers would be set in fonts that may be missing."""
    axis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axis.set_minor_formatter(NullFormatter())


def scale_bars(axis: Axes, heights: Sequence[float]) -> None:
    """From zero on where all bars can be seen there, else logarithmic, from below the least."""
    known = [height for height in heights if height > 0.0]
    if known and max(known) > LINEAR * min(known):
        axis.set(yscale="log", ylim=(0.4 * min(known), 2.0 * max(known)))
        plain_log(axis.yaxis)
    else:
        axis.set_ylim(0.0, 1.15 * max(known, default=1.0))


def to_svg(axes: Sequence[Any], colours: Colours = NONE) -> str:
    """Diagrams as markup: side by side where there is room, else below each other.

    Args:
        axes: as `make_axes` made them, all of one width.
        colours: what the colours of the lines stand for, by name.
    """
    wide = axes[0].figure.get_figwidth() / WIDTH if axes else 1.0
    names = "".join(
        f'<span style="--of:var(--{IN_PAGE[colour]})">{escape(name)}</span>'
        for name, colour in colours.items()
    )
    diagrams = "".join(_draw(axis) for axis in axes)
    return f'<p class="names">{names}</p><div style="--wide:{48.0 * wide:.1f}rem">{diagrams}</div>'


def _draw(axis: Any) -> str:
    text = io.StringIO()
    about = {"Date": None, "Creator": None}
    axis.figure.savefig(text, format="svg", facecolor="none", metadata=about)
    markup = text.getvalue()
    markup = markup[markup.index("<svg") :]
    markup = re.sub(r"<metadata>.*?</metadata>", "", markup, flags=re.DOTALL)
    for colour, variable in IN_PAGE.items():
        markup = markup.replace(colour, f"var(--{variable})")
    return re.sub(r'width="[\d.]+pt" height="[\d.]+pt"', "", markup, count=1)
