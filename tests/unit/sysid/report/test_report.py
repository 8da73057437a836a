"""One report, two renderers: a page that escapes everything, and aligned lines for a terminal."""

import pickle
from dataclasses import replace

import numpy as np
from markupsafe import Markup

from steerd.car_model.native import windows
from steerd.car_model.params import DEFAULT_CAR
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


# Work on a cluster: compiled cars find their own code there, joblib's work goes there.
def test_a_compiled_car_travels_without_its_code():
    kernels = windows.make_kernels()
    data = pickle.dumps(kernels)
    assert len(data) < 5_000
    again = pickle.loads(data)
    assert again.names == kernels.names
    held = windows.HeldCommands(np.tile([0.1, 1.5], (50, 1)), 0.01)
    blocks = windows.make_window_blocks(np.array([[0, 50, 0]]), np.zeros(1))
    first = np.array([[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]])
    parameters = np.array(DEFAULT_CAR)
    paths = [windows.march(each, parameters, first, held, blocks, 50) for each in (kernels, again)]
    np.testing.assert_array_equal(*(windows.view_by_window(path, 1) for path in paths))
