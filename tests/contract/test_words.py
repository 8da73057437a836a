"""Product code, docs and screen texts use the field's words: docs/glossary.md lists the others.

Strings, comments, docstrings and identifiers are all text of a file, so the file is what is read.
"""

import ast
import re
from functools import cache
from typing import NamedTuple

import pytest

from tests.contract.size import GOALS, ROOT, list_files

GLOSSARY = "docs/glossary.md"
PRODUCT = (*GOALS["product"][0], "config", "examples", "benchmarks")
PAGES = ("README.md", "CONTRIBUTING.md", "CHANGELOG.md", "docs")
SUFFIXES = (".py", ".pyi", ".toml", ".md", ".html", ".js", ".css")
FOREIGN = ("uplot.min.js", "uplot.min.css")  # files of other authors, taken as they are
KEYS: dict[str, str] = {"sim_gap/lane_comparison.py": '"nearer":'}
"""Keys of JSON contracts that programs read (here `steerd.gap/1`): they stay as they are."""


class Banned(NamedTuple):
    """One row of the glossary's table."""

    word: str
    scope: str
    instead: str


@cache
def banned_words() -> tuple[Banned, ...]:
    """The table between the glossary's markers."""
    text = (ROOT / GLOSSARY).read_text(encoding="utf-8")
    table = text.partition("<!-- banned: begin -->")[2].partition("<!-- banned: end -->")[0]
    rows = re.findall(r"^\| `([^`]+)` \| (\w+) \| (.+?) \|$", table, re.MULTILINE)
    return tuple(Banned(*row) for row in rows)


def make_pattern(word: str) -> re.Pattern[str]:
    """Whole words; an underscore or a digit ends a word, a line break may stand for a blank."""
    body = re.escape(word).replace(r"\*", "[a-z]*").replace(r"\ ", r"\s+(?:#\s*)?")
    if word.endswith("_*"):
        body = re.escape(word[:-1]) + r"\w*"
    return re.compile(rf"(?<![A-Za-z]){body}(?![A-Za-z])", re.IGNORECASE)


def names_in(source: str) -> tuple[set[tuple[int, str]], set[tuple[int, str]]]:
    """Identifiers that a Python file binds, and its functions, each with its line."""
    names, functions = set(), set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            functions.add((node.lineno, node.name))
        elif isinstance(node, ast.ClassDef):
            names.add((node.lineno, node.name))
        elif isinstance(node, ast.arg):
            names.add((node.lineno, node.arg))
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            names.add((node.lineno, node.id))
    return names | functions, functions


def find_words(text: str, is_python: bool) -> list[str]:
    """Every banned word with its line and its replacement."""
    found = []
    text = text.replace(".tell()", ".position()")  # the name of a method of Python's files
    lowered = text.lower()
    names, functions = names_in(text) if is_python else (set(), set())
    for row in banned_words():
        if row.word.split()[0].partition("*")[0].lower() not in lowered:
            continue  # most words are in no file: looking for their letters is much quicker
        pattern = make_pattern(row.word)
        if row.scope == "text":
            lines = [text.count("\n", 0, m.start()) + 1 for m in pattern.finditer(text)]
        else:
            pool = functions if row.scope == "function" else names
            lines = sorted(line for line, name in pool if pattern.fullmatch(name.strip("_")))
        found += [f"{line}: `{row.word}`, say: {row.instead}" for line in lines]
    return found


FILES = [f for f in list_files((*PRODUCT, *PAGES), SUFFIXES) if not f.endswith(FOREIGN)]


def read(name: str) -> str:
    text = (ROOT / name).read_text(encoding="utf-8")
    if name == GLOSSARY:
        return text.partition("<!-- banned: begin -->")[0]
    return text.replace(KEYS[name], '"":', 1) if name in KEYS else text


def test_the_glossary_has_a_table_and_no_word_stands_twice():
    words = [(row.word, row.scope) for row in banned_words()]
    assert len(words) > 30
    assert len(set(words)) == len(words)
    assert {row.scope for row in banned_words()} == {"text", "name", "function"}


@pytest.mark.parametrize("name", FILES)
def test_a_file_uses_the_words_of_the_glossary(name):
    found = find_words(read(name), is_python=name.endswith(".py"))
    assert not found, f"{name}:" + "\n  ".join(["", *found])


def test_what_is_exempt_still_needs_it():
    for name, key in KEYS.items():
        text = (ROOT / name).read_text(encoding="utf-8")
        assert text.count(key) == 1, f"{name}: {key} is gone, remove"
        assert find_words(key, is_python=False), f"{key}: no word of the table, remove"
