"""The moving picture of README and site, from real runs: `make media` writes docs/img/gap.gif.

A drive whose steering is 50 ms late, the simulation that does not know it, what `diagnose` says of
the drive, and the simulation with that. Every curve is a run of the whole loop in virtual time.
"""

import sys
from pathlib import Path

import matplotlib as mpl

mpl.use("agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from PIL import Image

import steerd

HIDDEN = 0.05  # dead time that the drive hides [s]
RUN = {"path": "figure8", "speed": 1.8}
DRIVING, READING, CLOSING, RESTING = 36, 14, 20, 26  # frames of the four scenes
FRAME_MS = 90
PICTURE = Path(__file__).parent / "img" / "gap.gif"
INK, SIMULATED, FOUND = "#202830", "#d1495b", "#2a7f62"


def lap(drive: steerd.Session, begin: float = 10.0, end: float = 20.0) -> np.ndarray:
    """Place, lateral error [mm] and time from the start of a piece of a drive, in columns."""
    state = drive.table("state")
    rows = state[(state["t"] >= begin) & (state["t"] < end)]
    return np.stack([rows["x"], rows["y"], 1e3 * rows["e1"], rows["t"] - begin], axis=1)[::4]


def draw(figure: Figure, curves: dict[str, np.ndarray], said: str, frame: int) -> None:
    """One frame."""
    drive, base, better = curves["drive"], curves["base"], curves["better"]
    seen = min(len(drive), 1 + (frame + 1) * len(drive) // DRIVING)
    named = frame >= DRIVING
    closed = float(np.clip((frame - DRIVING - READING) / CLOSING, 0.0, 1.0))
    share = closed * closed * (3.0 - 2.0 * closed)
    figure.clear()
    lane, error = figure.subplots(1, 2, width_ratios=(1.0, 1.75))
    lane.plot(drive[:, 0], drive[:, 1], color="#c9ced6", linewidth=5, solid_capstyle="round")
    lane.plot(*drive[:seen, :2].T, color=INK, linewidth=1.5)
    lane.plot(*drive[seen - 1, :2], "o", color=INK, markersize=9)
    lane.set_aspect("equal")
    lane.axis("off")
    lane.set_title("a drive, 1.8 m/s", loc="left", fontsize=11, color=INK)
    shown = base[:, 2] + share * (better[:, 2] - base[:, 2])
    color = FOUND if share > 0.5 else SIMULATED
    error.plot(drive[:seen, 3], drive[:seen, 2], color=INK, linewidth=2.5, label="the car")
    error.plot(base[:seen, 3], shown[:seen], color=color, linewidth=1.8, label="simulation")
    error.set(xlim=(0, 10), ylim=(-10, 10), xlabel="time [s]", ylabel="lateral error [mm]")
    error.spines[["top", "right"]].set_visible(False)
    error.legend(loc="lower left", ncols=2, frameon=False, fontsize=10)
    off = float(np.sqrt(np.mean((drive[:, 2] - shown) ** 2)))
    title = f"simulation and car differ by {off:.1f} mm" if seen == len(drive) else "the gap"
    error.set_title(title, loc="left", fontsize=11, color=color)
    if named:
        error.text(0.02, 0.9, said, transform=error.transAxes, fontsize=11, color=FOUND)
    figure.tight_layout(pad=0.6)


def main() -> None:
    """Drive, diagnose, drive again, and write the picture."""
    drive = steerd.simulate(duration=60, effects={"steer_delay": HIDDEN}, **RUN)
    gap = steerd.diagnose(drive)
    cause = gap.causes[0]
    value = cause.parameters["delay"]
    sessions = {
        "drive": drive,
        "base": steerd.simulate(duration=22, **RUN),
        "better": steerd.simulate(duration=22, effects={cause.effect: value.value}, **RUN),
    }
    said = (
        f"steerd diagnose: {cause.effect} {1e3 * value.value:.0f} ± {1e3 * value.sd:.0f} ms,"
        f" {100 * cause.confidence:.0f} %"
    )
    write(sessions, said)


def write(sessions: dict[str, steerd.Session], said: str) -> None:
    """The picture of three drives: `drive`, `base` and `better`."""
    curves = {name: lap(session) for name, session in sessions.items()}
    rows = min(map(len, curves.values()))
    curves = {name: curve[:rows] for name, curve in curves.items()}
    figure = plt.figure(figsize=(8.2, 3.3), dpi=96)
    pictures = []
    for frame in range(DRIVING + READING + CLOSING + RESTING):
        draw(figure, curves, said, frame)
        figure.canvas.draw()
        pixels = Image.fromarray(np.asarray(figure.canvas.buffer_rgba())).convert("RGB")
        pictures.append(pixels.quantize(32, dither=Image.Dither.NONE))
    pictures[0].save(
        PICTURE, save_all=True, append_images=pictures[1:], duration=FRAME_MS, loop=0, optimize=True
    )
    sys.stdout.write(f"{PICTURE}: {PICTURE.stat().st_size / 1e3:.0f} kB; {said}\n")


if __name__ == "__main__":
    main()
