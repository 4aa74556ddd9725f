# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A real browser for tests: the system's Chromium, driven by playwright, drawing in software."""

import importlib.util
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser"))), None)
LACKING = (
    "There is no Chromium: apt-get install chromium."
    if CHROMIUM is None
    else "There is no playwright: pip install -r requirements/browser.txt."
    if importlib.util.find_spec("playwright") is None
    else ""
)
PATIENCE = 240.0  # drawing in software takes long on a busy machine [s]
_OPTIONS = (
    *("--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"),
    "--ignore-gpu-blocklist",
)


@contextmanager
def opened(address: str, width: int = 900, height: int = 500) -> Iterator[Any]:
    """Opens a page, and closes the browser afterwards."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as play:
        chromium = play.chromium.launch(executable_path=CHROMIUM, args=list(_OPTIONS))
        page = chromium.new_page(viewport={"width": width, "height": height})
        page.set_default_timeout(PATIENCE * 1e3)
        page.goto(address)
        try:
            yield page
        finally:
            page.goto("about:blank")  # a page that draws closes slowly
            chromium.close()
