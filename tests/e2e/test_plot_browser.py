"""The page of a drive in a real browser: every panel is drawn and the console stays empty."""

import re
import shutil
import subprocess

import pytest

from steerd.daemon.cli.main import run_cli

BROWSER = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("chrome")
FLAGS = [
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--hide-scrollbars",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--enable-logging=stderr",
    "--virtual-time-budget=10000",
    "--window-size=1400,1800",
]

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(BROWSER is None, reason="no chromium on this machine"),
]


def browse(page, profile, *more):
    command = [str(BROWSER), *FLAGS, f"--user-data-dir={profile}", *more, page.as_uri()]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)


def test_a_drive_is_drawn_without_an_error(drive_fast, tmp_path):
    session = drive_fast("--path figure8 --speed 1.5 --duration 6").session
    page, picture = tmp_path / "drive.html", tmp_path / "drive.png"
    assert run_cli(["plot", str(session), "-o", str(page)]) == 0
    shown = browse(page, tmp_path / "profile", "--dump-dom")
    console = [line for line in shown.stderr.splitlines() if "CONSOLE" in line]
    assert console == []
    titles = re.findall(r"<h2>([^<]*) <", shown.stdout)
    assert [title.strip() for title in titles[:4]] == [
        "lateral error e1", "heading error e2", "speed", "steering angle (left +)",
    ]  # fmt: skip
    assert re.search(r'data-ready="(\d+)"', shown.stdout).group(1) == "11"
    browse(page, tmp_path / "profile", f"--screenshot={picture}")
    assert picture.stat().st_size > 60_000


def test_a_damaged_page_says_so(drive_fast, tmp_path):
    session = drive_fast("--path line --speed 1 --duration 2").session
    page = tmp_path / "drive.html"
    assert run_cli(["plot", str(session), "-o", str(page)]) == 0
    page.write_text(page.read_text().replace('"data":"eN', '"data":"AA', 1))
    shown = browse(page, tmp_path / "profile", "--dump-dom")
    assert "could not be drawn" in shown.stdout
    assert 'data-ready="' not in shown.stdout
