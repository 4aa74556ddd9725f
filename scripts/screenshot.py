#!/usr/bin/env python3
# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Takes a picture of a Rerun recording as a browser shows it when it is opened.

    pip install playwright            # the browser itself is the package `chromium` of the system
    python scripts/screenshot.py recordings/mine/run.rrd picture.png

The viewer is drawn in software, which takes a minute or two. Ports are bound to 127.0.0.1 alone.
"""

import argparse
import shutil
import signal
import socket
import subprocess
import sys
import time
import urllib.request
from pathlib import Path
from urllib.parse import quote

_BROWSERS = ("chromium", "chromium-browser", "google-chrome")
_IN_SOFTWARE = ("--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
                "--ignore-gpu-blocklist")  # fmt: skip
_PATIENCE = 600.0  # for the browser's drawing in software [s]


def free_port() -> int:
    """Returns a TCP port that nothing listens on."""
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return int(s.getsockname()[1])


def take(recording: Path, picture: Path, size: tuple[int, int], settle: float) -> None:
    """Serves a recording, opens it in the browser, and writes what is seen to a PNG."""
    from playwright.sync_api import sync_playwright

    browser = next(filter(None, map(shutil.which, _BROWSERS)), None)
    viewer = shutil.which("rerun")
    if browser is None or viewer is None:
        lacking = "rerun" if viewer is None else "chromium"
        sys.exit(f"There is no {lacking} on the path; install it, or source env.bash first.")
    web, data = free_port(), free_port()
    served = subprocess.Popen(
        [viewer, "--serve-web", "--bind", "127.0.0.1", "--web-viewer-port", str(web),
         "--port", str(data), str(recording)],
    )  # fmt: skip
    try:
        page_address = f"http://127.0.0.1:{web}"
        _wait_for(page_address)
        source = quote(f"rerun+http://127.0.0.1:{data}/proxy", safe="")
        with sync_playwright() as play:
            chromium = play.chromium.launch(executable_path=browser, args=list(_IN_SOFTWARE))
            page = chromium.new_page(viewport={"width": size[0], "height": size[1]})
            page.goto(f"{page_address}?url={source}&renderer=webgl", timeout=_PATIENCE * 1e3)
            page.wait_for_timeout(settle * 1e3)
            page.screenshot(path=picture, timeout=_PATIENCE * 1e3)
            page.goto("about:blank", timeout=_PATIENCE * 1e3)  # a page that draws closes slowly
            chromium.close()
    finally:
        served.terminate()
        served.wait()


def _wait_for(address: str) -> None:
    """Waits until a server answers."""
    end = time.monotonic() + 60.0
    while not _answers(address):
        if time.monotonic() > end:
            sys.exit(f"The viewer does not answer at {address}; see its output above.")
        time.sleep(0.2)


def _answers(address: str) -> bool:
    try:
        urllib.request.urlopen(address, timeout=5).close()
    except OSError:
        return False
    return True


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
