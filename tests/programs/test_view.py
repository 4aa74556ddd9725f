# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The program `view`: a recording in the browser, and how it ends."""

import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import urllib.request
from pathlib import Path

import pytest
import rerun as rr

from vgps_ros.programs.__main__ import main as vgps

NO_DISPLAY = {k: v for k, v in os.environ.items() if "DISPLAY" not in k}


@pytest.fixture
def recording(tmp_path):
    stream = rr.RecordingStream("test")
    stream.save(tmp_path / "run.rrd")
    stream.log("value", rr.Scalars(1.0))
    stream.disconnect()
    return tmp_path / "run.rrd"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_it_serves_a_page_to_this_machine_until_a_signal_and_leaves_no_process(recording, number):
    command = [sys.executable, "-m", "vgps_ros.programs", "view", str(recording.parent)]
    view = subprocess.Popen(command, stdout=subprocess.PIPE, env=NO_DISPLAY, text=True)
    try:
        page = re.search(r"(http://127.0.0.1:\d+)\?url=", view.stdout.readline())[1]
        assert b"<html" in urllib.request.urlopen(page, timeout=60).read()
        children = Path(f"/proc/{view.pid}/task/{view.pid}/children").read_text().split()
        assert len(children) == 1
        assert {"127.0.0.1"} == set(listening(int(children[0])))
    finally:
        view.send_signal(number)
    assert view.wait(60) == 0
    assert not Path(f"/proc/{children[0]}").exists()


def listening(pid: int) -> list[str]:
    """Returns the addresses on which a process listens."""
    inodes = {os.readlink(f)[8:-1] for f in Path(f"/proc/{pid}/fd").iterdir()}
    lines = [
        line.split()
        for kind in ("tcp", "tcp6")
        for line in Path(f"/proc/net/{kind}").read_text().splitlines()[1:]
    ]
    found = [each[1].split(":")[0] for each in lines if each[9] in inodes and each[3] == "0A"]
    assert found
    return ["127.0.0.1" if address == "0100007F" else address for address in found]


@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        (lambda folder: folder / "none", "There is no recording"),
        (lambda folder: folder, "`vgps bag rerun BAG --output NAME.rrd` makes one"),
        (lambda folder: shutil.copy(__file__, folder / "text.rrd"), "is no recording of Rerun"),
    ],
)
def test_what_is_no_recording_is_refused_with_a_way_out(tmp_path, make, sentence):
    with pytest.raises(SystemExit, match=re.escape(sentence)):
        vgps(["view", str(make(tmp_path))])


def test_a_port_that_is_taken_is_an_error(recording):
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        with pytest.raises(SystemExit, match="is taken; choose another one"):
            vgps(["view", "--web", "--port", str(other.getsockname()[1]), str(recording)])
