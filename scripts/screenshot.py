#!/usr/bin/env python3
# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Takes a picture of a Rerun recording as a browser shows it when it is opened.

    pip install -r requirements/browser.txt   # the browser is the system package `chromium`
    python scripts/screenshot.py recordings/mine/run.rrd picture.png

The viewer is drawn in software, which takes a minute or two. Ports are bound to 127.0.0.1 alone.
"""

import argparse
import shutil
import signal
import sys
from pathlib import Path

from vgps_ros.views.viewer import in_browser

_BROWSERS = ("chromium", "chromium-browser", "google-chrome")
_IN_SOFTWARE = ("--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
                "--ignore-gpu-blocklist")  # fmt: skip
_PATIENCE = 600.0  # for the browser's drawing in software [s]


def take(recording: Path, picture: Path, size: tuple[int, int], settle: float) -> None:
    """Serves a recording, opens it in the browser, and writes what is seen to a PNG."""
    from playwright.sync_api import sync_playwright

    browser = next(filter(None, map(shutil.which, _BROWSERS)), None)
    if browser is None:
        sys.exit("There is no chromium on the path; install it.")
    with in_browser(recording) as (address, _), sync_playwright() as play:
        chromium = play.chromium.launch(executable_path=browser, args=list(_IN_SOFTWARE))
        page = chromium.new_page(viewport={"width": size[0], "height": size[1]})
        page.goto(f"{address}&renderer=webgl", timeout=_PATIENCE * 1e3)
        page.wait_for_timeout(settle * 1e3)
        page.screenshot(path=picture, timeout=_PATIENCE * 1e3)
        page.goto("about:blank", timeout=_PATIENCE * 1e3)  # a page that draws closes slowly
        chromium.close()


def main() -> None:
    """Reads the arguments."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("recording", type=Path)
    parser.add_argument("picture", type=Path)
    parser.add_argument("--size", type=int, nargs=2, default=(1400, 900), metavar=("W", "H"))
    parser.add_argument("--settle", type=float, default=40.0, help="time to load and draw [s]")
    given = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # so that the viewer ends, too
    if given.picture.exists():
        parser.error(f"{given.picture} exists already; name another file.")
    take(given.recording, given.picture, tuple(given.size), given.settle)


if __name__ == "__main__":
    main()
