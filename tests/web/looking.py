"""What tests in a browser share: where it is, what they look at, and pictures for people."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
IN_BROWSER = [
    pytest.mark.browser,
    pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here: apt-get install chromium"),
    pytest.mark.timeout(900),
]
ROOT = Path(__file__).parents[2]
PICTURES = ROOT / "build" / "page"
_APP = (ROOT / "needle_rig/web/static/app.js").read_text(encoding="utf-8")
VIEWS = tuple(
    re.findall(r"^  (\w+): \[", _APP.partition("const VIEWS = {")[2].partition("};")[0], re.MULTILINE)
)
"""Every view of the page, by its address."""
WIDE, NARROW = {"width": 1440, "height": 900}, {"width": 390, "height": 844}
MIDDLE = {"width": 1024, "height": 768}
PATIENCE_MS = 300_000
"""A diagnosis beside other tests."""
EVIL = "<img src=x onerror=window.evil=1>"

Open = Callable[..., Any]


def pictured(page: Any, name: str, part: str = "") -> None:
    """Keep a picture of the whole page, or of the `part` that a selector names."""
    PICTURES.mkdir(parents=True, exist_ok=True)
    path = PICTURES / f"{name}.png"
    if part:
        page.locator(part).first.screenshot(path=path)
        return
    page.evaluate("scrollTo(0, 0)")
    page.screenshot(path=path, full_page=True)


def look_at(page: Any, name: str) -> None:
    """Pictures of this view, in three widths and once dark; no serious finding of axe in any of them.

    A dark scheme changes colours and no place: one width shows them.
    """
    axe = pytest.importorskip("axe_playwright_python.sync_playwright")
    before = page.viewport_size
    looks = (
        (WIDE, "1440", "light"),
        (WIDE, "1440", "dark"),
        (MIDDLE, "1024", "light"),
        (NARROW, "390", "light"),
    )
    for size, width, scheme in looks:
        page.set_viewport_size(size)
        page.emulate_media(color_scheme=scheme)
        page.wait_for_timeout(200)  # plots are drawn anew
        pictured(page, f"{name}-{width}-{scheme}")
        found = axe.Axe().run(page).response["violations"]
        serious = [v for v in found if v["impact"] in ("serious", "critical")]
        told = [(v["id"], [n["html"][:120] for n in v["nodes"][:3]]) for v in serious]
        assert not told, f"{name} at {width} px, {scheme}: {told}"
        wider = page.evaluate("document.documentElement.scrollWidth - window.innerWidth")
        assert wider <= 0, f"{name} at {width} px scrolls sideways"
    page.emulate_media(color_scheme="light")
    page.set_viewport_size(before)
