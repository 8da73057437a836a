"""A drive as one HTML page: track, errors, commands and measurements, timing.

The page needs no network: send it by mail, or keep it beside the session.

steerd plot SESSION.mcap -o DRIVE.html
steerd plot SESSION.mcap -o DRIVE.svg    # the main curves; .png and .pdf too
steerd plot SESSION.mcap -o DRIVE.csv    # all curves and the track, every 10 ms
steerd plot BEFORE.mcap AFTER.mcap       # by place on the lane, and over time
"""

import argparse
from pathlib import Path

from steerd.daemon.cli.arguments import add_sessions, option, pick_sessions
from steerd.daemon.common.errors import ExitCode, SteerdError

_FIGURES = (".png", ".svg", ".pdf")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The sessions and the page."""
    add_sessions(parser)
    option(parser, "-o --output", "FILE.html", "default: beside the session", type=Path)
    text = "of two drives: the second comes so much later (default: found from the drives)"
    option(parser, "--shift", "SECONDS", text, type=float)


def run(args: argparse.Namespace) -> int:
    """Write the page and say where it is."""
    from steerd.daemon.common.written import check_outputs, write_outputs

    paths = pick_sessions(args.sessions)
    if args.shift is not None and len(paths) != 2:
        raise SteerdError("--shift is for two drives", "name two", ExitCode.USAGE)
    output = args.output or _default_output(paths)
    check_outputs({"-o": output})
    other = output.suffix.lower() in (*_FIGURES, ".csv")
    if other and len(paths) > 1:
        what = f"{output.name}: several drives are compared on a page"
        raise SteerdError(what, "-o FILE.html", ExitCode.USAGE)
    content = _compare(paths, args.shift) if len(paths) > 1 else _draw(paths[0], output.suffix)
    write_outputs({output: content})
    print(f"{output}: {len(content) / 1e6:.1f} MB{'' if other else '; open it in a browser'}")
    return ExitCode.OK


def _default_output(paths: list[Path]) -> Path:
    if len(paths) == 1:
        return paths[0].with_suffix(".html")
    return paths[0].with_name("-".join(path.stem for path in paths)[:120] + ".html")


def _draw(path: Path, suffix: str) -> bytes:
    from steerd.daemon.sessions.curves import make_csv
    from steerd.daemon.sessions.info import load_recording, make_session_report
    from steerd.daemon.sessions.plot_data import make_drawing
    from steerd.daemon.sessions.plot_model import with_model
    from steerd.daemon.sessions.plot_page import make_page
    from steerd.daemon.sessions.text import print_warnings

    read = load_recording(path)
    report = make_session_report(read)
    print_warnings(report.warnings)
    drawing = with_model(make_drawing(read), read)
    if suffix.lower() in _FIGURES:
        from steerd.daemon.analysis.figures import plot_session, save_figure

        return save_figure(plot_session(drawing, path.name), suffix[1:].lower())
    text = make_csv(drawing) if suffix.lower() == ".csv" else make_page(report, drawing)
    return text.encode()


def _compare(paths: list[Path], shift: float | None) -> bytes:
    from steerd.daemon.sessions.compare import render_recordings
    from steerd.daemon.sessions.info import load_recording

    return render_recordings([load_recording(path) for path in paths], shift).encode()
