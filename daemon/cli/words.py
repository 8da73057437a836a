"""Values of options that stand between commas."""

from pathlib import Path


def split_list(text: str) -> list[str]:
    """The words of a value."""
    return [part for part in text.split(",") if part]


def split_paths(text: str) -> list[Path]:
    """Files."""
    return [Path(part) for part in split_list(text)]


def split_held_out(text: str) -> list[int | Path]:
    """What `--held-out` names: numbers, and files."""
    return [int(p) if p.lstrip("-").isdigit() else Path(p) for p in split_list(text)]
