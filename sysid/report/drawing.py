"""Style of the reports' figures, and their conversion to inline SVG without file or network."""

import io
import re
from typing import Any

from matplotlib.figure import Figure
from numpy.typing import NDArray

INK, FAINT = "#1f2933", "#9aa5b1"
MEASURED, AFTER, BEFORE = "#1f2933", "#d9480f", "#4c8dca"
WIDTH = 9.6
"""Of a figure that fills the page [inch]."""
STYLE: dict[Any, Any] = {
    "font.family": "sans-serif", "font.size": 9.0, "axes.edgecolor": FAINT, "axes.labelcolor": INK,
    "xtick.color": INK, "ytick.color": INK, "axes.spines.top": False, "axes.spines.right": False,
    "axes.grid": True, "grid.color": "#e4e7eb", "grid.linewidth": 0.6, "svg.fonttype": "none",
    "svg.hashsalt": "steerd", "legend.frameon": False, "axes.titlesize": 9.5,
    "axes.titlelocation": "left",
}  # fmt: skip


def make_figure(rows: int, columns: int, height: float) -> tuple[Figure, NDArray[Any]]:
    """A figure as wide as the page and its axes (rows, columns)."""
    figure = Figure(figsize=(WIDTH, height), layout="constrained")
    return figure, figure.subplots(rows, columns, squeeze=False)


def to_svg(figure: Figure, label: str = "") -> str:
    """The figure as markup that scales with the page; `label` is for screen readers."""
    text = io.StringIO()
    figure.savefig(text, format="svg", metadata={"Date": None, "Creator": None})
    markup = text.getvalue()
    markup = markup[markup.index("<svg") :]
    markup = re.sub(r"<metadata>.*?</metadata>", "", markup, flags=re.DOTALL)
    size = f'width="{figure.get_figwidth() / WIDTH:.0%}"'
    if label:
        size = f'role="img" aria-label="{label}" {size}'
    return re.sub(r'width="[\d.]+pt" height="[\d.]+pt"', size, markup, count=1)
