# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""What `vgps bag check` proves of a run, and which alterations it finds."""

import json
import shutil
import struct
import subprocess
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState
from vgps_msgs.msg import GaussianPolicy as GaussianPolicyMsg

from tests.bags.altered import ALL, SAMPLE, copy, fails, main
from vgps_ros.bags import BagReader
from vgps_ros.bags.recorded_executor import RecordedExecutor
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.policy import Architecture, GaussianPolicy
from vgps_ros.messages.conversions import distribution_from_msg, policy_from_msg
from vgps_ros.messages.names import SAFE_ACTION_DRIVES
from vgps_ros.safety.safe_action import safe_torques
from vgps_ros.safety.settings import SafetySettings
from vgps_ros.safety.torque_limits import TorqueLimiter
from vgps_ros.safety.training_marginals import TrainingMarginals
from vgps_ros.simulation.model import state_names
from vgps_ros.storage.run_folder import save_policy
from vgps_ros.tasks import make_task


def test_the_recorded_torques_are_those_of_the_recorded_policy(capsys):
    main(["check", str(SAMPLE)])
    *_, last = capsys.readouterr().out.splitlines()
    chunks = len(
        json.loads((SAMPLE / "manifest.json").read_text())["files"]["bag_0.mcap"]["chunks"]
    )
    assert last == f"Proven: {ALL} of {ALL} torques, 4 of 4 policies, {chunks} chunks in 1 files."


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

    bag = copy(tmp_path / "bag", change)
    command = commands[99]
    time = command.header.stamp.sec + command.header.stamp.nanosec * 1e-9
    fails(["check", str(bag)], f"At {time:.3f} s the torque of {command.name[1]} is")
    assert "1 torques differ" in capsys.readouterr().out


def commanded(change):
    """Returns what `copy` takes: the torques of command i become change(i, stamp, torques)."""
    count = iter(range(10_000))

    def apply(message):
        if message.topic != "/joint_command":
            return message.data
        command = deserialize_message(message.data, JointState)
        stamp = command.header.stamp.sec * 10**9 + command.header.stamp.nanosec
        torques = change(next(count), stamp, np.array(command.effort))
        return message.data[:-16] + struct.pack("<2d", *torques)  # efforts come last

    return apply


def state_at(stamp):
    """The sample's state of a stamp [ns]."""
    with BagReader(SAMPLE) as bag:
        for message in bag.messages(["/joint_states"]):
            state = bag.decode(message)
            if state.header.stamp.sec * 10**9 + state.header.stamp.nanosec == stamp:
                return np.concatenate([state.position, state.velocity])
    raise AssertionError(stamp)


def test_torques_are_compared_within_the_recorded_limits(tmp_path, capsys):
    limits = [20.0, 30.0]
    change = commanded(lambda i, stamp, torques: np.clip(torques, -20, 20))
    main(["check", str(copy(tmp_path / "good", change, torque_limits=[20.0, 20.0]))])
    found = capsys.readouterr().out
    assert f"{ALL} torques are bit for bit what the policy gives" in found
    clipped = int(found.split(" of them are clipped to torque_limits")[0].split()[-1])
    assert 50 < clipped < ALL
    change = commanded(lambda i, stamp, torques: np.clip(torques, -20, 20))
    bag = copy(tmp_path / "bad", change, torque_limits=limits)
    fails(["check", str(bag)], "the torque of back_joint is")


@pytest.mark.parametrize("bad", [None, 300])
def test_a_rate_limit_is_followed_from_torque_to_torque(tmp_path, capsys, bad):
    limits = (np.full(2, -1e9), np.full(2, 1e9))
    limiter = TorqueLimiter(limits, 200.0, 0.02)

    def change(i, stamp, torques):
        torques = limiter.limited(torques, stamp)
        limiter.note(torques, stamp)
        return torques + (i == bad) * np.array([0.0, 1e-9])

    bag = copy(tmp_path / "bag", commanded(change), torque_rate_limit=200.0)
    if bad is None:
        main(["check", str(bag)])
        found = capsys.readouterr().out
        assert f"{ALL} torques are bit for bit" in found
        assert int(found.split(" of them are held back")[0].split()[-1]) > 50
    else:
        fails(["check", str(bag)], "the torque of back_joint is")


def with_fault(change):
    """Returns what `copy` takes: `change`, and the executor says that the safe action drives."""

    def apply(message):
        if message.topic != "/diagnostics":
            return change(message)
        array = deserialize_message(message.data, DiagnosticArray)
        for status in array.status:
            if status.name == "/policy_executor":
                status.message = f"{SAFE_ACTION_DRIVES} (zero): a reason."
        return serialize_message(array)

    return apply


@pytest.mark.parametrize("action", ["zero", "damping", "feedback"])
def test_torques_of_the_safe_action_are_counted_apart(tmp_path, capsys, action):
    settings = SafetySettings(safe_action=action, damping=3.0)
    swimmer = make_task("swimmer")
    with BagReader(SAMPLE) as bag:
        last = list(bag.messages(["/trajectory_distribution"]))[-1]
        q = distribution_from_msg(bag.decode(last)).first(swimmer.horizon)
    marginals = TrainingMarginals(q, swimmer.observation, 2)

    def change(i, stamp, torques):
        if not 200 <= i < 205:
            return torques
        return safe_torques(settings, state_at(stamp), [8, 9], [marginals])

    safe = {"safe_action": action, "damping": 3.0}
    said = with_fault(commanded(change))
    main(["check", str(copy(tmp_path / "bag", said, **safe))])
    found = capsys.readouterr().out
    assert f"{ALL - 5} torques are bit for bit" in found
    assert "5 other torques are those of the safe action, while it drove." in found
    assert f"Proven: {ALL} of {ALL} torques" in found
    # The same torques are wrong where the executor did not say so.
    silent = copy(tmp_path / "silent", commanded(change), **safe)
    fails(["check", str(silent)], "the executor's diagnostics do not say that it drove")
    assert "Wrong: 5 torques are zero or safe" in capsys.readouterr().out


def test_a_state_that_is_not_finite_is_counted_and_needs_no_torque(tmp_path, capsys):
    seen = iter(range(10_000))

    def change(message):
        if message.topic != "/joint_states" or next(seen):
            return message.data
        # The first copy of the first state: the last velocity stands before five efforts.
        end = len(message.data) - 5 * 8 - 8
        return message.data[: end - 8] + struct.pack("<d", np.nan) + message.data[end:]

    main(["check", str(copy(tmp_path / "bag", change))])
    assert "1 states could not be used." in capsys.readouterr().out


def test_an_older_policy_that_reads_what_no_state_has_is_refused():
    """Policies of older bags hold the indices of what they read."""
    model = make_task("swimmer").dynamics.model
    empty = SimpleNamespace(attachments=dict, of_robot=list, filled_topics={})
    executor = RecordedExecutor(empty, model)
    shape = Architecture((1, 9), (2,), 2)
    policy = GaussianPolicy(shape, np.ones(shape.num_parameters), np.ones(2))
    names = state_names(model)
    assert executor.named(policy).architecture.observed == (names[1], names[9])
    beyond = replace(policy, architecture=replace(shape, observed=(1, 10)))
    with pytest.raises(InvalidInputError, match="index 10, but a state has 10 numbers"):
        executor.named(beyond)


def test_a_lost_state_is_found(tmp_path, capsys):
    count = iter(range(10_000))

    def change(message):
        if message.topic == "/joint_states" and next(count) == 300:
            return None
        return message.data

    fails(["check", str(copy(tmp_path / "bag", change))], "states that are not in the bag")
    assert "Wrong: 1 torques answer states that are not in the bag" in capsys.readouterr().out


def without(removed):
    """Returns what `copy` takes: the torques with these numbers are left out."""
    count = iter(range(10_000))
    return lambda m: None if m.topic == "/joint_command" and next(count) in removed else m.data


@pytest.mark.parametrize(
    "removed", [range(1, ALL), range(ALL - 1), range(100, 400), range(205, ALL), [321]]
)
def test_deleted_torques_are_found(tmp_path, capsys, removed):
    with pytest.raises(SystemExit) as stop:
        main(["check", str(copy(tmp_path / "bag", without(removed)))])
    assert stop.value.code != 0
    found = capsys.readouterr().out
    assert "states lack the torque that answers them" in found or "the executor counted" in found


def test_torques_that_were_set_to_zero_are_found(tmp_path, capsys):
    bag = copy(tmp_path / "bag", commanded(lambda i, stamp, torques: np.zeros(2)))
    fails(["check", str(bag)], "the torques are [0.0, 0.0] N·m as of the safe action")
    *_, last = capsys.readouterr().out.splitlines()
    assert last == "Proven: 4 of 4 policies, 8 chunks in 1 files."


@pytest.mark.parametrize("part", ["parameters", "noise_std"])
@pytest.mark.parametrize("iteration", [1, 2, 4])
def test_an_altered_policy_is_found_even_if_it_never_drove(tmp_path, capsys, part, iteration):
    def change(message):
        if message.topic != "/policy":
            return message.data
        policy = deserialize_message(message.data, GaussianPolicyMsg)
        if policy.iteration == iteration:
            values = getattr(policy, part)
            values[-1] = np.nextafter(values[-1], 1e9) if part == "parameters" else 5 * values[-1]
        return serialize_message(policy)

    with pytest.raises(SystemExit):
        main(["check", str(copy(tmp_path / "bag", change))])
    found = capsys.readouterr().out
    assert f"Wrong: the policy of iteration {iteration} is not its learner's." in found


def test_what_cannot_be_proven_is_said_and_has_an_exit_code_of_its_own(tmp_path, capsys):
    """As bags of older versions are: no digests, no counts, no manifest."""

    def change(message):
        if message.topic == "/learning_progress":
            return None
        if message.topic == "/diagnostics":
            array = deserialize_message(message.data, DiagnosticArray)
            for status in array.status:
                status.values = []
            return serialize_message(array)
        return message.data

    torques = commanded(lambda i, stamp, u: u * (1 + 1e-13))
    bag = copy(tmp_path / "bag", lambda m: torques(m) if "command" in m.topic else change(m))
    (bag / "manifest.json").unlink()
    with pytest.raises(SystemExit) as stop:
        main(["check", str(bag)])
    assert stop.value.code == 3
    found = capsys.readouterr().out
    for part in ("torques of an old version", "4 policies, of which", "no manifest.json"):
        assert any(part in line for line in found.splitlines() if line.startswith("Not proven: "))


def test_a_policy_from_a_file_is_proven_by_the_file(tmp_path, capsys):
    bag = copy(tmp_path / "bag", lambda m: None if m.topic == "/learning_progress" else m.data)
    with BagReader(SAMPLE) as reader:
        *_, (_, last) = reader.decoded("/policy")
    save_policy(policy_from_msg(last), "swimmer", tmp_path / "policy.json")
    with pytest.raises(SystemExit):
        main(["check", str(bag), "--policy", str(tmp_path / "policy.json")])
    found = capsys.readouterr().out
    assert f"Proven: {ALL} of {ALL} torques, 1 of 4 policies" in found
    assert "Not proven: 3 policies, of which no learner says a digest." in found


def test_a_signed_bag_names_its_signer(tmp_path, capsys):
    key, bag = tmp_path / "key", tmp_path / "bag"
    subprocess.run(["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", key], check=True)
    signers = tmp_path / "signers"
    signers.write_text(f"me@here {key.with_suffix('.pub').read_text()}")
    shutil.copytree(SAMPLE, bag)
    fails(["check", str(bag), "--signers", str(signers)], "is not signed")
    main(["sign", str(bag), "--key", str(key)])
    main(["check", str(bag), "--signers", str(signers)])
    assert capsys.readouterr().out.endswith(", the signature of me@here.\n")
