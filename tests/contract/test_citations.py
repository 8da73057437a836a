"""Every page that code, tests, benchmarks and pages cite is in the repository, with its anchor."""

import os
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import NamedTuple

import pytest

from tests.contract.size import ROOMS, ROOT, list_files

TEXT = (".py", ".pyi", ".md", ".toml", ".yaml", ".yml", ".html", "Makefile")
HISTORY = ROOT / "CHANGELOG.md"  # what it names was there when it was written

CITED = re.compile(r"(?<![\w./-])(docs/[\w./-]+\.md)\b(?:#([\w.-]*\w))?")
LINKED = re.compile(r"\]\((?!\w+:)([^)\s#]*)(?:#([^)\s]+))?\)")
FENCE = re.compile(r"^(```|~~~).*?^\1", re.M | re.S)
FOLDERS = "|".join((*ROOMS, "benchmarks", "config", "examples", "tests"))
NAMED_FILE = re.compile(rf"`((?:{FOLDERS})/[\w./-]+\.\w+)`")


class Citation(NamedTuple):
    """Who cites what, both relative to the root; the anchor may be empty."""

    source: str
    page: str
    anchor: str


def files() -> list[Path]:
    """Every text file of the repository; links between folders are not followed."""
    return [ROOT / name for name in list_files((".",), TEXT) if ROOT / name != HISTORY]


def find_citations(path: Path) -> Iterator[Citation]:
    """Pages named by their path from the root, and in pages also those that are linked."""
    text = path.read_text(encoding="utf-8")
    source = str(path.relative_to(ROOT))
    if path != Path(__file__).resolve():
        yield from (Citation(source, page, anchor) for page, anchor in CITED.findall(text))
    if path.suffix == ".md":
        for target, anchor in LINKED.findall(FENCE.sub("", text)):
            page = os.path.relpath((path.parent / target) if target else path, ROOT)
            yield Citation(source, page, anchor)


def find_anchors(text: str) -> set[str]:
    """Explicit ids, and the slugs that headings get (GitHub's rule: repeats are numbered)."""
    text = FENCE.sub("", text)
    anchors = set(re.findall(r"<\w+[^>]*\bid=\"([^\"]+)\"", text))
    seen: dict[str, int] = {}
    for title in re.findall(r"^#{1,6} +(.+?) *#*$", text, re.M):
        slug = make_slug(title)
        count = seen[slug] = seen.get(slug, -1) + 1
        anchors.add(f"{slug}-{count}" if count else slug)
    return anchors


def make_slug(title: str) -> str:
    bare = re.sub(r"<[^>]*>|\[([^\]]*)\]\([^)]*\)", r"\1", title).strip().lower()
    return re.sub(r"[^\w\- ]", "", bare).replace(" ", "-")


@cache
def anchors_of(page: str) -> frozenset[str]:
    return frozenset(find_anchors((ROOT / page).read_text(encoding="utf-8")))


def find_fault(citation: Citation) -> str:
    """What is wrong with a citation; empty if nothing is."""
    path = ROOT / citation.page
    if not path.exists():
        return f"{citation.source}: {citation.page} is not there"
    known = anchors_of(citation.page) if path.suffix == ".md" else {citation.anchor}
    if citation.anchor and citation.anchor not in known:
        return f"{citation.source}: {citation.page} has no anchor {citation.anchor}"
    return ""


def test_every_citation_resolves():
    cited = [citation for path in files() for citation in find_citations(path)]
    reference = [citation for citation in cited if citation.page.startswith("docs/reference/")]
    assert len({c.source for c in reference if c.source.endswith(".py")}) > 25
    faults = sorted({fault for citation in cited if (fault := find_fault(citation))})
    assert not faults, "\n".join(faults)


def test_a_page_names_files_that_are_there():
    pages = [path for path in files() if path.suffix == ".md"]
    assert ROOT / "CONTRIBUTING.md" in pages
    named = {page: NAMED_FILE.findall(page.read_text(encoding="utf-8")) for page in pages}
    each = ((page.relative_to(ROOT), name) for page, names in named.items() for name in names)
    wrong = [f"{page}: {name}" for page, name in each if not (ROOT / name).exists()]
    assert not wrong, "\n".join(wrong)


@pytest.mark.parametrize(
    "page", sorted((ROOT / "docs" / "reference").glob("*.md")), ids=lambda page: page.name
)
def test_an_anchor_stands_once(page):
    ids = re.findall(r"<a id=\"([^\"]+)\"", page.read_text(encoding="utf-8"))
    assert sorted(set(ids)) == sorted(ids)


def test_a_wrong_anchor_or_page_is_found():
    page = "docs/reference/safety-requirements.md"
    assert not find_fault(Citation("x.py", page, "w5"))
    assert "no anchor w99" in find_fault(Citation("x.py", page, "w99"))
    assert "is not there" in find_fault(Citation("x.py", "docs/nothing.md", ""))
