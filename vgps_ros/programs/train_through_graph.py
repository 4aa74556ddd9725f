# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Asks a running policy_learner to train, and shows how it goes.

It writes result.json, policy.json and learning_curve.png. Ctrl-C cancels the training.
"""

import argparse
import signal

from vgps_ros.core.seeding import SEED
from vgps_ros.core.settings import Setting, settings_of
from vgps_ros.experiments.command_line import Parser, refuse_existing
from vgps_ros.ros_runtime.middleware import check_memory, within_limits
from vgps_ros.search.settings import SearchSettings
from vgps_ros.storage.run_folder import RunFolder


def add_arguments(parser: Parser) -> None:
    """Declares the arguments of the command."""
    parser.add_settings(SEED)
    own = [s for s in settings_of(SearchSettings()) if s.name in ("iterations", "hidden_units")]
    parser.add_settings(*own, unset="the learner's parameter")
    parser.add_output("--output", "folder for the results", required=True)
    parser.add_argument("--learner", default="policy_learner", help="name of the learner node")
    lost = "wait for a learner that was killed or hangs; a new one gets the goal again [s]"
    parser.add_settings(
        Setting("timeout", 20.0, "wait for the learner [s]", minimum=0.1, maximum=86_400.0),
        Setting("lost_timeout", 300.0, lost, minimum=0.0, maximum=86_400.0),
    )
    parser.add_ros_arguments()


def run(arguments: argparse.Namespace) -> None:
    """Asks for the training that the arguments describe, and writes what `train` does."""
    output = RunFolder(arguments.output)
    refuse_existing([output.result], overwrite=arguments.overwrite)
    check_memory()
    import rclpy
    from rclpy.executors import ExternalShutdownException
    from vgps_msgs.action import TrainPolicy

    from vgps_ros.messages.conversions import policy_from_msg
    from vgps_ros.messages.progress import result_from_msgs
    from vgps_ros.ros_runtime.training_client import TrainingClient
    from vgps_ros.views.learning_curve import learning_curve
    from vgps_ros.views.plots import save
    from vgps_ros.views.training_progress import TrainingProgress

    # INT is this program's own, to cancel the goal; TERM stays rclpy's.
    rclpy.init(signal_handler_options=rclpy.signals.SignalHandlerOptions.SIGTERM)
    with within_limits():
        node = TrainingClient(arguments.learner, arguments.lost_timeout, arguments.namespace)
    signal.signal(signal.SIGINT, node.interrupt)
    try:
        goal = TrainPolicy.Goal(
            seed=arguments.seed,
            iterations=[arguments.iterations] if "iterations" in arguments else [],
            hidden_units=getattr(arguments, "hidden_units", []),
        )
        with TrainingProgress(SearchSettings().initial_ddp_iterations) as progress:
            result = node.train(goal, arguments.timeout, progress)
        policy = policy_from_msg(result.policy)
        content = result_from_msgs(result.history, policy)
        output.save(content, policy)
        save(learning_curve(content), output.learning_curve)
        print(result.message)
        print(f"Wrote {output.file_names()} to {output.path}.")
    except ExternalShutdownException as error:
        raise KeyboardInterrupt from error
    finally:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        node.destroy_node()
        rclpy.try_shutdown()
