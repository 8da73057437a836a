"""How values show themselves in a notebook: a line as a part of others, the screen on its own."""

from html import escape
from typing import TypeVar

T = TypeVar("T")


def shown(cls: type[T]) -> type[T]:
    """A class whose `str` is its screen: `repr` is its verdict or its first line."""

    def line(self: T) -> str:
        lines = str(self).strip().splitlines()
        first = next((text for text in lines if text.startswith("verdict")), lines[0])
        return f"<steerd.{cls.__name__}: {' '.join(first.split())}>"

    def page(self: T) -> str:
        return f"<pre>{escape(str(self))}</pre>"

    cls.__repr__ = line  # type: ignore[assignment]
    cls._repr_html_ = page  # type: ignore[attr-defined]
    return cls
