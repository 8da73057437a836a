"""Every page that steerd writes, in windows of a real browser: no text is lost, none too pale."""

import os
import re
import shutil

import pytest

from steerd.daemon.cli.main import run_cli
from tests.browser import CHROMIUM, NO_BROWSER, browsing

pytestmark = [pytest.mark.slow, pytest.mark.skipif(not CHROMIUM, reason=NO_BROWSER)]

PAGES = ("drive", "compare", "sessions", "identify", "gap", "sweep", "batch")
SWEEP = """
seeds = 4
duration = 3.5
[vary]
path = ["figure8", "circle:radius=2,dir=cw"]
"effect.steer_delay" = { low = 0.0, high = 0.05 }
"mocap.position_noise" = { median = 0.001, factor = 2.0 }
"""
DRAWN = "document.documentElement.dataset.ready || !document.getElementById('panels')"


@pytest.fixture(scope="module")
def browser():
    with browsing() as one:
        yield one


@pytest.fixture(scope="module")
def pages(tmp_path_factory):
    """One page of each kind, all of one drive with a hidden effect."""
    folder = tmp_path_factory.mktemp("pages")
    session, car = folder / "late.mcap", folder / "car.toml"
    drive = "run --sim --fast --path figure8 --speed 1.8 --duration 24 --effect steer_delay=0.05"
    for line in (
        f"{drive} --record {session}",
        f"plot {session} -o {folder}/drive.html",
        f"run --sim --fast --speed 1.8 --duration 12 --record {folder}/prompt.mcap",
        f"plot {session} {folder}/prompt.mcap -o {folder}/compare.html",
        f"sessions --folder {folder} --page",
        f"identify {session} -o {car} --report {folder}/identify.html",
        f"diagnose {session} --report {folder}/gap.html",
    ):
        assert run_cli(line.split()) == 0, line
    # The pages of many drives: a short sweep, and a drive copied to eight days.
    (folder / "sweep.toml").write_text(SWEEP)
    days = folder / "days"
    days.mkdir()
    for day in range(8):
        copy = days / f"a drive with a long name on the day {day}.mcap"
        shutil.copyfile(session, copy)
        os.utime(copy, (0, 1_772_366_400 + 86_400 * day))
    (days / "junk.mcap").write_text("no session")
    for argv in (
        ["sweep", str(folder / "sweep.toml"), "--page", str(folder / "sweep.html")],
        ["batch", "summarise", str(days), "--page", str(folder / "batch.html")],
    ):
        assert run_cli([*argv, "--jobs", "1"]) == 0, argv
    return folder


@pytest.mark.parametrize("name", PAGES)
@pytest.mark.parametrize("width", [1280, 420])
@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
def test_a_page_is_whole_in_every_window(browser, pages, tmp_path, name, width, dark):
    browser.open((pages / f"{name}.html").as_uri(), width, dark=dark)
    assert browser.ask("navigator.language") == ("en-US" if name == "drive" else "en-US@posix")
    browser.wait(DRAWN)
    assert (browser.console, browser.faults_of_layout()) == ([], [])
    browser.screenshot(tmp_path / "page.png")
    assert (tmp_path / "page.png").stat().st_size > 30_000


SETTLE = "new Promise(done => setTimeout(done, 200))"
OVER = "document.querySelector('.panel:nth-child(4) .u-over').getBoundingClientRect().toJSON()"


def point(browser, kind, share, **more):
    """The pointer over the fourth curve, at a share of its width."""
    box = browser.ask(OVER)
    where = {"x": box["x"] + share * box["width"], "y": box["y"] + 20}
    browser.call("Input.dispatchMouseEvent", type=kind, **where, **more)


def press(browser, key, modifiers=0):
    browser.call("Input.dispatchKeyEvent", type="keyDown", key=key, code=key, modifiers=modifiers)
    browser.ask(SETTLE)
    return browser.ask("+document.getElementById('time').value")


def count_values(browser):
    """How many curves show a number rather than a dash."""
    shown = browser.ask("[...document.querySelectorAll('.u-value')].map(e => e.textContent)")
    return sum(bool(re.fullmatch(r"-?\d[\d.]*", value)) for value in shown)


def test_pointer_slider_and_arrow_keys_choose_the_instant_of_all_curves(browser, pages):
    browser.open((pages / "drive.html").as_uri(), language="de-DE")
    browser.wait(DRAWN)
    titles = browser.ask("[...document.querySelectorAll('h2')].map(e => e.firstChild.data.trim())")
    assert titles[:4] == [
        "lateral error e1", "heading error e2", "speed", "steering angle (left +)",
    ]  # fmt: skip
    assert browser.ask("document.documentElement.dataset.ready") == "11"
    assert count_values(browser) == 0
    point(browser, "mouseMoved", 0.5)
    browser.wait("document.getElementById('clock').textContent.startsWith('t = ')")
    assert count_values(browser) > 8
    # The values under the pointer are longer than the dashes without one.
    assert (browser.faults_of_layout(), browser.console) == ([], [])
    browser.open((pages / "drive.html").as_uri())
    browser.wait(DRAWN)
    car = "document.getElementById('track').toDataURL()"
    lines = "[...document.querySelectorAll('.u-cursor-x')].map(e => e.style.transform)"
    browser.ask("Object.assign(document.getElementById('time'), {value: 9.5})"
                ".dispatchEvent(new Event('input'))")  # fmt: skip
    browser.wait("document.getElementById('clock').textContent === 't = 9.50 s · running'")
    before = browser.ask(car)
    assert len(set(browser.ask(lines))) == 1
    assert count_values(browser) > 8
    assert press(browser, "ArrowRight") == pytest.approx(9.55, abs=1e-6)
    assert press(browser, "ArrowLeft", modifiers=8) == pytest.approx(8.55, abs=1e-6)
    assert browser.ask(car) != before
    # What a zoomed window does not show is moved into it.
    for kind, share in (("mousePressed", 0.1), ("mouseMoved", 0.2), ("mouseReleased", 0.2)):
        point(browser, kind, share, button="left", clickCount=1)
    at = [press(browser, "ArrowRight", modifiers=8) for _ in range(5)]
    assert at[4] - at[0] == pytest.approx(4.0, abs=0.05)
    assert (browser.faults_of_layout(), browser.console) == ([], [])


def test_a_damaged_page_says_so(browser, pages, tmp_path):
    page = tmp_path / "drive.html"
    page.write_text((pages / "drive.html").read_text().replace('"data":"eN', '"data":"AA', 1))
    browser.open(page.as_uri())
    browser.wait("document.body.textContent.includes('could not be drawn')")
    assert not browser.ask("document.documentElement.dataset.ready")


BROKEN = """<!doctype html><style>body{margin:0;font:16px sans-serif}
p{position:absolute;top:0;left:9px;margin:0}
</style><p>one text</p><p style="left:20px">over another</p>
<p style="top:60px;left:9px;width:30px;overflow:hidden;white-space:nowrap">cut off here</p>
<p style="top:90px;left:3000px">far out</p><p style="top:120px;color:#eee">too pale</p>"""


def test_the_look_finds_what_is_broken(browser, tmp_path):
    page = tmp_path / "broken.html"
    page.write_text(BROKEN)
    browser.open(page.as_uri())
    faults = " ".join(browser.faults_of_layout())
    for fault in ('"one text" lies over', "cut off by", "beyond the edge", "too pale", "px wide"):
        assert fault in faults, fault


def test_drives_that_differ_by_rounding_alone_have_readable_axes(pages):
    """Matplotlib would write 1e-11+5.8213168e-3 above a diagram of eight equal drives."""
    assert not re.search(r"1e.\d+\+", (pages / "batch.html").read_text(encoding="utf-8"))
