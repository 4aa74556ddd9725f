# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A network with gains drives a robot of motors: targets on the wire, loops in the simulation."""

import signal

import numpy as np
import onnx
from sensor_msgs.msg import JointState
from vgps_msgs.msg import Signals

from tests.onnx_models import elu_model
from tests.servo_arm import LEG, write_arm
from vgps_ros.bags import BagReader
from vgps_ros.bags.bag_check import check_bag
from vgps_ros.bags.episode import episodes
from vgps_ros.policies.driver import driver_of, for_policy
from vgps_ros.policies.policy_file import open_policy
from vgps_ros.ros_runtime.qos import LATEST
from vgps_ros.simulation.model import compile_model
from vgps_ros.tasks import make_task

STEPS = 150
TARGET = np.array([-0.4, 0.2])  # of shoulder and elbow


def test_its_targets_and_gains_reach_the_simulation_and_its_bag_is_checked(graph, tmp_path):
    task = make_task(write_arm(tmp_path, LEG))
    names, path = task.observation.names, tmp_path / "policy.onnx"
    says = {
        "joint_names": "elbow,shoulder",
        "observation_names": ",".join(names),
        "default_joint_pos": ",".join(map(str, TARGET[::-1])),
        "joint_stiffness": "80.0",
        "joint_damping": "3.0",
    }
    onnx.save(elu_model([(np.zeros((2, len(names))), np.zeros(2))], says), path)
    recorder = graph.record()
    commands = graph.messages(JointState, "joint_command")
    gains = graph.messages(Signals, "joint_gains", LATEST)
    simulation = graph.start("simulation", task=task.name, start_paused=True)
    graph.start("policy_executor", task=task.name, policy_file=path)
    graph.spin_until_output(simulation, "The controls are position [rad] now.")
    graph.spin_until(lambda: graph.node.count_subscribers("joint_command") == 3)
    program = graph.start_program("execute_policy", "--task", task.name, "--steps", str(STEPS))
    graph.ends(program)
    assert recorder.end(signal.SIGINT) == 0, recorder.output

    named = [f"{joint}/{gain}" for gain in ("stiffness", "damping") for joint in task.joint_names]
    assert list(gains[0].names) == named
    np.testing.assert_allclose(gains[0].values, [80.0, 80.0, 3.0, 3.0], rtol=1e-15)
    assert (list(commands[-1].name), list(commands[-1].effort)) == (["shoulder", "elbow"], [])
    np.testing.assert_allclose(commands[-1].position, TARGET)

    served = for_policy(task, open_policy(path))
    driver = driver_of(served.deployment, open_policy(path))

    def law(t, x):
        return driver.policy.mean(driver.observation(x))

    expected = served.dynamics.rollout(task.initial_state, law, STEPS)
    with BagReader(tmp_path / "bag") as bag:
        episode = episodes(bag, compile_model(bag.mjcf()))[-1]
    np.testing.assert_allclose(episode.states[: STEPS + 1], expected.states, rtol=1e-9, atol=1e-9)
    assert np.abs(episode.states[STEPS, 2:]).max() < 1e-3  # it rests
    found = check_bag(tmp_path / "bag", open_policy(path))
    assert found.wrong == found.missing == []
    assert found.counts["mean"] + found.counts["close"] >= STEPS
