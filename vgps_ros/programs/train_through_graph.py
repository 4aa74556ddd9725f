# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Asks a running policy_learner to train, and shows how it goes.

It writes result.json, policy.json and learning_curve.png. Ctrl-C cancels the training, as INT and
TERM do; a second one does not wait until the learner confirms it.
"""

import argparse
from functools import partial

from vgps_ros.core.seeding import SEED
from vgps_ros.core.settings import Range, Setting, settings_of
from vgps_ros.programs.command_line import Parser, refuse_existing
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
    parser.add_settings(Setting("lost_timeout", 300.0, Range(0.0, 86_400.0), lost))
    parser.add_ros_arguments("the learner")


def run(arguments: argparse.Namespace) -> None:
    """Asks for the training that the arguments describe, and writes what `train` does."""
    output = RunFolder(arguments.output)
    refuse_existing([output.result], overwrite=arguments.overwrite)
    from vgps_msgs.action import TrainPolicy

    from vgps_ros.messages.conversions import policy_from_msg, result_from_msgs
    from vgps_ros.programs.training_client import TrainingClient
    from vgps_ros.ros_runtime.runner import client_node
    from vgps_ros.views.console import TrainingProgress
    from vgps_ros.views.learning_curve import learning_curve
    from vgps_ros.views.plots import save

    of_learner = (arguments.learner, arguments.lost_timeout, arguments.namespace)
    with client_node(partial(TrainingClient, *of_learner)) as node:
        goal = TrainPolicy.Goal(
            seed=arguments.seed,
            iterations=[arguments.iterations] if "iterations" in arguments else [],
            hidden_units=getattr(arguments, "hidden_units", []),
        )
        with TrainingProgress() as progress:
            result = node.train(goal, arguments.timeout, progress)
        policy = policy_from_msg(result.policy)
        content = result_from_msgs(result.history, policy)
        output.save(content, policy)
        save(learning_curve(content), output.learning_curve)
        print(result.message)
        print(f"Wrote {output.file_names()} to {output.path}.")
