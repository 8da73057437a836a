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
    add_sessions(parser)
    option(parser, "-o --output", "FILE.html", "default: beside the session", type=Path)
    text = "of two drives: the second comes so much later (default: found from the drives)"
    option(parser, "--shift", "SECONDS", text, type=float)


def run(args: argparse.Namespace) -> None:
    from steerd.daemon.common.written import check_outputs, write_outputs

    paths = pick_sessions(args.sessions)
    if args.shift is not None and len(paths) != 2:
        raise SteerdError("--shift is for two drives", "name two", ExitCode.USAGE)
    name = "-".join(path.stem for path in paths)[:120]
    output = args.output or paths[0].with_name(f"{name}.html")
    check_outputs({"-o": output})
    other = output.suffix.lower() in (*_FIGURES, ".csv")
    if other and len(paths) > 1:
        what = f"{output.name}: several drives are compared on a page"
        raise SteerdError(what, "-o FILE.html", ExitCode.USAGE)
    if len(paths) > 1:
        from steerd.daemon.sessions.compare import render_comparison
        from steerd.daemon.sessions.info import load_recording

        content = render_comparison(list(map(load_recording, paths)), args.shift).encode()
    else:
        content = _draw(paths[0], output.suffix.lower())
    write_outputs({output: content})
    print(f"{output}: {len(content) / 1e6:.1f} MB{'' if other else '; open it in a browser'}")


def _draw(path: Path, suffix: str) -> bytes:
    from steerd.daemon.sessions.info import load_recording, make_session_report
    from steerd.daemon.sessions.plot_data import make_drawing
    from steerd.daemon.sessions.plot_page import make_csv, make_page
    from steerd.daemon.sessions.text import print_warnings

    read = load_recording(path)
    report = make_session_report(read)
    print_warnings(report.warnings)
    drawing = make_drawing(read)
    if suffix in _FIGURES:
        from steerd.daemon.analysis.figures import plot_session, save_figure

        return save_figure(plot_session(drawing, path.name), suffix[1:])
    text = make_csv(drawing) if suffix == ".csv" else make_page(report, drawing)
    return text.encode()
