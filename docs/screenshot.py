"""Take the picture of the report that the README shows.

Run it after `make demo`: python docs/screenshot.py runs/demo/report.html docs/images/report.png
"""

import shutil
import sys
from pathlib import Path

from playwright.sync_api import sync_playwright


def take(report: Path, picture: Path) -> None:
    """Open a report at a busy moment of its third episode, and save what a reader sees first."""
    picture.parent.mkdir(parents=True, exist_ok=True)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=shutil.which("chromium"), args=["--no-sandbox", "--disable-gpu"]
        )
        page = browser.new_page(viewport={"width": 1500, "height": 1250})
        page.goto(f"{report.resolve().as_uri()}#episode=2&step=100")
        page.wait_for_selector("html[data-frame='2:100']")
        page.screenshot(path=picture)
        browser.close()


if __name__ == "__main__":
    take(Path(sys.argv[1]), Path(sys.argv[2]))
