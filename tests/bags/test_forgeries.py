# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""`vgps bag check` passes no forged record, even one whose manifest was made anew."""

import hashlib
import json
import shutil
import struct
from dataclasses import replace
from pathlib import Path

import pytest
import yaml
from diagnostic_msgs.msg import DiagnosticArray
from mcap.opcode import Opcode
from rclpy.serialization import deserialize_message, serialize_message

from tests.bags.altered import ALL, SAMPLE, copy, definitions_of, main, rewritten, sample
from vgps_ros.bags import BagReader
from vgps_ros.messages.names import SAFE_ACTION_DRIVES

WRONG, UNPROVEN = 1, 3
MESSAGES = sample()
STATES = [m for m in MESSAGES if m.topic == "/joint_states"]
TORQUES = [m for m in MESSAGES if m.topic == "/joint_command"]
OTHERS = [m for m in MESSAGES if m.topic not in ("/joint_states", "/joint_command")]


def outcome(bag, capsys) -> tuple[int, str]:
    """The exit code of a check, and all that it says."""
    with pytest.raises(SystemExit) as stop:
        main(["check", str(bag)])
    code = stop.value.code
    out, err = capsys.readouterr()
    return (WRONG, f"{out}{err}{code}") if isinstance(code, str) else (code, out)


def of(message, torques):
    """A command with other torques, which come last in it."""
    return replace(message, data=message.data[:-16] + struct.pack("<2d", *torques))


def of_the_executor(message) -> bool:
    if message.topic != "/diagnostics":
        return False
    array = deserialize_message(message.data, DiagnosticArray)
    return any(status.name == "/policy_executor" for status in array.status)


def late_statuses(begin):
    return {m for m in MESSAGES if of_the_executor(m) and m.stamp - MESSAGES[0].stamp > begin * 1e9}


def without_early_states():
    """All states but the last two are deleted, and the torques before them are another's."""
    cut = STATES[-2].stamp
    forged = [m if m.stamp > cut else of(m, (1000.0, -1000.0)) for m in TORQUES]
    return [*OTHERS, *forged, *STATES[-2:]]


def unusable_states():
    """No state is usable but for the last hundred, and the torques of the others are another's."""
    nan = struct.pack("<d", float("nan"))
    cut, at = STATES[-100].stamp, len(STATES[0].data) - 56
    broken = [replace(m, data=m.data[:at] + nan + m.data[at + 8 :]) for m in STATES[:-100]]
    forged = [m if m.stamp > cut else of(m, (1000.0, -1000.0)) for m in TORQUES]
    return [*OTHERS, *forged, *broken, *STATES[-100:]]


def silent_executor():
    """The executor's diagnostics are deleted since it was ready, and most of its torques."""
    return [m for m in (*OTHERS, *STATES, TORQUES[-1]) if m not in late_statuses(2.0)]


def deleted_stretch():
    """Three hundred states are deleted with their torques, and the executor's last status."""
    gone = {*STATES[103:403], *TORQUES[100:400], *late_statuses(9.9)}
    return [m for m in MESSAGES if m not in gone]


def fault_of_another():
    """All torques are zero, and the visualizer says that the safe action drives."""

    def spoken(message):
        if message.topic != "/diagnostics":
            return message
        array = deserialize_message(message.data, DiagnosticArray)
        for status in array.status:
            if status.name == "/visualizer":
                status.message = f"{SAFE_ACTION_DRIVES} (zero): a lie."
        return replace(message, data=serialize_message(array))

    return [*map(spoken, OTHERS), *STATES, *(of(m, (0.0, 0.0)) for m in TORQUES)]


def deleted_policy():
    """The policy of an iteration that never drove is deleted."""
    policies = [m for m in MESSAGES if m.topic == "/policy"]
    return [m for m in MESSAGES if m != policies[1]]


def doubled_torques():
    return [*MESSAGES, *(replace(m, stamp=m.stamp + 1000) for m in TORQUES[-400:])]


def reversed_torques():
    stamps = [m.stamp for m in TORQUES[:-501:-1]]
    turned = [replace(m, stamp=s) for m, s in zip(TORQUES[-500:], stamps, strict=True)]
    return [*OTHERS, *STATES, *TORQUES[:-500], *turned]


def many_last_torques():
    """A thousand zero torques come after the last one."""
    zero, last = of(TORQUES[-1], (0.0, 0.0)), TORQUES[-1].stamp
    return [*MESSAGES, *(replace(zero, stamp=last + 1000 * i) for i in range(1, 1001))]


@pytest.mark.parametrize(
    ("forged", "code", "sentence"),
    [
        (without_early_states, UNPROVEN, "505 torques came before the first state"),
        (unusable_states, WRONG, "torques answer states that are not in the bag, or are unusable"),
        (silent_executor, UNPROVEN, "states lack a torque, and the executor said nothing"),
        (deleted_stretch, UNPROVEN, "300 states are missing between those that are there"),
        (fault_of_another, WRONG, "507 torques are zero or safe"),
        (deleted_policy, UNPROVEN, "1 policies that the learner named are missing"),
        (doubled_torques, WRONG, "400 torques are more than the states that they answer"),
        (reversed_torques, WRONG, "499 torques came after that of a later state"),
        (
            many_last_torques,
            WRONG,
            "torques are zero or safe, and nothing says that they had to be",
        ),
    ],
)
def test_altered_messages_are_found(tmp_path, capsys, forged, code, sentence):
    found = outcome(rewritten(tmp_path / "bag", forged()), capsys)
    assert found[0] == code, found[1]
    assert sentence in found[1]


def test_noise_is_wrong_where_the_executor_said_that_it_adds_none(tmp_path, capsys):
    """A bag of a run without noise says, with other parameters, that all torques had it."""
    bag = copy(tmp_path / "bag", lambda message: message.data, stochastic=True)
    code, words = outcome(bag, capsys)
    assert code == WRONG
    assert "507 torques differ from what the policy gives" in words


def test_parameters_must_be_those_that_the_nodes_said(tmp_path, capsys):
    code, words = outcome(rewritten(tmp_path / "bag", MESSAGES, damping=4.0), capsys)
    assert code == WRONG
    assert "parameters.yaml has 4.0 as damping of /policy_executor, which said 5.0" in words


def test_a_definition_that_moves_the_torques_is_found(tmp_path, capsys):
    """Each command begins with forged torques where every reader of ROS 2 has its effort."""
    kind, effort = "sensor_msgs/msg/JointState", "float64[] effort"
    definition = definitions_of(SAMPLE)[kind].replace(effort, f"float64[] forged\n{effort}")
    pair = struct.pack("<II", 2, 0)
    forged = [replace(m, data=of(m, (1e3, -1e3)).data + pair + m.data[-16:]) for m in TORQUES]
    states = [replace(m, data=m.data + struct.pack("<I", 0)) for m in STATES]
    bag = rewritten(tmp_path / "bag", [*OTHERS, *states, *forged], definitions={kind: definition})
    code, words = outcome(bag, capsys)
    assert code == WRONG
    assert f"the definition of {kind} is not that type's" in words


def with_manifest(bag: Path, **changes) -> Path:
    """Makes the digests of the manifest anew, and changes its entry of the file."""
    manifest, [file] = json.loads((bag / "manifest.json").read_text()), bag.glob("*.mcap")
    digest = {
        name: hashlib.sha256((bag / name).read_bytes()).hexdigest()
        for name in (file.name, "metadata.yaml")
    }
    manifest["metadata.yaml"] = digest["metadata.yaml"]
    manifest["files"][file.name] |= {"sha256": digest[file.name]} | changes
    (bag / "manifest.json").write_text(json.dumps(manifest))
    return bag


def test_the_index_must_name_the_chunks_that_are_there(tmp_path, capsys):
    """Other readers go by the index: it must not lead them to other chunks than were checked."""
    bag = Path(shutil.copytree(SAMPLE, tmp_path / "bag"))
    [file] = bag.glob("*.mcap")
    with BagReader(bag) as reader:
        [index, *_] = reader.files[0].content.indexes
    data = bytearray(file.read_bytes())
    entry = struct.pack(
        "<QQQQ",
        index.message_start_time,
        index.message_end_time,
        index.chunk_start_offset,
        index.chunk_length,
    )
    assert data.count(entry) == 1
    at = data.index(entry) + 16
    data[at : at + 8] = struct.pack("<Q", index.chunk_start_offset + 1)
    footer = len(data) - 37
    assert data[footer] == Opcode.FOOTER
    data[-12:-8] = bytes(4)  # no check sum of the index
    file.write_bytes(data)
    code, words = outcome(with_manifest(bag), capsys)
    assert code == WRONG
    assert "1 chunks are not where the index of bag_0.mcap says" in words


def test_the_description_must_be_that_of_the_files(tmp_path, capsys):
    bag = Path(shutil.copytree(SAMPLE, tmp_path / "bag"))
    content = yaml.safe_load((bag / "metadata.yaml").read_text())
    content["rosbag2_bagfile_information"]["message_count"] += 1
    (bag / "metadata.yaml").write_text(yaml.safe_dump(content))
    code, words = outcome(with_manifest(bag), capsys)
    assert code == WRONG
    assert "message_count in metadata.yaml is not that of the files" in words


def test_the_manifest_cannot_name_chunks_that_are_not_there(tmp_path, capsys):
    nothing = (0, 0, hashlib.sha256().hexdigest())
    bag = Path(shutil.copytree(SAMPLE, tmp_path / "bag"))
    code, words = outcome(with_manifest(bag, chunks=[nothing] * 1000), capsys)
    assert code == WRONG
    assert "the manifest's chunks of bag_0.mcap do not follow each other" in words


def test_what_cannot_be_read_is_wrong_and_the_rest_is_checked_all_the_same(tmp_path, capsys):
    """As where a stranger publishes nonsense, which no node uses."""
    _, second, third, _ = (m for m in MESSAGES if m.topic == "/policy")
    nonsense = {
        second: replace(second, data=second.data.replace(b"softplus", b"softplux")),
        third: replace(third, data=b"nonsense"),
        TORQUES[100]: of(TORQUES[100], (float("nan"), 0.0)),
    }
    code, words = outcome(
        rewritten(tmp_path / "bag", [nonsense.get(m, m) for m in MESSAGES]), capsys
    )
    assert code == WRONG
    assert "Wrong: 2 policies cannot be read; of the first one: The policy of iteration 2" in words
    assert "Wrong: 1 commands cannot be read; of the first one: At 1.880 s" in words
    assert f"Proven: {ALL - 3} of {ALL - 1} torques, 2 of 4 policies" in words
