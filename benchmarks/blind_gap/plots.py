"""The two pictures of the report, as SVG: reliability and confusion by family."""

from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("svg")

import numpy as np
from matplotlib import pyplot as plt

from benchmarks.blind_gap.effects import FAMILY
from benchmarks.blind_gap.score import NO_GAP, NOT_NAMED, OUTSIDE, Rate, Scores

_STYLE: dict[Any, Any] = {"svg.hashsalt": "blind_gap", "font.size": 9}
_SAVE: dict[str, Any] = {"bbox_inches": "tight", "metadata": {"Date": None}}


def plot_calibration(scores: Scores, path: Path) -> None:
    """How often a name was right against the confidence it was given with."""
    with plt.rc_context(_STYLE):
        figure, axes = plt.subplots(figsize=(4.2, 3.8))
        axes.plot([0, 1], [0, 1], color="0.7", linewidth=1)
        bins = scores.reliability.bins
        for b in bins:
            low, high = Rate(round(b.right * b.count), b.count).interval
            axes.plot([b.confidence] * 2, [low, high], color="tab:blue", linewidth=1, alpha=0.6)
            axes.annotate(str(b.count), (b.confidence, b.right), xytext=(5, -9),
                          textcoords="offset points", fontsize=7)  # fmt: skip
        axes.scatter([b.confidence for b in bins], [b.right for b in bins],
                     s=[12 + 3 * b.count**0.8 for b in bins], alpha=0.9)  # fmt: skip
        axes.set(xlabel="confidence given", ylabel="share of names right (95 % interval)",
                 xlim=(0, 1.03), ylim=(-0.03, 1.03))  # fmt: skip
        axes.set_title(f"calibration error {100 * scores.reliability.ece:.1f} points,"
                       f" Brier score {scores.reliability.brier:.3f}", fontsize=9)  # fmt: skip
        figure.savefig(path, **_SAVE)
        plt.close(figure)


def confusion_axes() -> tuple[list[str], list[str]]:
    """Rows (what was hidden) and columns (what was named) of the confusion matrix."""
    families = list(dict.fromkeys(FAMILY.values()))
    return [*families, OUTSIDE, NO_GAP], [*families, NOT_NAMED, NO_GAP]


def plot_confusion(scores: Scores, path: Path) -> None:
    """Counts by family, shaded by the share of their row."""
    rows, columns = confusion_axes()
    counts = np.array([[scores.confusion.get((r, c), 0) for c in columns] for r in rows])
    share = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
    with plt.rc_context(_STYLE):
        figure, axes = plt.subplots(figsize=(5.4, 4.6))
        axes.imshow(share, cmap="Blues", vmin=0, vmax=1)
        axes.set_xticks(range(len(columns)), columns, rotation=40, ha="right")
        axes.set_yticks(range(len(rows)), rows)
        axes.set(xlabel="named", ylabel="hidden")
        for (i, j), count in np.ndenumerate(counts):
            if count:
                axes.text(j, i, str(count), ha="center", va="center",
                          color="white" if share[i, j] > 0.55 else "black")  # fmt: skip
        figure.savefig(path, **_SAVE)
        plt.close(figure)
