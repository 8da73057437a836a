"""The pictures of README and tutorial, each of the drive of the commands beside it."""

import re
import shlex
import tempfile
from pathlib import Path

from steerd.daemon.cli.main import run_cli
from steerd.daemon.common.errors import ExitCode
from tests.browser import browsing

ROOT = Path(__file__).resolve().parents[1]
PICTURES = {
    "figure8.png": ("first-drive.md", r"run .* drive\.mcap|plot drive\.mcap", "drive.html"),
    "gap-report.png": ("find-what-is-missing.md", r"run .* late\.mcap|diagnose .*", "gap.html"),
}
"""Tutorial page, its commands that make a report, and that report, by picture."""


def main() -> None:
    """Drive and draw."""
    with tempfile.TemporaryDirectory() as folder, browsing() as browser:
        for picture, (page, commands, report) in PICTURES.items():
            text = (ROOT / "docs" / "tutorial" / page).read_text(encoding="utf-8")
            for line in re.findall(rf"^steerd ({commands})$", text, re.MULTILINE):
                words = [f"{folder}/{w}" if w.endswith((".mcap", ".html", ".toml")) else w
                         for w in shlex.split(line)]  # fmt: skip
                assert run_cli(words) == ExitCode.OK, line
            browser.open(f"file://{folder}/{report}", 1100)
            browser.wait("document.readyState === 'complete'")
            browser.screenshot(ROOT / "docs" / "img" / picture, 900)


if __name__ == "__main__":
    main()
