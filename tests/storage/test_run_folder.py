# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The folder that a training leaves."""

import pytest

from vgps_ros.core.errors import InvalidInputError
from vgps_ros.storage.run_folder import RunFolder, load_policy, read_result

RESULT = {"task": "rotor", "initial_ddp_cost": 2.0, "iterations": [{"k": 1}]}


def test_a_run_is_finished_once_its_checkpoints_are_gone(random_policy, tmp_path):
    folder, policy = RunFolder(tmp_path / "run"), random_policy()
    assert not folder.is_finished()
    folder.save(RESULT, policy)
    folder.checkpoints.mkdir()
    (folder.checkpoints / "checkpoint-1.npz").touch()
    assert not folder.is_finished()
    (folder.checkpoints / "checkpoint-1.npz").unlink()
    assert folder.is_finished()
    assert folder.file_names() == "result.json and policy.json"
    assert read_result(folder.result) == RESULT
    kept, task = load_policy(folder.policy)
    assert (task, kept.parameters.tobytes()) == ("rotor", policy.parameters.tobytes())


@pytest.mark.parametrize("content", [None, "", "[]", "{}", '{"task": "rotor", "iterations": []}'])
def test_what_is_no_result_is_refused_with_a_sentence(content, tmp_path):
    if content is not None:
        (tmp_path / "result.json").write_text(content)
    with pytest.raises(InvalidInputError, match=r"is not a result\.json of a training: .*\.$"):
        read_result(tmp_path / "result.json")
