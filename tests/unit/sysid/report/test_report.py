"""One report, two renderers: a page that escapes everything, and aligned lines for a terminal."""

from dataclasses import replace

from markupsafe import Markup

from steerd.sysid.report.page import render_report
from steerd.sysid.report.report import Card, Cell, Fold, Report, Section, Table, format_table

TABLE = Table(
    ("name", "value", "remark"),
    [("mass", "3.74", "as `steerd plot` shows"), (Cell("lag", "quiet"), "0.1", Cell("", "strong"))],
    words=(2,),
)
SECTIONS = [Section("Part", "Text.", table=TABLE)]
REPORT = Report("A <b> title", SECTIONS, "", subject="x.mcap", lead="It is.")


def test_a_page_shows_its_parts_escapes_them_and_leaves_out_what_is_empty():
    page = render_report(REPORT)
    assert "<title>A &lt;b&gt; title: x.mcap · steerd</title>" in page
    assert '<p class="meta">x.mcap</p>' in page
    assert "<h2>Part</h2>" in page
    assert "as <code>steerd plot</code> shows" in page
    assert '<td class="quiet">lag</td>' in page
    assert '<td class="strong words"></td>' in page
    page = render_report(replace(REPORT, subject="", sections=[Section(text="Alone.")]))
    body = page[page.index("<body") :]
    for part in ("cards", "verdict", "<h2>", "<table>", "<figure", "<details>", 'class="note"'):
        assert part not in body
    drawn = [Markup("<svg></svg>")]
    fold = Section("", "", ["<this>"], Table("abcde", []), drawn, Fold("more", "of it"))
    more = replace(REPORT, sections=[fold], cards=[Card("e1", "3 mm", "largest")], verdict="good")
    body = render_report(more)
    for part in ("<b>3 mm</b>", ">good</span>", "&lt;this&gt;", "<svg></svg>", "of it", '"wide"'):
        assert part in body


def test_a_terminal_shows_names_to_the_left_and_figures_to_the_right():
    lines = ["name  value", "mass   3.74", "lag     0.1"]
    assert list(format_table(TABLE.pick("name", "value"))) == lines
