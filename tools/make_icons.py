"""Draws the console's icons for a home screen from web/src/icon.svg, in Chromium: `.ws/browser/bin/python tools/make_icons.py`."""

from __future__ import annotations

import sys
from pathlib import Path

from playwright.sync_api import sync_playwright

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "test" / "support"))

from console_page import launch  # noqa: E402

WEB = ROOT / "web" / "src"
#: By name: size [pixels], how much of it the drawing takes, and what is behind it: iOS has no transparency, and a maskable icon may
#: lose all that is not in its middle (W3C Web Application Manifest, "Icon masks and safe zone": a circle of 80 %).
ICONS = {
    "icon_180": (180, 0.72, "#12151a"),
    "icon_192": (192, 1.0, "transparent"),
    "icon_512": (512, 1.0, "transparent"),
    "icon_maskable": (512, 0.56, "#12151a"),
}


def main() -> None:
    drawing = (WEB / "icon.svg").read_text()
    with sync_playwright() as playwright:
        browser = launch(playwright)
        for name, (size, part, behind) in ICONS.items():
            page = browser.new_page(viewport={"width": size, "height": size})
            middle = "body{margin:0;height:100vh;display:grid;place-items:center}"
            page.set_content(f"<style>html{{background:{behind}}}{middle}svg{{width:{part:.0%}}}</style>{drawing}")
            page.screenshot(path=WEB / f"{name}.png", omit_background=True)
            page.close()
        browser.close()


if __name__ == "__main__":
    main()
