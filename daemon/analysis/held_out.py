"""What is held out of a fit to judge it: every k-th part, or whole sessions by name."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from steerd.daemon.common.errors import ExitCode, SteerdError

EVERY = 4
"""Unless stated otherwise every 4th block or session is held out."""


@dataclass(frozen=True)
class HeldOut:
    """What validates.

    Attributes:
        every: every k-th block or session, 2 or more; 0 for none; None for the command's default.
        files: sessions that are held out whole; they exclude `every`.
    """

    every: int | None = None
    files: tuple[Path, ...] = ()

    def __post_init__(self) -> None:
        if self.every is not None and self.files:
            raise SteerdError(
                f"held out {self.every}: every K-th part, or files, not both", "", ExitCode.USAGE
            )
        if self.every is not None and (self.every < 0 or self.every == 1):
            what = f"held out {self.every}: every K-th part is held out, 2 or more"
            raise SteerdError(what, "0 holds nothing out", ExitCode.USAGE)


def split_list(given: Sequence[str]) -> list[str]:
    """Values of a repeatable option that may also be separated by commas."""
    return [part for text in given for part in text.split(",") if part]


def parse_held_out(given: Sequence[str]) -> HeldOut:
    """The values of `--held-out`: a number, or files.

    Raises:
        SteerdError: the number makes no sense, or stands beside files.
    """
    listed = split_list(given)
    numbers = [int(text) for text in listed if text.lstrip("-").isdigit()]
    files = tuple(Path(text) for text in listed if not text.lstrip("-").isdigit())
    if len(numbers) > 1:
        raise SteerdError("held out: one number, or files", "", ExitCode.USAGE)
    return HeldOut(numbers[0] if numbers else None, files)
