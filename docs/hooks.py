"""Formulas of the pages as pictures: MathJax at build time, so that a page fetches nothing.

MkDocs calls `on_page_content` for each page; `pymdownx.arithmatex` has marked the formulas.
"""

import re
from html import escape, unescape
from typing import Any

from quickjax import render

FORMULA = re.compile(r'<(span|div) class="arithmatex">\\([(\[])(.*?)\\[)\]]</\1>', re.DOTALL)


def set_formula(found: re.Match[str]) -> str:
    """One formula as SVG, with its text for who does not see it."""
    tag, kind, text = found.groups()
    picture = render(unescape(text), display=kind == "[")
    named = picture.replace('role="img"', f'role="img" aria-label="{escape(unescape(text))}"', 1)
    return f'<{tag} class="formula-{"block" if kind == "[" else "inline"}">{named}</{tag}>'


def on_page_content(html: str, **_: Any) -> str:
    """The page's HTML with its formulas set."""
    return FORMULA.sub(set_formula, html)
