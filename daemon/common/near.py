"""Close matches: what somebody meant by a word that is not known."""

import difflib
from collections.abc import Iterable


def find_near(word: str, known: Iterable[str]) -> str:
    """The known word that is most like another one; empty if none is."""
    near = difflib.get_close_matches(word.lower(), list(known), n=1)
    return near[0] if near else ""


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """`did you mean X?`, or nothing."""
    near = find_near(word, known)
    return f"did you mean {near}?" if near else ""
