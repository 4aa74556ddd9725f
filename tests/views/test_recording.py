# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A recording that is being written."""

import time

import numpy as np
import rerun as rr
from rerun.chunk import RrdReader

from vgps_ros.views import recording
from vgps_ros.views.recording import Recording


def test_a_quiet_entity_is_written_among_busy_ones(tmp_path, monkeypatch):
    monkeypatch.setattr(recording, "_PERIOD", 0.2)
    path = tmp_path / "run.rrd"
    written = Recording(path)
    written.log("quiet", rr.Scalars, scalars=[1.0])
    began, found = time.monotonic(), False
    while not found and time.monotonic() < began + 20.0:
        for stamp in range(1000):
            written.set_time(stamp)
            written.log("busy", rr.Scalars, scalars=[2.0])
        found = b"/quiet" in path.read_bytes()
    written.close()
    assert found
    rows: dict[str, int] = {}
    for chunk in RrdReader(path).stream():
        entity = str(chunk.entity_path)
        rows[entity] = rows.get(entity, 0) + chunk.num_rows
    assert rows["/quiet"] == 1
    assert rows["/busy"] % 1000 == 0


def test_a_row_has_as_many_instances_as_were_logged_at_its_time(tmp_path):
    written = Recording(tmp_path / "run.rrd")
    origins = np.zeros((2, 3))
    for count in (2, 0, 1):
        origins[:] = count  # as MuJoCo's arrays, which the next state overwrites
        written.set_time(10 * count)
        written.log("forces", rr.Arrows3D, origins=origins[:count], vectors=origins[:count])
    written.log("in_the_air", rr.Arrows3D, origins=origins[:0], vectors=origins[:0])
    written.set_iteration(3, 7)
    written.log("forces", rr.Arrows3D, origins=[[4.0, 5.0, 6.0]], vectors=[[0.0, 0.0, 1.0]])
    written.close()
    found = {}
    for chunk in RrdReader(tmp_path / "run.rrd").stream():
        if (name := str(chunk.entity_path)) in ("/forces", "/in_the_air"):
            table = chunk.to_record_batch()
            timeline = "time" if "time" in table.schema.names else "iteration"
            times = table.column(timeline).cast("int64").to_pylist()
            rows = table.column("Arrows3D:origins").to_pylist()
            found[name, timeline] = dict(zip(times, rows, strict=True))
    assert found == {
        ("/forces", "time"): {20: [[2.0] * 3] * 2, 0: [], 10: [[1.0] * 3]},
        ("/forces", "iteration"): {3: [[4.0, 5.0, 6.0]]},
        ("/in_the_air", "time"): {10: []},
    }
