# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""What `vgps bag check` proves of a run, and which forgeries it finds."""

import hashlib
import shutil
import struct
import subprocess
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, KeyValue
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState
from vgps_msgs.msg import GaussianPolicy

from tests.bags.altered import ALL, SAMPLE, copy, main, messages_of, rewritten, without
from vgps_ros.bags import BagReader
from vgps_ros.messages.conversions import distribution_from_msg, nanoseconds, policy_from_msg
from vgps_ros.messages.names import IS_ACTIVE, SAFE_ACTION
from vgps_ros.safety.settings import SafetySettings
from vgps_ros.safety.supervisor import ControlLimiter, safe_control
from vgps_ros.safety.training_marginals import TrainingMarginals
from vgps_ros.storage.run_folder import save_policy
from vgps_ros.tasks import make_task

WRONG, MISSING = 1, 3


def outcome(bag, capsys) -> tuple[int, str]:
    """The exit code of a check, and all that it says."""
    try:
        main(["check", str(bag)])
    except SystemExit as stop:
        words = stop.code if isinstance(stop.code, str) else ""
        return (WRONG if words else stop.code), capsys.readouterr().out + words
    return 0, capsys.readouterr().out


def commanded(change):
    """Returns what `copy` takes: the controls of command i become change(i, stamp, controls)."""
    count = iter(range(10_000))

    def apply(message):
        if message.topic != "/joint_command":
            return message.data
        command = deserialize_message(message.data, JointState)
        stamp = command.header.stamp.sec * 10**9 + command.header.stamp.nanosec
        controls = change(next(count), stamp, np.array(command.effort))
        return message.data[:-16] + struct.pack("<2d", *controls)  # efforts come last

    return apply


def stated(change):
    """Returns what `copy` takes: the message of each state is changed."""

    def apply(message):
        if message.topic != "/joint_states":
            return message.data
        state = deserialize_message(message.data, JointState)
        change(state)
        return serialize_message(state)

    return apply


@cache
def states():
    """The sample's states, the first of each stamp [ns]."""
    found = {}
    with BagReader(SAMPLE) as bag:
        for _, state in bag.decoded("/joint_states"):
            vector = np.concatenate([state.position, state.velocity])
            found.setdefault(nanoseconds(state.header.stamp), vector)
    return found


def test_the_sample_agrees_and_the_last_line_says_what_that_proves(capsys):
    code, words = outcome(SAMPLE, capsys)
    *_, last = words.splitlines()
    assert code == 0
    assert last.startswith(
        f"Proved: {ALL} of {ALL} controls, 500 of 500 steps from state to state, the cost without "
        "noise of 4 of 4 policies, the digest of each file. Not proved: the first state of a "
        "motion, when, where and by whom"
    )


def test_one_bit_of_one_torque_is_found_with_its_time_and_joint(tmp_path, capsys):
    commands = []

    def change(message):
        if message.topic != "/joint_command":
            return message.data
        commands.append(deserialize_message(message.data, JointState))
        if len(commands) != 100:
            return message.data
        torque = struct.unpack("<d", message.data[-8:])[0]  # the last joint's
        return message.data[:-8] + struct.pack("<d", np.nextafter(torque, 1e9))

    code, words = outcome(copy(tmp_path / "bag", change), capsys)
    command = commands[99]
    time = command.header.stamp.sec + command.header.stamp.nanosec * 1e-9
    assert code == WRONG
    assert f"at {time:.3f} s the torque of {command.name[1]} is" in words
    assert "Wrong: 1 controls are not what the policy gives" in words


@pytest.mark.parametrize("removed", [range(1, ALL), [321]])
def test_deleted_torques_are_named(tmp_path, capsys, removed):
    bag = without(tmp_path / "bag", "/joint_command", removed)
    code, words = outcome(bag, capsys)
    assert code in (MISSING, WRONG)
    assert "states lack the control that answers them" in words


def test_a_lost_state_is_named(tmp_path, capsys):
    code, words = outcome(without(tmp_path / "bag", "/joint_states", [300]), capsys)
    assert code == MISSING
    assert "Missing: 1 controls answer states that are not in the bag" in words


def test_torques_are_compared_within_the_recorded_limits(tmp_path, capsys):
    change = commanded(lambda i, stamp, controls: np.clip(controls, -20, 20))
    _, words = outcome(copy(tmp_path / "good", change, torque_limits=[20.0, 20.0]), capsys)
    assert f"{ALL} controls are bit for bit what the policy gives" in words
    change = commanded(lambda i, stamp, controls: np.clip(controls, -20, 20))
    code, words = outcome(copy(tmp_path / "bad", change, torque_limits=[20.0, 30.0]), capsys)
    assert code == WRONG
    assert "the torque of back_joint is" in words


@pytest.mark.parametrize("bad", [None, 300])
def test_a_rate_limit_is_followed_from_torque_to_torque(tmp_path, capsys, bad):
    controls = make_task("swimmer").controls
    limiter = ControlLimiter(SafetySettings(torque_rate_limit=200.0), controls, 0.02)

    def change(i, stamp, controls):
        controls = limiter.limited(controls, stamp, np.zeros(10))
        limiter.note(controls, stamp)
        return controls + (i == bad) * np.array([0.0, 1e-9])

    bag = copy(tmp_path / "bag", commanded(change), torque_rate_limit=200.0)
    _, words = outcome(bag, capsys)
    if bad is None:
        assert f"{ALL} controls are bit for bit" in words
    else:
        assert "controls are not what the policy gives for their states" in words
        assert "the torque of back_joint is" in words


def said_to_be_safe(change, value="True"):
    """Returns what `copy` takes: `change`, and the executor says whether the safe action drives."""

    def apply(message):
        if message.topic != "/diagnostics":
            return change(message)
        array = deserialize_message(message.data, DiagnosticArray)
        for status in array.status:
            if status.name == "/policy_executor":
                others = [v for v in status.values if v.key not in (IS_ACTIVE, SAFE_ACTION)]
                pairs = ((IS_ACTIVE, "True"), (SAFE_ACTION, value))
                status.values = [*others, *(KeyValue(key=k, value=v) for k, v in pairs)]
        return serialize_message(array)

    return apply


@pytest.mark.parametrize(
    "action", [pytest.param("zero", marks=pytest.mark.slow), "damping", "feedback"]
)
def test_torques_of_the_safe_action_count_where_a_key_says_that_it_drove(tmp_path, capsys, action):
    settings = SafetySettings(safe_action=action, damping=3.0)
    swimmer = make_task("swimmer")
    with BagReader(SAMPLE) as bag:
        last = list(bag.messages(["/trajectory_distribution"]))[-1]
        q = distribution_from_msg(bag.decode(last)).first(swimmer.horizon)
    marginals = TrainingMarginals(q, swimmer.observation, 2)

    def change(i, stamp, controls):
        if not 200 <= i < 205:
            return controls
        return safe_control(settings, states()[stamp], swimmer.controls, np.zeros(2), [marginals])

    for value, sentence in (
        ("True", "5 controls are those of the safe action, or zero, while the policy did not"),
        ("False", "The diagnostics do not say that the safe action drove"),
    ):
        said = said_to_be_safe(commanded(change), value)
        bag = copy(tmp_path / value, said, safe_action=action, damping=3.0)
        _, words = outcome(bag, capsys)
        assert sentence in words


def test_a_state_that_is_not_finite_is_counted(tmp_path, capsys):
    seen = iter(range(10_000))

    def change(state):
        if not next(seen):  # the first copy of the first state
            state.velocity[4] = np.nan

    _, words = outcome(copy(tmp_path / "bag", stated(change)), capsys)
    assert "Missing: 1 states cannot be used." in words


@pytest.mark.parametrize(
    ("digest", "sentence"),
    [
        ("", f"Proved: {ALL} of {ALL} controls"),
        ("own", f"Proved: {ALL} of {ALL} controls"),
        ("0" * 64, "has no policy that its robot could use"),
    ],
    ids=("unknown", "own", "another"),
)
def test_a_policy_of_another_model_counts_as_little_as_for_the_executor(
    tmp_path, capsys, digest, sentence
):
    with BagReader(SAMPLE) as bag:
        own = hashlib.sha256(bag.recorded_mjcf().encode()).hexdigest()

        def today(message):
            policy = deserialize_message(message.data, GaussianPolicy)
            policy.robot.digest = own if digest == "own" else digest
            return serialize_message(policy)

        messages = [m if m.topic != "/policy" else replace(m, data=today(m)) for m in messages_of()]
    assert sentence in outcome(rewritten(tmp_path / "bag", messages), capsys)[1]


def test_a_policy_from_a_file_is_proved_by_the_file(tmp_path, capsys):
    with BagReader(SAMPLE) as reader:
        *_, (_, last) = reader.decoded("/policy")
    save_policy(policy_from_msg(last), "swimmer", tmp_path / "policy.json")
    main(["check", str(SAMPLE), "--policy", str(tmp_path / "policy.json")])
    words = capsys.readouterr().out
    assert "1 policies by the file, " in words


def test_what_cannot_be_read_is_wrong_and_the_rest_is_checked_all_the_same(tmp_path, capsys):
    """As where somebody publishes nonsense, which no node uses."""
    messages = messages_of()
    _, second, third, _ = (m for m in messages if m.topic == "/policy")
    command = [m for m in messages if m.topic == "/joint_command"][100]
    nan = command.data[:-16] + struct.pack("<2d", np.nan, 0.0)
    nonsense = {
        second: replace(second, data=second.data.replace(b"softplus", b"softplux")),
        third: replace(third, data=b"nonsense"),
        command: replace(command, data=nan),
    }
    bag = rewritten(tmp_path / "bag", [nonsense.get(m, m) for m in messages])
    code, words = outcome(bag, capsys)
    assert code == WRONG
    assert "Wrong: 2 policies cannot be read; of the first one: The policy of iteration 2" in words
    at = nanoseconds(deserialize_message(command.data, JointState).header.stamp) * 1e-9
    assert f"Wrong: 1 commands cannot be read; of the first one: At {at:.3f} s" in words
    assert f"Proved: {ALL - 3} of {ALL - 1} controls" in words


def test_a_bag_without_digests_says_so(tmp_path, capsys):
    shutil.copytree(SAMPLE, tmp_path / "bag")
    (tmp_path / "bag" / "SHA256SUMS").unlink()
    code, words = outcome(tmp_path / "bag", capsys)
    assert code == 0
    assert "Not proved: the files, which have no SHA256SUMS; " in words


def test_a_byte_that_was_altered_later_is_found_by_the_digest_of_its_file(tmp_path, capsys):
    bag = copy(tmp_path / "bag", lambda message: message.data)
    subprocess.run(["sha256sum", "--check", "--quiet", "SHA256SUMS"], cwd=bag, check=True)
    code, words = outcome(bag, capsys)
    assert code == 0
    assert "the digest of each file" in words
    metadata = bag / "metadata.yaml"
    metadata.write_text(metadata.read_text().replace("jazzy", "humble"))
    code, words = outcome(bag, capsys)
    assert code == WRONG
    assert "metadata.yaml is not as its recorder wrote it, by SHA256SUMS" in words


def test_ssh_keygen_signs_a_bag_and_verifies_it(tmp_path):
    bag, key = copy(tmp_path / "bag", lambda message: message.data), tmp_path / "key"
    subprocess.run(["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", key], check=True)
    signers = tmp_path / "signers"
    signers.write_text(f"me@here {key.with_suffix('.pub').read_text()}")
    sign = ["ssh-keygen", "-Y", "sign", "-n", "vgps-bag", "-f", key, "SHA256SUMS"]
    subprocess.run(sign, cwd=bag, check=True, capture_output=True)
    verify = ["ssh-keygen", "-Y", "verify", "-n", "vgps-bag", "-f", signers, "-I", "me@here"]
    text = (bag / "SHA256SUMS").read_bytes()
    for signed, code in ((text, 0), (text + b"x", 255)):
        words = [*verify, "-s", "SHA256SUMS.sig"]
        run = subprocess.run(words, cwd=bag, input=signed, capture_output=True, check=False)
        assert run.returncode == code
