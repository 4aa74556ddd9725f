import mujoco
import numpy as np

from vgps_ros.simulation.warnings import in_words, kind_of, simulator_warnings


def test_a_step_that_explodes_is_counted_by_its_kind(swimmer):
    before = simulator_warnings()
    swimmer.dynamics.step(np.r_[np.full(5, 1e3), np.full(5, 9e3)], np.array([1e8, -1e8]))
    assert in_words(simulator_warnings() - before) == "bad acceleration (1)"


def test_every_warning_of_mujoco_has_a_kind_of_its_own():
    count = mujoco.mjtWarning.mjNWARNING
    kinds = {kind_of(mujoco.mju_warningText(warning, 0)) for warning in range(count)}
    assert len(kinds) == count
    assert "other" not in kinds
