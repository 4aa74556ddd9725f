"""Program `train_through_graph`: asks a policy_learner to train, and shows how it goes."""

import argparse
import signal
import sys
from collections.abc import Sequence
from pathlib import Path

import rclpy
from rclpy.executors import ExternalShutdownException
from vgps_msgs.action import TrainPolicy

from vgps_ros.core.errors import VgpsError
from vgps_ros.messages.conversions import policy_from_msg
from vgps_ros.messages.progress import result_from_msgs
from vgps_ros.ros_runtime.training_client import TrainingClient
from vgps_ros.search.settings import SearchSettings
from vgps_ros.storage.run_folder import RunFolder
from vgps_ros.views.plots import learning_curve, save
from vgps_ros.views.training_progress import TrainingProgress


def write_result(result: TrainPolicy.Result, output: RunFolder) -> None:
    """Writes result.json, policy.json and learning_curve.png, as `train` does."""
    policy = policy_from_msg(result.policy)
    content = result_from_msgs(result.history, policy)
    output.save(content, policy)
    save(learning_curve(content), output.learning_curve)


def main(arguments: Sequence[str] | None = None) -> None:
    """Runs the program."""
    parser = argparse.ArgumentParser(
        prog="train_through_graph",
        description="Asks a running policy_learner for a training, shows its progress, and writes "
        "result.json, policy.json and learning_curve.png. Ctrl-C cancels the training.",
    )
    parser.add_argument("--seed", type=int, default=0, help="seed of all random draws")
    unless = "the learner's parameter, unless given"
    parser.add_argument("--iterations", type=int, nargs=1, default=[], help=f"number; {unless}")
    parser.add_argument(
        "--hidden-units",
        type=int,
        nargs="+",
        default=[],
        help=f"width of each hidden layer; {unless}",
    )
    parser.add_argument("--output", type=Path, required=True, help="folder for the results")
    parser.add_argument("--learner", default="policy_learner", help="name of the learner node")
    parser.add_argument("--timeout", type=float, default=20.0, help="wait for the learner [s]")
    parser.add_argument(
        "--lost-timeout",
        type=float,
        default=300.0,
        help="wait for a learner that was killed or hangs; a new one gets the goal again [s]",
    )
    parsed = parser.parse_args(arguments)
    # INT is this program's own, to cancel the goal; TERM stays rclpy's.
    rclpy.init(signal_handler_options=rclpy.signals.SignalHandlerOptions.SIGTERM)
    node = TrainingClient(parsed.learner, parsed.lost_timeout)
    signal.signal(signal.SIGINT, node.interrupt)
    try:
        goal = TrainPolicy.Goal(
            seed=parsed.seed, iterations=parsed.iterations, hidden_units=parsed.hidden_units
        )
        with TrainingProgress(SearchSettings().initial_ddp_iterations) as progress:
            result = node.train(goal, parsed.timeout, progress)
        folder = RunFolder(parsed.output)
        write_result(result, folder)
        print(result.message)
        print(f"Wrote {folder.file_names()} to {folder.path}.")
    except (VgpsError, OSError, AssertionError) as error:
        sys.exit(f"train_through_graph: {error}")
    except (KeyboardInterrupt, ExternalShutdownException):
        sys.exit("train_through_graph: interrupted.")
    finally:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        node.destroy_node()
        rclpy.try_shutdown()
