"""Style of the reports' figures, and their conversion to inline SVG without file or network."""

import io
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from types import MappingProxyType
from typing import Any

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import NullFormatter, StrMethodFormatter

INK, FAINT = "#1f2933", "#9aa5b1"
MEASURED, AFTER, BEFORE = "#1f2933", "#d9480f", "#4c8dca"
BAND, CONFOUNDED, GRID, PAGE = "#fff0e6", "#f0a77f", "#e4e7eb", "#fefefe"
TEAL, VIOLET, GREEN = "#0b7285", "#862e9c", "#5c940d"
LINES = (BEFORE, AFTER, TEAL, VIOLET, GREEN)  # of several curves; the eye does not distinguish more
IN_PAGE = MappingProxyType({
    INK: "ink", FAINT: "soft", GRID: "line", BAND: "band", AFTER: "after", BEFORE: "before",
    CONFOUNDED: "confounded", TEAL: "teal", VIOLET: "violet", GREEN: "green", PAGE: "back",
})  # fmt: skip
"""Colours that the page decides: the variables of `look.css`, one value a theme."""
WIDTH = 9.6  # of a page's text [inch]; diagrams side by side share it
LINEAR = 20.0  # ratio of two bars up to which both can be seen from zero on
STYLE: dict[Any, Any] = {
    "font.family": "sans-serif", "font.size": 9.0, "axes.edgecolor": FAINT, "axes.labelcolor": INK,
    "xtick.color": INK, "ytick.color": INK, "axes.spines.top": False, "axes.spines.right": False,
    "axes.grid": True, "grid.color": GRID, "grid.linewidth": 0.6, "svg.fonttype": "none",
    "svg.hashsalt": "steerd", "legend.facecolor": PAGE, "legend.edgecolor": "none",
    "axes.titlesize": 9.5, "axes.titlelocation": "left", "text.color": INK, "axes.titlecolor": INK,
    "axes.facecolor": "none", "axes.axisbelow": True,
}  # fmt: skip


@dataclass(frozen=True)
class Diagrams:
    """Diagrams that are drawn where they are shown: a page's, or a figure's."""

    plot: Callable[..., None]  # fills the axes, which come first, with what they are `about`
    height: float  # of a diagram [inch]
    about: Sequence[Any] = ()
    count: int = 1  # how many diagrams
    columns: int = 2  # how many of them fill the page's width
    colours: Mapping[str, str] = field(default_factory=dict)  # what they stand for, by name

    def __html__(self) -> str:
        """Markup: side by side where there is room, else below each other."""
        with rc_context(STYLE):
            size = WIDTH / self.columns, self.height
            axes = [Figure(size, layout="constrained").subplots() for _ in range(self.count)]
            self.plot(*axes, *self.about)
            diagrams = "".join(map(_draw, axes))
        names = "".join(
            f'<span style="--of:var(--{IN_PAGE[colour]})">{escape(name)}</span>'
            for name, colour in self.colours.items()
        )
        wide = 48.0 / self.columns
        return f'<p class="names">{names}</p><div style="--wide:{wide:.1f}rem">{diagrams}</div>'


def plot_report(title: str, shown: Sequence[Diagrams]) -> Figure:
    """A report's diagrams as one figure."""
    heights = [each.height * -(-each.count // each.columns) for each in shown]
    colours = {name: colour for each in shown for name, colour in each.colours.items()}
    with rc_context(STYLE):
        figure = Figure((WIDTH, sum(heights) + 0.8), layout="constrained")
        parts = figure.subfigures(len(shown), 1, squeeze=False, height_ratios=heights)[:, 0]
        for part, each in zip(parts, shown, strict=True):
            columns = min(each.columns, each.count)
            grid = part.add_gridspec(-(-each.count // columns), columns)
            axes = [part.add_subplot(grid[divmod(i, columns)]) for i in range(each.count)]
            each.plot(*axes, *each.about)
        figure.suptitle(title, fontsize=10)
        lines = [Line2D([], [], color=c, lw=3.0, label=name) for name, c in colours.items()]
        figure.legend(handles=lines, fontsize=8, loc="outside upper right", ncols=len(lines))
        return figure


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
