"""What a session lacks because its recorder did not keep up, in words."""

from collections.abc import Sequence

_SHOWN = 3


def describe_holes(dropped: str, holes: Sequence[tuple[int, int]], start_ns: int) -> str:
    """How many records are missing, and where; empty where none is.

    Args:
        dropped: how many, as the recorder counted.
        holes: stretches in which records are missing [UNIX ns].
        start_ns: of the session [UNIX ns].
    """
    if not holes:
        return ""
    spans = [((first - start_ns) * 1e-9, (last - start_ns) * 1e-9) for first, last in holes]
    shown = ", ".join(f"{first:.2f} to {last:.2f} s" for first, last in spans[:_SHOWN])
    more = f" and {len(spans) - _SHOWN} more stretches" if len(spans) > _SHOWN else ""
    seconds = sum(last - first for first, last in spans)
    count = "records" if dropped in ("", "0") else f"{dropped} records"
    return f"{count} were dropped within {seconds:.2f} s: {shown}{more}"
