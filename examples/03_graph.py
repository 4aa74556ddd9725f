# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The graph of nodes from Python: start an optimizer and a learner, and ask for a training.

source env.bash && python examples/03_graph.py
"""

import os
import signal
import subprocess
import sys

import rclpy
from rclpy.action import ActionClient
from rclpy.qos import QoSProfile
from vgps_msgs.action import TrainPolicy

NODES = ("trajectory_optimizer", "policy_learner")


def train(node: rclpy.node.Node) -> TrainPolicy.Result:
    """Sends a goal to the learner, shows its feedback, and returns the result."""
    client = ActionClient(
        node, TrainPolicy, "policy_learner/train", feedback_sub_qos_profile=QoSProfile(depth=100)
    )
    client.wait_for_server()
    goal = TrainPolicy.Goal(seed=0, iterations=[int(os.environ.get("ITERATIONS", "5"))],
                            hidden_units=[5])  # fmt: skip
    accepted = client.send_goal_async(goal, feedback_callback=show)
    rclpy.spin_until_future_complete(node, accepted)
    if not accepted.result().accepted:
        sys.exit("The learner refuses the goal; its log says why.")
    done = accepted.result().get_result_async()
    rclpy.spin_until_future_complete(node, done)
    return done.result().result


def show(message: TrainPolicy.Impl.FeedbackMessage) -> None:
    """Prints one iteration."""
    progress = message.feedback.progress
    print(f"{progress.iteration}: policy {progress.deterministic_cost:.3f}", flush=True)


task = ["--ros-args", "-p", f"task:={os.environ.get('TASK', 'rotor')}"]
started = [subprocess.Popen(["vgps", "node", name, *task]) for name in NODES]
try:
    rclpy.init()
    result = train(rclpy.create_node("example"))
    rclpy.shutdown()
    print(f"{result.message} The policy has {result.num_parameters} parameters.")
finally:
    for process in started:
        process.send_signal(signal.SIGINT)
    codes = [process.wait() for process in started]
print(f"The nodes ended with {codes}.")
