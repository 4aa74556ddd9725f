# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Files that were cut short or changed: each is read as it stands, or refused with a sentence."""

import json
import os
import shutil
from pathlib import Path

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, given, seed, settings

from tests.onnx_models import elu_layers, elu_model
from vgps_ros.bags.reader import BagReader
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.policy import Architecture, GaussianPolicy
from vgps_ros.core.records import Trajectory
from vgps_ros.policies.onnx_file import ExportedPolicy, to_onnx
from vgps_ros.policies.policy_file import policy_of
from vgps_ros.programs.export import metadata
from vgps_ros.search.run_record import read_results
from vgps_ros.simulation.model import compile_model
from vgps_ros.simulation.model_changes import changed_spec
from vgps_ros.storage.files import write_archive
from vgps_ros.storage.run_folder import RunFolder, load_policy, save_policy
from vgps_ros.tasks import make_task
from vgps_ros.tasks.motion_table import load_demonstration, write_motion

SEED = int(os.environ.get("MALFORMED_SEED", "0"))
SAMPLE = Path(__file__).parents[1] / "recordings" / "sample"
ROTOR = make_task("rotor")


def write_policy(folder):
    shape = Architecture(ROTOR.observation.names, (2,), 1)
    save_policy(
        GaussianPolicy(shape, np.ones(shape.num_parameters), np.ones(1)), "rotor", folder / "file"
    )


def write_onnx(folder):
    shape = Architecture(ROTOR.observation.names, (2,), 1)
    policy = GaussianPolicy(shape, np.ones(shape.num_parameters), np.ones(1))
    exported = ExportedPolicy(policy, ROTOR.dynamics.control_limits, "float64")
    (folder / "file").write_bytes(to_onnx(exported, metadata(ROTOR, policy, folder)))


def write_onnx_of_others(folder):
    names = ROTOR.observation.names
    says = {
        "joint_names": ",".join(ROTOR.actuated_joint_names), "observation_names": ",".join(names)
    }  # fmt: skip
    made = elu_model(elu_layers(len(names), 1, hidden=(3,)), says)
    (folder / "file").write_bytes(made.SerializeToString())


def read_onnx(path):
    policy = policy_of(path.read_bytes(), "The file").policy(ROTOR.controls)
    policy.mean(np.zeros(len(policy.observed)))


def write_demonstration(folder):
    states, controls = np.zeros((ROTOR.planned_horizon + 1, 2)), np.ones((ROTOR.planned_horizon, 1))
    time = ROTOR.dynamics.time_step * np.arange(len(states))
    write_motion(folder / "file", ROTOR.dynamics.model, time, Trajectory(states, controls))


def write_model(folder):
    (folder / "file").write_text(ROTOR.mjcf)


def write_result(folder):
    (folder / "file").write_text(
        json.dumps({"task": "rotor", "initial_ddp_cost": 1.0, "iterations": [{"k": 1}]})
    )
    motions = {f"{name}_states": np.zeros((3, 2)) for name in ("initial", "mean", "executed")}
    motions["state_covariances"] = np.zeros((3, 2, 2))
    write_archive(RunFolder(folder).trajectories, motions)


def read_result(path):
    shutil.copy(path, path.with_name("result.json"))
    read_results(RunFolder(path.parent))


KINDS = {
    "policy": (write_policy, load_policy),
    "onnx policy": (write_onnx, read_onnx),
    "onnx policy of others": (write_onnx_of_others, read_onnx),
    "demonstration": (write_demonstration, lambda path: load_demonstration(ROTOR, path)),
    "model": (write_model, lambda path: changed_spec(path, {}, {})),
    "model as text": (write_model, lambda path: compile_model(path.read_text(errors="replace"))),
    "result": (write_result, read_result),
}
PIECES = (b"", b"nan", b"1e999", b"-1", b"null", b"[]", b"{", b"\xff\xfe", b"\x00", b",", b"<body>")


def damaged(data):
    """Draws the bytes with up to three stretches cut out or replaced."""
    places = st.tuples(
        st.integers(0, len(data)),
        st.integers(0, 40),
        st.sampled_from(PIECES) | st.binary(max_size=8),
    )

    def damage(changes, length):
        changed = bytearray(data[:length])
        for at, count, piece in changes:
            changed[at : at + count] = piece
        return bytes(changed)

    cut = st.just(len(data)) | st.integers(0, len(data))
    return st.builds(damage, st.lists(places, min_size=1, max_size=3), cut)


def read_damaged(read, path, original, examples):
    refused = []

    @seed(SEED)
    @settings(
        max_examples=examples,
        derandomize=False,
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    @given(damaged(original))
    def run(data):
        path.write_bytes(data)
        try:
            read(path)
        except InvalidInputError as error:
            refused.append(str(error))

    run()
    assert refused
    for sentence in refused:
        assert len(sentence) < 1000, sentence
        assert sentence.endswith("."), sentence


@pytest.mark.parametrize("kind", KINDS)
def test_damaged_files_are_read_or_refused_with_a_sentence(tmp_path, kind):
    write, read = KINDS[kind]
    write(tmp_path)
    read_damaged(read, tmp_path / "file", (tmp_path / "file").read_bytes(), 300)


@pytest.mark.parametrize(
    ("inside", "sentence"),
    [
        ("<worldbody/>", "has no joint"),
        ('<worldbody><body><joint/><geom size="1"/></body></worldbody>', "joints have no name"),
        ('<worldbody><body><freejoint/><geom size="1"/></body></worldbody>', "joints have no name"),
        ('<size memory="8E"/><worldbody/>', "does not compile"),
        ('<include file="/etc/hostname"/>', "must need no file, does not compile"),
        ('<asset><mesh name="m" file="/etc/hostname"/></asset>', "must need no file"),
    ],
)
def test_a_model_as_text_must_hold_a_whole_robot(inside, sentence):
    with pytest.raises(InvalidInputError, match=sentence):
        compile_model(f"<mujoco>{inside}</mujoco>")


@pytest.mark.parametrize("name", ["metadata.yaml", "bag_0.mcap"])
def test_damaged_bags_are_opened_or_refused_with_a_sentence(tmp_path, name):
    bag = tmp_path / "bag"
    shutil.copytree(SAMPLE, bag)

    def read(_):
        with BagReader(bag):
            pass

    read_damaged(read, bag / name, (SAMPLE / name).read_bytes(), 60)
