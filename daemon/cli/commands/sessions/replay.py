"""Feed a recorded session through the loop and report commands that differ."""

import argparse

from steerd.daemon.cli.arguments import add_session, option, pick_session


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_session(parser)
    option(parser, "--show", "N", "differences to print", type=int, default=5)


def run(args: argparse.Namespace) -> int:
    from steerd.daemon.common.progress import show_progress
    from steerd.daemon.offline.replay import check_same, describe_difference, replay
    from steerd.daemon.sessions.info import load_session
    from steerd.daemon.sessions.text import print_warnings

    path = pick_session(args.session)
    session = load_session(path)
    print_warnings([warning.message for warning in session.warnings])
    count = first_ns = 0
    with show_progress("replaying", float(session.info().count), even=True) as advance:
        going, differences = replay(session, path.name, lambda done: advance(float(done)))
        for difference in differences:
            first_ns = first_ns or difference.t_ns
            count += 1
            if count <= args.show:
                print(describe_difference(difference, first_ns))
    code = check_same(count, going.ticks)
    verdict = f"{count} of them differ" if count else "all equal the recorded ones"
    print(f"{going.ticks} commands replayed: {verdict}")
    return code
