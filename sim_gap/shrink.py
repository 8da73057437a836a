"""How far the gap shrinks: told before the reserved drives are opened, then measured there."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim_gap.candidates import Score, blocks_of
from sim_gap.descent import Fitted
from sim_gap.engine import Engine
from sim_gap.noise import Noise, whitened
from sim_gap.residuals import Gap, gap_of, interval_of, ratios, robust_mean, settled
from sim_gap.space import make_space

Array = NDArray[np.float64]

_EXCESS_LEAST = 0.05
"""Below this there is hardly an excess to take a share of."""


@dataclass(frozen=True)
class Shrinkage:
    """Share of the excess whitened error that the explanation removes.

    Attributes:
        predicted: on windows left out of the fit; `low` and `high` its 90 % interval.
        measured: on the reserved drives, None without them.
        digest: SHA-256 of `text`, the prediction as it was written.
        before: the gap on the reserved drives; `after` with the explanation.
    """

    predicted: float
    measured: float | None
    low: float
    high: float
    digest: str
    text: str
    before: Gap | None
    after: Gap | None


def explained_share(before: float, after: float, floor: float) -> float:
    """Share of the excess over `floor` that is gone, within 0 and 1."""
    excess = max(before - floor, _EXCESS_LEAST)
    return float(np.clip((before - after) / excess, 0.0, 1.0))


def predict(before: Fitted, chosen: Score, blocks: NDArray[np.int64]) -> tuple[float, float, float]:
    """Expected share on unseen drives with its 90 % interval, from windows left out."""
    base = ratios(before)
    after = np.expm1(chosen.losses / before.at.dof)
    share = explained_share(robust_mean(base), robust_mean(after), 1.0)
    draws = zip(interval_of(base, blocks), interval_of(after, blocks), strict=True)
    shares = [explained_share(float(a), float(b), 1.0) for a, b in draws]
    low, high = (float(v) for v in np.percentile(shares, [5.0, 95.0]))
    return share, low, high


def measure(
    engine: Engine,
    chosen: Score,
    noise: Noise,
    predicted: tuple[float, float, float],
    digest: str,
    text: str,
) -> Shrinkage:
    """The same share on reserved drives; nothing is refitted but the windows' starts."""
    base = make_space(engine.superset, ())
    rough = settled(engine, base, base.centre)
    best = settled(engine, chosen.fitted.space, chosen.fitted.z, rough.x)
    engine = whitened(engine, best, noise)
    before = settled(engine, base, base.centre, rough.x)
    after = settled(engine, chosen.fitted.space, chosen.fitted.z, best.x)
    blocks = blocks_of(engine)
    gaps = gap_of(engine, before, blocks), gap_of(engine, after, blocks)
    share = explained_share(gaps[0].whitened, gaps[1].whitened, 1.0)
    return Shrinkage(predicted[0], share, predicted[1], predicted[2], digest, text, *gaps)
