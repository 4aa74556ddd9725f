"""Reads a run from its bag, or from the files that `train` writes."""

from pathlib import Path
from typing import Any

from vgps_ros.bags import BagReader
from vgps_ros.bags.episode import last_episode
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.messages.conversions import distribution_from_msg
from vgps_ros.messages.progress import entry_from_msg
from vgps_ros.search.result_file import result_content
from vgps_ros.views.run_record import TRAJECTORIES, RunRecord, read_results


def read_run(path: Path) -> RunRecord:
    """Reads a run from the folder of a bag, or from the folder with the results of a run.

    Raises:
        InvalidInputError: the folder is neither of these, or cannot be read.
    """
    if (path / TRAJECTORIES).is_file():
        return read_results(path)
    if (path / "bag").is_dir():
        return _read_bag(path / "bag")
    if (path / "result.json").is_file():
        raise InvalidInputError(
            f"'{path}' has costs but no motion, which is in bag/ or in {TRAJECTORIES}: name the "
            "folder of a run that has finished."
        )
    return _read_bag(path)


def _read_bag(path: Path) -> RunRecord:
    with BagReader(path) as bag:
        bag.needed_topic("robot_description")
        topics = bag.filled_topics

        def decoded(name: str) -> list[Any]:
            if name not in topics:
                return []
            return [bag.decode(message) for message in bag.messages([topics[name]])]

        mjcf = decoded("robot_description")[0].data
        distributions = [
            message
            for message in decoded("trajectory_distribution")
            if message.trajectory_index == 0
        ]
        states = topics.get("joint_states")
        episode = last_episode(bag, states, mjcf) if states else None
        time_step = episode.time_step if episode else 0.0
        if distributions:
            time_step = float(distributions[-1].time_step)
        initial = next((message for message in distributions if message.iteration == 0), None)
        last = distribution_from_msg(distributions[-1]) if distributions else None
        return RunRecord(
            mjcf,
            time_step,
            result=_result(decoded("learning_progress"), decoded("policy")),
            initial_states=distribution_from_msg(initial).mean.states if initial else None,
            mean_states=last.mean.states if last else None,
            state_covariances=last.state_covariances if last else None,
            executed_states=episode.states if episode else None,
        )


def _result(progress: list[Any], policies: list[Any]) -> dict[str, Any] | None:
    """Returns the costs of the last training in the bag, in the form of result.json."""
    if not progress:
        return None
    begin = max(i for i, message in enumerate(progress) if i == 0 or message.iteration == 1)
    last = progress[-1]
    sizes = [int(size) for size in policies[-1].layer_sizes] if policies else []
    return result_content(
        task=last.task,
        method=last.method,
        seed=int(last.seed),
        hidden_units=sizes[1:-1],
        num_parameters=len(policies[-1].parameters) if policies else 0,
        initial_ddp_cost=last.initial_ddp_cost,
        # A learner that was started again publishes again the iteration from which it goes on.
        iterations=list({m.iteration: entry_from_msg(m) for m in progress[begin:]}.values()),
    )
