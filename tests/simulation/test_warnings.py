# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
import subprocess
import sys

import mujoco
import numpy as np
import pytest

from vgps_ros.simulation.dynamics import Dynamics
from vgps_ros.simulation.warnings import _KINDS, in_words

WILD = np.r_[np.full(5, 1e3), np.full(5, 9e3)], np.array([1e8, -1e8])


def test_a_step_that_explodes_is_counted_by_its_kind_in_its_own_dynamics(swimmer):
    first, other = (Dynamics(swimmer.dynamics.model, threads=2) for _ in range(2))
    for _ in range(3):
        first.step(*WILD)
    assert in_words(first.warnings()) == "bad acceleration (3)"
    assert not other.warnings()


def test_every_warning_of_mujoco_has_a_kind_of_its_own():
    assert sorted(map(int, _KINDS)) == list(range(mujoco.mjtWarning.mjNWARNING))
    assert len(set(_KINDS.values())) == len(_KINDS)


_DIVERGENCE = """
import numpy as np
from vgps_ros.core.records import Trajectory
from vgps_ros.tasks import make_task

walker = make_task("walker")
starts = np.stack([walker.initial_state] * 3)
states, *_ = walker.dynamics.rollouts(starts, lambda t, x: np.full((3, 6), 1e8), 5)
assert np.isnan(states[:, -1]).all()
states[0, 1:] = starts[0]
walker.dynamics.linearize(Trajectory(states[0], np.full((5, 6), 1e8)))
assert walker.dynamics.warnings()
"""
_PROGRAM = """
from contextlib import suppress
from vgps_ros.programs.__main__ import main
with suppress(SystemExit):
    main({})
"""


@pytest.mark.parametrize(
    ("beginning", "files"),
    [
        ("", ["MUJOCO_LOG.TXT"]),
        ("from vgps_ros.simulation.warnings import silence_mujoco as s; s()", []),
        *(
            pytest.param(_PROGRAM.format(words), [], marks=marks)
            for words, marks in (
                (["train", "--output", "nowhere", "--check"], [pytest.mark.slow]),
                (["evaluate", "nowhere"], []),
            )
        ),
    ],
)
def test_a_divergence_leaves_a_log_only_where_no_program_has_silenced_mujoco(
    tmp_path, beginning, files
):
    """The walker, whose contacts MuJoCo finds unstable; derivatives come from several threads.

    In a process of its own, since MuJoCo hands the warnings of all simulations to one place.
    """
    script = [sys.executable, "-c", beginning + _DIVERGENCE]
    done = subprocess.run(script, check=True, cwd=tmp_path, capture_output=True, text=True)
    assert [path.name for path in tmp_path.iterdir()] == files
    assert ("WARNING" in done.stdout + done.stderr) == bool(files)


_INTERRUPTED = """
import os, signal, sys
from vgps_ros.simulation.warnings import silence_mujoco

def strike(frame, event, argument):
    if frame.f_code is not silence_mujoco.__code__:
        os.kill(os.getpid(), signal.SIGINT)

sys.settrace(strike)
try:
    silence_mujoco()
except KeyboardInterrupt:
    sys.exit(3)
"""


def test_an_interrupt_while_mujoco_is_silenced_stays_one():
    """MuJoCo's bindings turn it into an error of their own where they look at a Python function."""
    script = [sys.executable, "-c", _INTERRUPTED]
    done = subprocess.run(script, check=False, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (3, "")
