"""Style of the reports' figures, and their conversion to inline SVG without file or network."""

import io
import re
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

INK, FAINT = "#1f2933", "#9aa5b1"
MEASURED, AFTER, BEFORE = "#1f2933", "#d9480f", "#4c8dca"
BAND, CONFOUNDED, GRID, PAGE = "#fff0e6", "#f0a77f", "#e4e7eb", "#fefefe"
TEAL, VIOLET, GREEN = "#0b7285", "#862e9c", "#5c940d"
LINES = (BEFORE, AFTER, TEAL, VIOLET, GREEN)
"""Of several curves; the eye does not distinguish more."""
IN_PAGE = MappingProxyType({
    INK: "ink", FAINT: "soft", GRID: "line", BAND: "band", AFTER: "after", BEFORE: "before",
    CONFOUNDED: "confounded", TEAL: "teal", VIOLET: "violet", GREEN: "green",
    PAGE: "back",
})  # fmt: skip
"""Colours that the page decides: the variables of `look.css`, one value a theme."""
WIDTH = 9.6
"""Of a figure that fills the page [inch]."""
COLUMNS = 3
"""Small diagrams side by side."""
READABLE = 44.0
"""Width below which the words of such a figure are too small to read; a window that is narrower
scrolls it [rem]."""
STYLE: dict[Any, Any] = {
    "font.family": "sans-serif", "font.size": 9.0, "axes.edgecolor": FAINT, "axes.labelcolor": INK,
    "xtick.color": INK, "ytick.color": INK, "axes.spines.top": False, "axes.spines.right": False,
    "axes.grid": True, "grid.color": GRID, "grid.linewidth": 0.6, "svg.fonttype": "none",
    "svg.hashsalt": "steerd", "legend.facecolor": PAGE, "legend.edgecolor": "none",
    "axes.titlesize": 9.5, "axes.titlelocation": "left", "text.color": INK, "axes.titlecolor": INK,
    "axes.facecolor": "none", "axes.axisbelow": True,
}  # fmt: skip


def draw(plot: Callable[..., None], height: float, *about: Any, columns: int = 1) -> str:
    """The markup of a figure whose axes, side by side, `plot` fills with what it is about."""
    figure, axes = make_figure(1, columns, height)
    plot(*axes.flat, *about)
    return to_svg(figure)


def make_figure(rows: int, columns: int, height: float) -> tuple[Figure, NDArray[Any]]:
    """A figure as wide as the page and its axes (rows, columns)."""
    figure = Figure(figsize=(WIDTH, height), layout="constrained")
    return figure, figure.subplots(rows, columns, squeeze=False)


def make_grid(count: int, height: float) -> tuple[Figure, list[Any]]:
    """A figure of `count` small diagrams, each so high [inch], and their axes."""
    figure, axes = make_figure(-(-count // COLUMNS), COLUMNS, height * -(-count // COLUMNS))
    for axis in axes.flat[count:]:
        axis.set_visible(False)
    return figure, [*axes.flat[:count]]


def name_colours(axes: Axes, colours: Mapping[str, str], **where: Any) -> None:
    """A legend of colours, placed as matplotlib's is."""
    lines = [Line2D([], [], color=colour, lw=3.0, label=name) for name, colour in colours.items()]
    axes.legend(handles=lines, fontsize=8, **where)


def to_svg(figure: Figure) -> str:
    """The figure as markup that scales with the page."""
    text = io.StringIO()
    figure.savefig(text, format="svg", facecolor="none", metadata={"Date": None, "Creator": None})
    markup = text.getvalue()
    markup = markup[markup.index("<svg") :]
    markup = re.sub(r"<metadata>.*?</metadata>", "", markup, flags=re.DOTALL)
    for colour, variable in IN_PAGE.items():
        markup = markup.replace(colour, f"var(--{variable})")
    share = figure.get_figwidth() / WIDTH
    size = f'width="{share:.0%}" style="min-width:{READABLE * share:.1f}rem"'
    return re.sub(r'width="[\d.]+pt" height="[\d.]+pt"', size, markup, count=1)
