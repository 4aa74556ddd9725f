#!/usr/bin/env python3
# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Takes the pictures of docs/live.md: the page before, during and after a push.

    pip install -r requirements/browser.txt      # the browser itself is the package `chromium`
    source env.bash && python scripts/live_pictures.py docs

The quadruped is driven by `mpc` in lock-step, so that it walks on a slow machine too.
"""

import os
import subprocess
import sys
import time
import urllib.request
from contextlib import suppress
from pathlib import Path

from PIL import Image

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from tests.browser import PATIENCE, opened

NODES = {
    "simulation": ("task:=quadruped", "start_paused:=true"),
    "mpc": ("task:=quadruped", "plan_every:=1"),
    "live": ("port:=18088",),
}
SIZE = 1000, 640
ADDRESS = "http://127.0.0.1:18088"


def main(folder: Path) -> None:
    """Starts the nodes, plays with the page, and writes live_before.png and the others."""
    environment = os.environ | {"ROS_DOMAIN_ID": "78"}
    processes = []
    for name, parameters in NODES.items():
        arguments = [word for parameter in parameters for word in ("-p", parameter)]
        command = ["vgps", "node", name, "--ros-args", *arguments]
        processes.append(subprocess.Popen(command, env=environment))
    try:
        with opened("about:blank", *SIZE) as page:
            wait_for(ADDRESS)
            page.goto(ADDRESS)
            page.get_by_text("paused 0.00 s").wait_for()
            page.get_by_text("velocity/x").first.wait_for()
            page.get_by_text("Software WebGL").locator("xpath=../..").get_by_role("button").click()
            page.get_by_text("Play", exact=True).click()
            page.wait_for_timeout(9_000)
            take(page, folder / "live_before.png")
            page.mouse.move(SIZE[0] / 2, SIZE[1] / 2)
            page.mouse.down()
            for i in range(1, 9):
                page.mouse.move(SIZE[0] / 2 - 9 * i, SIZE[1] / 2 - 9 * i)
                page.wait_for_timeout(100)
            page.get_by_text("Last push").wait_for()
            take(page, folder / "live_push.png")
            page.mouse.up()
            page.wait_for_timeout(2_000)
            take(page, folder / "live_after.png")
    finally:
        for process in processes:
            process.terminate()
            process.wait()


def wait_for(address: str) -> None:
    """Returns once the address answers."""
    end = time.monotonic() + PATIENCE
    while time.monotonic() < end:
        with suppress(OSError):
            return urllib.request.urlopen(address, timeout=5).close()
        time.sleep(0.5)
    sys.exit(f"{address} does not answer; the nodes' output is above.")


def take(page: object, path: Path) -> None:
    """Writes a picture of few colours, which is small."""
    page.screenshot(path=path)  # type: ignore[attr-defined]
    Image.open(path).convert("RGB").quantize(256).save(path, optimize=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
