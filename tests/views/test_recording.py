# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A recording that is being written."""

import time

import rerun as rr
from rerun.chunk import RrdReader

from vgps_ros.views import recording
from vgps_ros.views.recording import Recording


def test_a_quiet_entity_is_written_among_busy_ones(tmp_path, monkeypatch):
    monkeypatch.setattr(recording, "_PERIOD", 0.2)
    path = tmp_path / "run.rrd"
    written = Recording(path)
    written.log("quiet", rr.Scalars(1.0))
    began, found = time.monotonic(), False
    while not found and time.monotonic() < began + 20.0:
        for stamp in range(1000):
            written.set_time(stamp)
            written.log("busy", rr.Scalars(2.0))
        found = b"/quiet" in path.read_bytes()
    written.close()
    assert found
    rows: dict[str, int] = {}
    for chunk in RrdReader(path).stream():
        entity = str(chunk.entity_path)
        rows[entity] = rows.get(entity, 0) + chunk.num_rows
    assert rows["/quiet"] == 1
    assert rows["/busy"] % 1000 == 0
