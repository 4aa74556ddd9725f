"""Asks a running policy_learner to train, and shows how it goes.

It writes result.json, policy.json and learning_curve.png. Ctrl-C cancels the training.
"""

import argparse
import signal
from pathlib import Path
from typing import TYPE_CHECKING

from vgps_ros.core.seeding import SEED
from vgps_ros.core.settings import Setting, settings_of
from vgps_ros.experiments.command_line import (
    Parser,
    add_overwrite,
    add_ros_arguments,
    add_setting,
    refuse_existing,
)
from vgps_ros.search.settings import SearchSettings
from vgps_ros.storage.run_folder import RunFolder

if TYPE_CHECKING:
    from vgps_msgs.action import TrainPolicy

TIMEOUT = Setting("timeout", 20.0, "wait for the learner [s]", minimum=0.1, maximum=86_400.0)
LOST_TIMEOUT = Setting(
    "lost_timeout",
    300.0,
    "wait for a learner that was killed or hangs; a new one gets the goal again [s]",
    minimum=0.0,
    maximum=86_400.0,
)


def write_result(result: "TrainPolicy.Result", output: RunFolder) -> None:
    """Writes result.json, policy.json and learning_curve.png, as `train` does."""
    from vgps_ros.messages.conversions import policy_from_msg
    from vgps_ros.messages.progress import result_from_msgs
    from vgps_ros.views.plots import learning_curve, save

    policy = policy_from_msg(result.policy)
    content = result_from_msgs(result.history, policy)
    output.save(content, policy)
    save(learning_curve(content), output.learning_curve)


def add_arguments(parser: Parser) -> None:
    """Declares the arguments of the command."""
    add_setting(parser, SEED)
    for setting in settings_of(SearchSettings()):
        if setting.name in ("iterations", "hidden_units"):
            add_setting(parser, setting, unset="the learner's parameter")
    parser.add_argument("--output", type=Path, required=True, help="folder for the results")
    add_overwrite(parser)
    parser.add_argument("--learner", default="policy_learner", help="name of the learner node")
    for setting in (TIMEOUT, LOST_TIMEOUT):
        add_setting(parser, setting)
    add_ros_arguments(parser)


def run(arguments: argparse.Namespace) -> None:
    """Asks for the training that the arguments describe."""
    output = RunFolder(arguments.output)
    refuse_existing([output.result], overwrite=arguments.overwrite)
    import rclpy
    from rclpy.executors import ExternalShutdownException
    from vgps_msgs.action import TrainPolicy

    from vgps_ros.core.errors import VgpsError
    from vgps_ros.ros_runtime.training_client import TrainingClient
    from vgps_ros.views.training_progress import TrainingProgress

    # INT is this program's own, to cancel the goal; TERM stays rclpy's.
    rclpy.init(signal_handler_options=rclpy.signals.SignalHandlerOptions.SIGTERM)
    node = TrainingClient(arguments.learner, arguments.lost_timeout)
    signal.signal(signal.SIGINT, node.interrupt)
    try:
        goal = TrainPolicy.Goal(
            seed=arguments.seed,
            iterations=[arguments.iterations] if "iterations" in arguments else [],
            hidden_units=getattr(arguments, "hidden_units", []),
        )
        with TrainingProgress(SearchSettings().initial_ddp_iterations) as progress:
            result = node.train(goal, arguments.timeout, progress)
        write_result(result, output)
        print(result.message)
        print(f"Wrote {output.file_names()} to {output.path}.")
    except AssertionError as error:  # of a message whose value is out of range
        raise VgpsError(str(error)) from error
    except ExternalShutdownException as error:
        raise KeyboardInterrupt from error
    finally:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        node.destroy_node()
        rclpy.try_shutdown()
